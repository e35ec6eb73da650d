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
    `add_pencil(nodes, n, a, b, c, reached, parts)`: a, b, c (vec4) to nodes n, n + 1, n + 2, of these the first
    `reached`, of each the first `parts` components, those beyond being 0; all threads of a warp call it together;
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

    def by_fours(storage: str, lane: str, sync: str, add: str) -> str:
        """Points hand over what they add in `storage`; then each four of them add one node of one of them at a time."""
        return f"""
            {storage}
            const int lane = {lane}, part = lane & 3;
            for (int q = 0; q < 4; ++q) {{
                given[lane][q] = a[q];
                given[lane][4 + q] = b[q];
                given[lane][8 + q] = c[q];
            }}
            first[lane] = n;
            reach[lane] = reached;
            {sync}
            if (part < parts) {{
                #pragma unroll
                for (int r = 0; r < 4; ++r) {{
                    const int from = lane - part + r;
                    #pragma unroll
                    for (int k = 0; k < 3; ++k)
                        if (k < reach[from]) {{
                            {number}* at = &nodes.data[first[from] + k][part];
                            const {number} value = given[from][4 * k + part];
                            {add}
                        }}
                }}
            }}
            {sync}
        """

    row = 12 if single else 14  # numbers from one lane's to the next, so that fewer of them meet in a bank
    on_gpu = by_fours(
        f"""
            constexpr int warps = WP_TILE_BLOCK_DIM / 32;
            typedef {number} row[{row}];
            __shared__ __align__(16) row given_all[warps][32];
            __shared__ int first_all[warps][32], reach_all[warps][32];
            row* given = given_all[threadIdx.x >> 5];
            int *first = first_all[threadIdx.x >> 5], *reach = reach_all[threadIdx.x >> 5];
        """,
        "threadIdx.x & 31",
        "__syncwarp();",
        red("at", "value"),
    )
    in_blocks = by_fours(
        f"static {number} given[32][{row}]; static int first[32], reach[32];",
        "WP_TILE_THREAD_IDX & 31",
        "wp::tile_sync<WP_TILE_BLOCK_DIM>();",
        "*at += value;",
    )
    at_once = "".join(
        f"""
            if ({k} < reached)
                asm volatile("red.global.add.v4.f32 [%0], {{%1, %2, %3, %4}};" :: "l"(nodes.data + n + {k}),
                    "f"({v}[0]), "f"({v}[1]), "f"({v}[2]), "f"({v}[3]) : "memory");
        """
        for k, v in enumerate("abc")
    )

    # The cost of reductions goes with the sectors of 32 bytes that an instruction of a warp touches: eight where four
    # lanes add the numbers of one node, 32 where each lane adds a number to a node of its own.
    @wp.func_native(f"""
        #if !defined(__CUDA_ARCH__) && WP_TILE_BLOCK_DIM < 32
        for (int q = 0; q < 4; ++q) {{
            if (0 < reached) nodes.data[n][q] += a[q];
            if (1 < reached) nodes.data[n + 1][q] += b[q];
            if (2 < reached) nodes.data[n + 2][q] += c[q];
        }}
        #elif !defined(__CUDA_ARCH__)
        {in_blocks}
        #elif {int(single)} && __CUDA_ARCH__ >= 900
        {at_once if single else ""}
        #else
        {on_gpu}
        #endif
    """)
    def add_pencil(nodes: wp.array(dtype=vec4), n: int, a: vec4, b: vec4, c: vec4, reached: int, parts: int): ...

    @wp.func_native(f"""
        #if defined(__CUDA_ARCH__)
        {red("&nodes.data[n][0]", "value")}
        #else
        nodes.data[n][0] += value;
        #endif
    """)
    def add_first(nodes: wp.array(dtype=vec4), n: int, value: real): ...

    return SimpleNamespace(raise_to=raise_to, add_pencil=add_pencil, add_first=add_first)
