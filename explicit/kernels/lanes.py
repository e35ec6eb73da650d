"""Arithmetic on the four components of a node at once.

LLVM takes Warp's vec4 apart and, where one of its components goes unused, does not put it together again: sums over a
point's nodes then run number by number (benchmarks/README.md has what that costs). In these functions the four stay
one vector. A GPU has no such vectors and gets plain Warp.
"""

import functools
from types import SimpleNamespace

import warp as wp


@functools.cache
def lanes(real):
    """Return the functions for `real` (wp.float32 or wp.float64).

    Members, `w` a weight, `a` and `b` vec4: `scaled(w, a)` = w a; `add_scaled(w, a, b)` = w a + b;
    `gather(nodes, n, w)` = w[0] nodes[n] + w[1] nodes[n + 1] + w[2] nodes[n + 2], the sum over a pencil's nodes.
    """
    vec3, vec4 = wp.types.vector(3, real), wp.types.vector(4, real)
    number, alignment = {wp.float32: ("float", 4), wp.float64: ("double", 8)}[real]

    def snippet(on_cpu: str, on_gpu: str) -> str:
        """`on_cpu` computes `sum` with `lanes`, `on_gpu` is the same in Warp's own types."""
        return f"""
        #if defined(__CUDA_ARCH__)
        return {on_gpu};
        #else
        typedef {number} lanes __attribute__((ext_vector_type(4), aligned({alignment})));
        wp::vec_t<4, {number}> sum;
        *(lanes*)&sum = {on_cpu};
        return sum;
        #endif
        """

    @wp.func_native(snippet("w * *(const lanes*)&a", "wp::mul(w, a)"))
    def scaled(w: real, a: vec4) -> vec4: ...

    @wp.func_native(snippet("w * *(const lanes*)&a + *(const lanes*)&b", "wp::add(wp::mul(w, a), b)"))
    def add_scaled(w: real, a: vec4, b: vec4) -> vec4: ...

    node = "((const lanes*)(nodes.data + n))"

    @wp.func_native(
        snippet(
            f"w[0] * {node}[0] + w[1] * {node}[1] + w[2] * {node}[2]",
            "wp::add(wp::add(wp::mul(w[0], nodes.data[n]), wp::mul(w[1], nodes.data[n + 1])),"
            " wp::mul(w[2], nodes.data[n + 2]))",
        )
    )
    def gather(nodes: wp.array(dtype=vec4), n: int, w: vec3) -> vec4: ...

    return SimpleNamespace(scaled=scaled, add_scaled=add_scaled, gather=gather)
