"""Moduli that a cohesionless collapse is followed with, and what a large bulk modulus acts on.

The deposit of a cohesionless collapse rests on friction and volume and not on elastic strains of a thousandth, and the
stress at rest balances gravity whatever the moduli: they are limited where they would only cost steps. What has
cohesion can stand, and what is elastic does: there elastic displacements matter, and the moduli are kept.
"""

from dataclasses import replace

from mpm.body import Body
from mpm.drucker_prager import Constants

STIFFEST = 600.0  # Young's modulus over rho g h0: with nu = 0.3 the base is compressed by 0.2 % of its height at most
OF_BULK, OF_SHEAR = 1.2, 2.6  # E/K = 3 (1 - 2 nu) and E/G = 2 (1 + nu) of nu = 0.3

MOST_OF_RIPPLES = 10.0  # K over G, as of nu = 0.452, that ripples of the volume strain are resisted with at most
SMOOTHINGS = 2  # of the nodes' volume strain, to tell what is smooth from ripples


def ripple_share(constants: Constants) -> float:
    """Share of K [-] that resists ripples of the nodes' volume strain; 1 up to K = `MOST_OF_RIPPLES` G.

    A pressure that changes sign from node to node does hardly any work on what nodes displace (nodal pressures and
    displacements of one order miss the inf-sup condition), so that it grows with K: in an elastic column at nu = 0.499
    pressures were off by 0.28 and 0.12 rho g h0 in the mean on 4 and 8 cells per r0. In each step the solvers take

        share d_i + (1 - share) S S d_i

    for a node's average d_i of the points' volume strain increments, S the nodes' average of what points read of
    nodes: 0.06 and 0.02 rho g h0 (tests/implicit/test_ripples.py). What is smooth feels all of K. It is akin to a
    pressure Laplacian of h^2/G (Brezzi and Pitkaranta 1984).
    """
    return min(1.0, MOST_OF_RIPPLES * constants.shear / constants.bulk)


def limit_bulk(body: Body) -> Body:
    """The body with K at most that of E = `STIFFEST` rho g h0 and nu = 0.3, or G times that of nu = 0.3 where more.

    As nu -> 0.5 K grows without bound and the explicit time step falls as 1/sqrt(K), for a volume that less of it keeps
    as well. And pressure waves, which hardly anything damps, then let the cone give way at each of their troughs: at
    nu = 0.499, K = 5e4 rho g h0, a column of lambda0 = 1 ran half as far again (D = 0.05).
    """
    constants = body.constants
    most = max(STIFFEST * body.overburden / OF_BULK, OF_SHEAR / OF_BULK * constants.shear)
    return _with(body, min(constants.bulk, most), constants.shear)


def limit_both(body: Body, stiffest: float) -> Body:
    """The body with K and G at most those of E = `stiffest` rho g h0 and nu = 0.3.

    A stiffer material has its kinks closer together, in displacement by the ratio of the moduli, and Newton needs as
    many more steps: benchmarks/results/implicit_stiffness_cpu.csv. A heap that stands settles by h0/600 too much, at
    most.
    """
    constants, most = body.constants, stiffest * body.overburden
    return _with(body, min(constants.bulk, most / OF_BULK), min(constants.shear, most / OF_SHEAR))


def _with(body: Body, bulk: float, shear: float) -> Body:
    constants = body.constants
    if not constants.plastic or constants.xi > 0:
        return body
    return replace(body, constants=replace(constants, bulk=bulk, shear=shear))
