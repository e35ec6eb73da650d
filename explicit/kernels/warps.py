"""What the 32 threads of a warp do together: hand values over, find who has the same.

All of a warp call these functions together, in blocks of whole warps. On a CPU Warp's block runtime runs blocks of 32.
"""

import functools
from types import SimpleNamespace

import warp as wp

WARP = 32


@functools.cache
def warps(real):
    """Return the functions for `real` (wp.float32 or wp.float64).

    Members: `lane()`: number of the thread in its warp;
    `lanes_below(count, thread)`: mask of those lanes whose thread numbers are below `count`, `thread` is the caller's;
    `first(mask)`: the lowest lane of a mask that has one;
    `same(key)`: mask of the lanes that have the same `key` >= 0; what lanes have handed over before can be read after;
    `of_lane(value, lane)`: the integer that `lane` has.

    A row is what a lane hands over, numbers in memory that the block shares, 28 (`wide_row(lane)`) or 12
    (`narrow_row(lane)`): `put(row, at, a)`: numbers `at` to `at` + 3, `at` a multiple of 4, become those of `a` (vec4);
    `four(row, at)`, likewise (vec4), `two(row, at)`, `at` even (vec2), and `one(row, at)` give them back.
    """
    vec2, vec4 = wp.types.vector(2, real), wp.types.vector(4, real)
    single = real == wp.float32
    number, suffix, register = ("float", "f32", "f") if single else ("double", "f64", "d")

    def either(on_gpu: str, in_blocks: str) -> str:
        return f"""
        #if defined(__CUDA_ARCH__)
        {on_gpu}
        #else
        static_assert(WP_TILE_BLOCK_DIM == {WARP}, "a block on a CPU is one warp");
        {in_blocks}
        #endif
        """

    sync = "wp::tile_sync<WP_TILE_BLOCK_DIM>();"

    @wp.func_native(either("return threadIdx.x & 31;", "return WP_TILE_THREAD_IDX;"))
    def lane() -> int: ...

    @wp.func_native("""
        const int there = count - (thread & ~31);
        return there < 32 ? (1u << there) - 1u : 0xffffffffu;
    """)
    def lanes_below(count: int, thread: int) -> wp.uint32: ...

    @wp.func_native(either("return __ffs((int)mask) - 1;", "return __builtin_ctz(mask);"))
    def first(mask: wp.uint32) -> int: ...

    @wp.func_native(
        either(
            "__syncwarp(); return __match_any_sync(0xffffffffu, key);",
            f"""
            static int keys[{WARP}];
            keys[WP_TILE_THREAD_IDX] = key;
            {sync}
            unsigned mask = 0;
            for (int other = 0; other < {WARP}; ++other)
                mask |= (unsigned)(keys[other] == key) << other;
            {sync}
            return mask;
            """,
        )
    )
    def same(key: int) -> wp.uint32: ...

    @wp.func_native(
        either(
            "return __shfl_sync(0xffffffffu, value, lane);",
            f"""
            static int values[{WARP}];
            values[WP_TILE_THREAD_IDX] = value;
            {sync}
            const int given = values[lane];
            {sync}
            return given;
            """,
        )
    )
    def of_lane(value: int, lane: int) -> int: ...

    # Rows lie 28 or 12 numbers apart: of eight neighbours no two reach the same bank with 16 bytes, as float32.
    def row(numbers: int) -> str:
        return either(
            f"""
            __shared__ __align__(16) {number} rows[WP_TILE_BLOCK_DIM][{numbers}];
            return __cvta_generic_to_shared(rows[(threadIdx.x & ~31) + lane]);
            """,
            f"""
            alignas(16) static {number} rows[{WARP}][{numbers}];
            return (wp::uint64)rows[lane];
            """,
        )

    @wp.func_native(row(28))
    def wide_row(lane: int) -> wp.uint64: ...

    @wp.func_native(row(12))
    def narrow_row(lane: int) -> wp.uint64: ...

    size = 4 if single else 8
    widest = 16 // size  # numbers that an instruction moves

    def store(values: list[str]) -> str:
        """PTX that puts two or more numbers into shared memory."""
        code = ""
        for k in range(0, len(values), widest):
            operands = ", ".join(f'"{register}"({value})' for value in values[k : k + widest])
            slots = ", ".join(f"%{slot + 1}" for slot in range(widest))
            code += f"""asm volatile("st.shared.v{widest}.{suffix} [%0+{k * size}], {{{slots}}};"
                :: "r"((unsigned)row + {size} * at), {operands} : "memory");"""
        return code

    def load(values: list[str]) -> str:
        """PTX that gets numbers out of shared memory."""
        code, wide = "", min(widest, len(values))
        for k in range(0, len(values), wide):
            operands = ", ".join(f'"={register}"({value})' for value in values[k : k + wide])
            slots = ", ".join(f"%{slot}" for slot in range(wide))
            into = f".v{wide}.{suffix} {{{slots}}}" if wide > 1 else f".{suffix} {slots}"
            code += f"""asm volatile("ld.shared{into}, [%{wide}+{k * size}];"
                : {operands} : "r"((unsigned)row + {size} * at) : "memory");"""
        return code

    def get(many: int) -> str:
        kind, parts = f"wp::vec_t<{many}, {number}>", [f"v[{k}]" for k in range(many)]
        if many == 1:
            kind, parts = number, ["v"]
        in_blocks = "".join(f"{part} = (({number}*)row)[at + {k}];" for k, part in enumerate(parts))
        return f"{kind} v; {either(load(parts), in_blocks)} return v;"

    parts = [f"a[{k}]" for k in range(4)]
    in_blocks = "".join(f"(({number}*)row)[at + {k}] = {part};" for k, part in enumerate(parts))

    @wp.func_native(either(store(parts), in_blocks))
    def put(row: wp.uint64, at: int, a: vec4): ...

    @wp.func_native(get(4))
    def four(row: wp.uint64, at: int) -> vec4: ...

    @wp.func_native(get(2))
    def two(row: wp.uint64, at: int) -> vec2: ...

    @wp.func_native(get(1))
    def one(row: wp.uint64, at: int) -> real: ...

    return SimpleNamespace(
        lane=lane,
        lanes_below=lanes_below,
        first=first,
        same=same,
        of_lane=of_lane,
        wide_row=wide_row,
        narrow_row=narrow_row,
        put=put,
        four=four,
        two=two,
        one=one,
    )
