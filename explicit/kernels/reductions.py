"""Sums and maxima that many points share, beside the four-component sums of `simd`.

On a GPU each is one reduction that hands nothing back. Warp's own maximum of real numbers is a loop of
compare-and-swap, which all threads run on one address.
"""

import functools
from types import SimpleNamespace

import warp as wp

from mpm.gimp import NODES_PER_AXIS

NODES = NODES_PER_AXIS**3  # that a point reaches, a lane of a warp for each


@functools.cache
def reductions(real):
    """Return the functions for `real` (wp.float32 or wp.float64).

    Members: `raise_to(slots, i, value)`: slots[i] = max(slots[i], value) for numbers >= 0, NaN is passed over;
    `add_node(nodes, n, a)`: nodes[n] += a (vec4), from the first 27 lanes of a warp, all of which call it together; no
    zeros are added;
    `add_first(nodes, n, value)`: the first component of nodes[n] += value.
    """
    vec4 = wp.types.vector(4, real)
    single = real == wp.float32
    number, suffix, register = ("float", "f32", "f") if single else ("double", "f64", "d")

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

    def red(address: str, value: str) -> str:
        return f'asm volatile("red.global.add.{suffix} [%0], %1;" :: "l"({address}), "{register}"({value}) : "memory");'

    def by_fours(storage: str, thread: str, sync: str, add: str) -> str:
        """Lanes hand over what they add in `storage`; then each four of them add the numbers of one lane at a time."""
        return f"""
            {storage}
            const int lane = {thread}, part = lane & 3;
            for (int q = 0; q < 4; ++q)
                given[lane][q] = a[q];
            of[lane] = n;
            {sync}
            #pragma unroll
            for (int from = lane >> 2; from < {NODES}; from += 8) {{
                const {number} value = given[from][part];
                {number}* at = &nodes.data[of[from]][part];
                if (value != 0) {{
                    {add}
                }}
            }}
            {sync}
        """

    on_gpu = by_fours(
        f"""
            typedef {number} four[4];
            __shared__ __align__(16) four given_all[WP_TILE_BLOCK_DIM];
            __shared__ int of_all[WP_TILE_BLOCK_DIM];
            four* given = given_all + (threadIdx.x & ~31);
            int* of = of_all + (threadIdx.x & ~31);
        """,
        "threadIdx.x & 31",
        "__syncwarp();",
        red("at", "value"),
    )
    in_blocks = by_fours(
        f"static {number} given[32][4]; static int of[32];",
        "WP_TILE_THREAD_IDX",
        "wp::tile_sync<WP_TILE_BLOCK_DIM>();",
        "*at += value;",
    )
    at_once = f"""
        if ((threadIdx.x & 31) < {NODES} && (a[0] != 0 || a[1] != 0 || a[2] != 0 || a[3] != 0))
            asm volatile("red.global.add.v4.f32 [%0], {{%1, %2, %3, %4}};"
                :: "l"(nodes.data + n), "f"(a[0]), "f"(a[1]), "f"(a[2]), "f"(a[3]) : "memory");
    """

    # The cost of reductions goes with the sectors of 32 bytes that an instruction of a warp touches: eight where four
    # lanes add the numbers of one node, 32 where each lane adds a number to a node of its own.
    @wp.func_native(f"""
        #if !defined(__CUDA_ARCH__)
        {in_blocks}
        #elif {int(single)} && __CUDA_ARCH__ >= 900
        {at_once}
        #else
        {on_gpu}
        #endif
    """)
    def add_node(nodes: wp.array(dtype=vec4), n: int, a: vec4): ...

    @wp.func_native(f"""
        #if defined(__CUDA_ARCH__)
        {red("&nodes.data[n][0]", "value")}
        #else
        nodes.data[n][0] += value;
        #endif
    """)
    def add_first(nodes: wp.array(dtype=vec4), n: int, value: real): ...

    return SimpleNamespace(raise_to=raise_to, add_node=add_node, add_first=add_first)
