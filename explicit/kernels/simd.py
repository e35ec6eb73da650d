"""Arithmetic on the four components of a node at once, and sums into nodes.

LLVM takes Warp's vec4 apart and, where one of its components goes unused, does not put it together again: sums over a
point's nodes then run number by number (benchmarks/README.md has what that costs). In these functions the four stay
one vector. A GPU reads a node in 16-byte loads and, from sm_90 on, adds four float32 to it in one reduction, where
Warp's atomics take four.
"""

import functools
from types import SimpleNamespace

import warp as wp


@functools.cache
def simd(real):
    """Return the functions for `real` (wp.float32 or wp.float64).

    Members, `w` a weight, `a` and `b` vec4: `scaled(w, a)` = w a; `add_scaled(w, a, b)` = w a + b;
    `load(nodes, n)` = nodes[n];
    `gather(nodes, n, w)` = w[0] nodes[n] + w[1] nodes[n + 1] + w[2] nodes[n + 2], the sum over a pencil's nodes;
    `add(nodes, n, a)`: nodes[n] += a, atomic on a GPU; Warp's CPU device has one thread.
    """
    vec3, vec4 = wp.types.vector(3, real), wp.types.vector(4, real)
    number, alignment = {wp.float32: ("float", 4), wp.float64: ("double", 8)}[real]
    single = real == wp.float32
    suffix, register = ("f32", "f") if single else ("f64", "d")

    def snippet(on_cpu: str, on_gpu: str) -> str:
        """`on_cpu` computes `sum` with `lanes`, `on_gpu` returns the same."""
        return f"""
        #if defined(__CUDA_ARCH__)
        {on_gpu}
        #else
        typedef {number} lanes __attribute__((ext_vector_type(4), aligned({alignment})));
        wp::vec_t<4, {number}> sum;
        *(lanes*)&sum = {on_cpu};
        return sum;
        #endif
        """

    @wp.func_native(snippet("w * *(const lanes*)&a", "return wp::mul(w, a);"))
    def scaled(w: real, a: vec4) -> vec4: ...

    @wp.func_native(snippet("w * *(const lanes*)&a + *(const lanes*)&b", "return wp::add(wp::mul(w, a), b);"))
    def add_scaled(w: real, a: vec4, b: vec4) -> vec4: ...

    node = "((const lanes*)(nodes.data + n))"
    wide, parts = ("float4", "xyzw") if single else ("double2", "xy")
    halves = 4 // len(parts)  # wide loads a node
    read = f"const {wide}* at = reinterpret_cast<const {wide}*>(nodes.data + n);"
    read += "".join(f"const {wide} n{k} = at[{k}];" for k in range(3 * halves))
    sums = ", ".join(
        " + ".join(f"w[{c}] * n{halves * c + half}.{part}" for c in range(3))
        for half in range(halves)
        for part in parts
    )

    @wp.func_native(
        snippet(
            f"w[0] * {node}[0] + w[1] * {node}[1] + w[2] * {node}[2]", f"{read} return wp::vec_t<4, {number}>({sums});"
        )
    )
    def gather(nodes: wp.array(dtype=vec4), n: int, w: vec3) -> vec4: ...

    whole = ", ".join(f"at[{half}].{part}" for half in range(halves) for part in parts)

    @wp.func_native(f"""
        #if defined(__CUDA_ARCH__)
        const {wide}* at = reinterpret_cast<const {wide}*>(nodes.data + n);
        return wp::vec_t<4, {number}>({whole});
        #else
        return nodes.data[n];
        #endif
    """)
    def load(nodes: wp.array(dtype=vec4), n: int) -> vec4: ...

    one_by_one = f"""
        for (int c = 0; c < 4; ++c)
            asm volatile("red.global.add.{suffix} [%0], %1;" :: "l"(&nodes.data[n][c]), "{register}"(a[c]) : "memory");
    """
    at_once = """
        asm volatile("red.global.add.v4.f32 [%0], {%1, %2, %3, %4};"
            :: "l"(nodes.data + n), "f"(a[0]), "f"(a[1]), "f"(a[2]), "f"(a[3]) : "memory");
    """
    reduction = f"""
        #if __CUDA_ARCH__ >= 900
        {at_once}
        #else
        {one_by_one}
        #endif
    """

    @wp.func_native(f"""
        #if defined(__CUDA_ARCH__)
        {reduction if single else one_by_one}
        #else
        typedef {number} lanes __attribute__((ext_vector_type(4), aligned({alignment})));
        *(lanes*)(nodes.data + n) += *(const lanes*)&a;
        #endif
    """)
    def add(nodes: wp.array(dtype=vec4), n: int, a: vec4): ...

    return SimpleNamespace(scaled=scaled, add_scaled=add_scaled, load=load, gather=gather, add=add)
