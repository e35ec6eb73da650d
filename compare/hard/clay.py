"""A block of clay (phi = 0) between a symmetry plane and a free face, in plane strain: what locks would stand.

A vertical cut in clay stands up to 3.83 c/(rho g) (circular slip); the tall block is 2.6 times as high.
"""

from compare.hard.case import Finding, hard_case
from compare.hard.collapse import DAMPED, collapse, runout, same, story
from mpm.theory import critical_height

COHESION, DENSITY = 1500.0, 1900.0  # [Pa], [kg/m3]
TALL, LENGTH, WIDTH = 0.8, 0.8, 0.2  # [m]
CLAY = (
    "geometry.walls={x_min='roller', y_min='roller', y_max='roller', z_min='fixed'}",
    "material.model=drucker_prager",
    "material.friction_angle=0.0",
    f"material.cohesion={COHESION}",
    f"material.density={DENSITY}",
    "loads.initial_stress=geostatic",
    DAMPED,
)
FINE = 0.05  # [m], cells of the low cuts, whose height goes in halves of it
LOWEST, HIGHEST = 9, 17  # half cells: one stands, one falls
ENDS = {"explicit": ("explicit.until=3.0",), "implicit": ("implicit.max_steps=40",)}


def block(mode: str, height: float, cell: float, *settings: str):
    """The run of a block of `height` [m]."""
    size = f"geometry.size=[{LENGTH}, {WIDTH}, {height!r}]"
    return collapse(mode, "self_weight", *CLAY, size, f"grid.cell={cell!r}", *settings)


def falls(mode: str, halves: int) -> bool:
    """Whether a cut of so many half cells runs out beyond where it stood."""
    return runout(block(mode, halves * FINE / 2, FINE, *ENDS[mode])) > 0.0


@hard_case("clay", on_ranks=True)
def clay():
    """The tall block collapses, at nu = 0.499 as at 0.3, and low cuts stand up to the height that theory gives."""
    yield from _collapses("explicit")
    yield from _critical("explicit")
    yield from _incompressible("explicit")


@hard_case("clay, implicit", on_ranks=True)
def clay_implicit():
    """Likewise, but for nu = 0.499."""
    yield from _collapses("implicit")
    yield from _critical("implicit")


@hard_case("clay, nearly incompressible, implicit", slow=True, on_ranks=True)
def clay_incompressible_implicit():
    """nu = 0.499: clay keeps its moduli, so that Newton needs ten times as many iterations."""
    yield from _incompressible("implicit")


def _collapses(mode):
    run = block(mode, TALL, 0.1)
    reason = "2.6 times the critical height: with the pressure law at the points it stood"
    yield Finding(
        "tall block: height left, over h0", mode, run.last_row["height"] / TALL, 0.85, reason, story(run), run
    )


def _critical(mode):
    low, high = LOWEST, HIGHEST
    if falls(mode, low) or not falls(mode, high):
        low = high = 0
    while high - low > 1:
        middle = (low + high) // 2
        low, high = (low, middle) if falls(mode, middle) else (middle, high)
    height, theory = (low + high) / 2 * FINE / 2, critical_height(COHESION, DENSITY, 9.81, 0.0)
    note = f"stands at {low * FINE / 2:.3f} m, falls at {high * FINE / 2:.3f} m; 3.83 c/(rho g) = {theory:.3f} m"
    reason = "by bisection in half cells, 8 % of it"
    yield Finding("critical height, off 3.83 c/(rho g)", mode, abs(height / theory - 1.0), 0.15, reason, note)


def _incompressible(mode):
    stiff = block(mode, TALL, 0.1, "material.poisson=0.499")
    reason = "what flows at constant volume does not ask for nu"
    yield same("tall block, nu = 0.499", stiff, block(mode, TALL, 0.1), 0.10, reason)
