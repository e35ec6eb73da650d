"""Moduli that the explicit solver follows a collapse with, where the material's own would only cost time steps."""

from dataclasses import replace

from mpm.body import Body

INCOMPRESSIBLE = 500.0  # K over rho g h0: the base is compressed by 0.2 % of its height at most
BULK_OVER_SHEAR = 2.6 / 1.2  # of nu = 0.3


def limit_bulk(body: Body) -> Body:
    """The body with K at most `INCOMPRESSIBLE` rho g h0, or G times that of nu = 0.3 where this is more.

    So for cohesionless material, whose deposit rests on friction and volume. As nu -> 0.5 K grows without bound and the
    time step falls as 1/sqrt(K), for a volume that less of it keeps as well. And pressure waves, which hardly anything
    damps, then let the cone give way at each of their troughs: at nu = 0.499, K = 5e4 rho g h0, a column of lambda0 = 1
    ran half as far again (D = 0.05). What has cohesion can stand, and keeps its moduli.
    """
    constants = body.constants
    if not constants.plastic or constants.xi > 0:
        return body
    weight = constants.density * body.scene.loads.gravity * body.height
    most = max(INCOMPRESSIBLE * weight, BULK_OVER_SHEAR * constants.shear)
    return replace(body, constants=replace(constants, bulk=min(constants.bulk, most)))
