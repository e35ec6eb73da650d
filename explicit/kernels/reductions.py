"""Sums and maxima that many points share, beside the four-component sums of `simd`.

On a GPU each is one reduction that hands nothing back. Warp's own maximum of real numbers is a loop of
compare-and-swap, which all threads run on one address.
"""

import functools
from types import SimpleNamespace

import warp as wp


@functools.cache
def reductions(real):
    """Return the functions for `real` (wp.float32 or wp.float64).

    Members: `raise_to(slots, i, value)`: slots[i] = max(slots[i], value) for numbers >= 0, NaN is passed over;
    `add_vector(nodes, n, a)`: nodes[n] += a for a vec4 whose fourth component is 0;
    `add_first(nodes, n, value)`: the first component of nodes[n] += value.
    """
    vec4 = wp.types.vector(4, real)
    single = real == wp.float32
    suffix, register = ("f32", "f") if single else ("f64", "d")

    if single:
        maximum = """
            const unsigned mine = __float_as_uint(value > 0 ? value : 0);
            unsigned* slot = reinterpret_cast<unsigned*>(slots.data + i);
            unsigned most = mine;
            #if __CUDA_ARCH__ >= 800
            most = __reduce_max_sync(lanes, mine);
            #endif
        """
    else:
        maximum = """
            const unsigned long long mine = __double_as_longlong(value > 0 ? value : 0);
            unsigned long long* slot = reinterpret_cast<unsigned long long*>(slots.data + i);
            unsigned long long most = mine;
            #if __CUDA_ARCH__ >= 800
            const unsigned upper = __reduce_max_sync(lanes, (unsigned)(mine >> 32));
            const unsigned lower = __reduce_max_sync(lanes, (unsigned)(mine >> 32) == upper ? (unsigned)mine : 0u);
            most = ((unsigned long long)upper << 32) | lower;
            #endif
        """

    # Numbers that are not negative are in the order of their bits, which the hardware compares: first those of a warp,
    # from sm_80 on, then one of them with what is recorded, which is read before, as it seldom has to be raised.
    @wp.func_native(f"""
        #if defined(__CUDA_ARCH__)
        bool speaks = true;
        #if __CUDA_ARCH__ >= 800
        const unsigned lanes = __activemask();
        speaks = (threadIdx.x & 31) == __ffs(lanes) - 1;
        #endif
        {maximum}
        if (speaks && most > *slot)
            atomicMax(slot, most);
        #else
        if (value > slots.data[i])
            slots.data[i] = value;
        #endif
    """)
    def raise_to(slots: wp.array(dtype=real), i: int, value: real): ...

    def red(component: str, value: str) -> str:
        return (
            f'asm volatile("red.global.add.{suffix} [%0], %1;" '
            f':: "l"(&nodes.data[n][{component}]), "{register}"({value}) : "memory");'
        )

    at_once = """
        asm volatile("red.global.add.v4.f32 [%0], {%1, %2, %3, %4};"
            :: "l"(nodes.data + n), "f"(a[0]), "f"(a[1]), "f"(a[2]), "f"(0.0f) : "memory");
    """
    one_by_one = " ".join(red(str(c), f"a[{c}]") for c in range(3))

    @wp.func_native(f"""
        #if !defined(__CUDA_ARCH__)
        for (int c = 0; c < 3; ++c)
            nodes.data[n][c] += a[c];
        #elif {int(single)} && __CUDA_ARCH__ >= 900
        {at_once if single else ""}
        #else
        {one_by_one}
        #endif
    """)
    def add_vector(nodes: wp.array(dtype=vec4), n: int, a: vec4): ...

    @wp.func_native(f"""
        #if defined(__CUDA_ARCH__)
        {red("0", "value")}
        #else
        nodes.data[n][0] += value;
        #endif
    """)
    def add_first(nodes: wp.array(dtype=vec4), n: int, value: real): ...

    return SimpleNamespace(raise_to=raise_to, add_vector=add_vector, add_first=add_first)
