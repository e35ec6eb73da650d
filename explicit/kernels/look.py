"""What a history row says of the points, found where they are: see `explicit.device_look`.

A run that looks at its points on the host does not compile these kernels: they are in a Warp module of their own.
"""

import functools
from types import SimpleNamespace

import warp as wp

from explicit.kernels.layout import VOLUME, layout
from mpm.devices import KERNEL_OPTIONS

# looked: float64 numbers that the host reads. The distances [m] of the two points between which the quantile stands
# and of the farthest one; then, of those lowest along x, y and z and of those highest, the numbers and the positions.
DISTANCES, SIDES = 3, 6
LOOK_SIZE = DISTANCES + SIDES * (1 + 3)


@functools.cache
def look_kernels(real):
    """Return the kernels for `real` (wp.float32 or wp.float64).

    Arrays: `extreme` (6,) of `real`, the least x, y and z of the points and the greatest [m]; `first` (6,) int32, the
    first point that has each.
    """
    types = layout(real)
    name = f"repose_look_{real.__name__}"
    wp.set_module_options(KERNEL_OPTIONS, module=wp.get_module(name))
    vec3, Points = types.vec3, types.Points
    float64 = wp.float64

    @wp.func(module=name)
    def distance(x: vec3, axis: wp.vec2d, plane: int):
        """Distance [m] of a point from the vertical `axis` at (x, y) [m], or from the `plane` x = const there."""
        away = float64(x[0]) - axis[0]
        if plane > 0:
            return wp.abs(away)
        aside = float64(x[1]) - axis[1]
        return wp.sqrt(away * away + aside * aside)

    @wp.kernel(module=name)
    def start_look(
        x: wp.array(dtype=vec3),
        extreme: wp.array(dtype=real),
        first: wp.array(dtype=wp.int32),
    ):
        """Begin with the points that reached farthest at the last look: hardly any other will have to be recorded."""
        side = wp.tid()
        extreme[side] = x[first[side]][side % 3]
        first[side] = x.shape[0]

    @wp.kernel(module=name)
    def look_at_points(
        axis: wp.vec2d,
        plane: wp.int32,
        points: Points,
        theta_start: wp.array(dtype=real),
        keys: wp.array(dtype=real),
        order: wp.array(dtype=wp.int32),
        extreme: wp.array(dtype=real),
        energy: wp.array2d(dtype=float64),
    ):
        """Distances to sort the points by; how far they reach along each axis; volumes over the initial ones, summed.

        `theta_start` (n,): volume strains that the points started with; empty: none."""
        p = wp.tid()
        x = points.x[p]
        keys[p] = real(distance(x, axis, plane))
        order[p] = p
        for side in range(3):
            # Plain reads first: an atomic only where the point lies outside what is recorded.
            if x[side] < extreme[side]:
                wp.atomic_min(extreme, side, x[side])
            if x[side] > extreme[3 + side]:
                wp.atomic_max(extreme, 3 + side, x[side])
        strain = float64(points.theta[p])
        if theta_start.shape[0] > 0:
            strain -= float64(theta_start[p])
        if points.dilated.shape[0] > 0:
            strain += float64(points.dilated[p])
        wp.atomic_add(energy, VOLUME, p % energy.shape[1], wp.exp(strain))

    @wp.kernel(module=name)
    def find_first(
        x: wp.array(dtype=vec3),
        extreme: wp.array(dtype=real),
        first: wp.array(dtype=wp.int32),
    ):
        """The first of the points that reach farthest, as `argmin` and `argmax` of NumPy give it."""
        p = wp.tid()
        for side in range(6):
            if x[p][side % 3] == extreme[side] and p < first[side]:
                wp.atomic_min(first, side, p)

    @wp.kernel(module=name)
    def write_look(
        axis: wp.vec2d,
        plane: wp.int32,
        places: wp.vec3i,
        x: wp.array(dtype=vec3),
        order: wp.array(dtype=wp.int32),
        first: wp.array(dtype=wp.int32),
        looked: wp.array(dtype=float64),
    ):
        """What the host reads: of the points that stand at `places` in the order of their distance, and of the first
        ones on each side."""
        for each in range(3):
            looked[each] = distance(x[order[places[each]]], axis, plane)
        for side in range(6):
            p = first[side]
            looked[3 + side] = float64(p)
            for along in range(3):
                looked[9 + 3 * side + along] = float64(x[p][along])

    return SimpleNamespace(
        start_look=start_look,
        look_at_points=look_at_points,
        find_first=find_first,
        write_look=write_look,
    )
