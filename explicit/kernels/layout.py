"""What all kernels of the explicit step share: index names, vector types, structs.

Node arrays hold only the nodes stored by `SparseGrid`; a point reaches node (i, j, k) through
`pencils.base[i - i0, j - j0] + k`, so three nodes of one pencil lie side by side. Time lives on the device in
`clock`: every kernel returns at once when the current step length is zero, which is how a batch of steps
stops early without the host looking in.
"""

import functools
from types import SimpleNamespace

import warp as wp

from mpm.devices import KERNEL_OPTIONS, NOT_NEGATIVE
from mpm.drucker_prager import drucker_prager

# clock: float64 scalars of the running step
TIME, DT, GRAVITY, TARGET, TRAVEL, STEPS = range(6)
CLOCK_SIZE = 6
OUT_OF_NODES = 2.0**100  # distance travelled of points for whose nodes there is no room, until the host makes some
# speed: largest |v| of the points per axis and largest speed at which a point is carried, of the last step
CARRIED = 3
SPEED_SIZE = 4
# fault: index + 1 of a point whose state is not finite, that crossed half a cell in one step, that was turned inside
# out or whose nodes are not stored; 1 where a fixed time step passes the Courant limit h/(c + |v|)
NOT_FINITE, TOO_FAST, INVERTED, OFF_GRID, OVER_LIMIT = range(5)
FAULT_SIZE = 5
# ledger: time integrals [J], a row each; on a GPU spread over columns, so that atomics do not queue on one address
WORK_EXTERNAL, WORK_DAMPING, WORK_PLASTIC, WORK_DECAY = range(4)
LEDGER_ROWS = 4
# energies of one instant [J], spread likewise, and volumes over the initial ones [-], where the device looks at points
KE_POINTS, KE_GRID, E_ELASTIC, VOLUME = range(4)
ENERGY_ROWS = 4
# point arrays (see `Points`), of which a restart needs the first
POINT_STATE = ("x", "lost", "v", "tau", "theta", "dilated", "law_state")
POINT_ARRAYS = (*POINT_STATE, "carry")


@functools.cache
def layout(real):
    """Types and structs for `real` (wp.float32 or wp.float64), and the Warp module all kernels go into."""
    name = f"repose_{real.__name__}"
    wp.set_module_options(KERNEL_OPTIONS, module=wp.get_module(name))
    float64, LawState = wp.float64, drucker_prager(real).LawState
    vec3, vec4, vec6 = (wp.types.vector(length, real) for length in (3, 4, 6))

    @wp.struct
    class Points:
        """State of the points, each array (n,): positions `x` [m], velocities `v` and those that carry points, `carry`
        [m/s], Kirchhoff stress `tau` [Pa] in order xx, yy, zz, yz, xz, xy, volume strain `theta` [-] that bears
        pressure, plastic volume strain `dilated` [-] and `law_state`, what the law remembers; the last two are empty
        where the material has no use for them. `lost` [m]: what float32 has left out of `x`, empty in float64."""

        x: wp.array(dtype=vec3)
        lost: wp.array(dtype=vec3)
        v: wp.array(dtype=vec3)
        carry: wp.array(dtype=vec3)
        tau: wp.array(dtype=vec6)
        theta: wp.array(dtype=real)
        dilated: wp.array(dtype=real)
        law_state: wp.array(dtype=LawState)

    @wp.struct
    class Pencils:
        """Stored nodes: pencil (i, j) of the plan window holds nodes base[i, j] + k."""

        base: wp.array2d(dtype=wp.int32)
        i0: wp.int32
        j0: wp.int32

    @wp.struct
    class Walls:
        """Planes that carry a condition: nodes at or beyond `low`/`high` [node index], codes per face."""

        low: wp.vec3i
        high: wp.vec3i
        low_kind: wp.vec3i
        high_kind: wp.vec3i

    @wp.struct
    class Setup:
        """Constants of a run. `cell` [m], `mass` [kg] and initial `volume` [m3] of a point, `damping` [-], `still`
        [m/s] (no damping below), `decay` [1/s] of the part of a point's velocity that the grid does not see, `fixed_dt`
        [s] (0: adaptive), `wave` P-wave speed [m/s], `gravity` [m/s2], `ramp` [s], `margin` [m] that points may travel
        before the stored nodes must follow."""

        cell: real
        inv_cell: real
        mass: real
        volume: real
        damping: real
        decay: real
        still: real
        cfl: float64
        fixed_dt: float64
        wave: float64
        gravity: float64
        ramp: float64
        margin: float64

    # Compensated sums (Kahan 1965): in float32 a point at x loses what a step adds below 6e-8 |x|, for slow motion all.
    if real == wp.float32:

        @wp.func(module=name)
        def moved(points: Points, p: int, x: vec3, step: vec3):
            """Where point `p` is that a step takes on from `x`; what the sum leaves out is kept for the next one."""
            whole = step + points.lost[p]
            there = x + whole
            points.lost[p] = whole - (there - x)
            return there

    else:

        @wp.func(module=name)
        def moved(points: Points, p: int, x: vec3, step: vec3):
            """Where point `p` is that a step takes on from `x`."""
            return x + step

    @wp.func(module=name)
    def node_of(pencils: Pencils, i: int, j: int, k: int):
        """Index of stored node (i, j, k)."""
        return (pencils.base[(i - pencils.i0) & NOT_NEGATIVE, (j - pencils.j0) & NOT_NEGATIVE] + k) & NOT_NEGATIVE

    return SimpleNamespace(
        name=name,
        moved=moved,
        node_of=node_of,
        vec3=vec3,
        vec4=vec4,
        vec6=vec6,
        LawState=LawState,
        mat33=wp.types.matrix((3, 3), real),
        Points=Points,
        Pencils=Pencils,
        Walls=Walls,
        Setup=Setup,
    )
