"""Initial stress of a body at rest under its own weight."""

import numpy as np

from mpm.body import Body


def initial_strain(body: Body) -> np.ndarray:
    """Principal Hencky strains (n, 3) that the points of an explicit run start with: none, or the geostatic ones."""
    return geostatic_strain(body) if body.scene.loads.initial_stress == "geostatic" else np.zeros((len(body.x), 3))


def geostatic_strain(body: Body) -> np.ndarray:
    """Principal Hencky strains (n, 3) along x, y, z of the K0 state: sigma_zz = -rho g depth, sigma_xx = sigma_yy =
    nu/(1 - nu) sigma_zz, with the depth below the highest point of the same column of points.

    Without it a cohesionless point would start at the apex of its cone, where it has no stiffness.
    """
    constants, spacing = body.constants, 0.5 * body.scene.grid.cell
    columns = np.unique(np.floor(body.x[:, :2] / spacing).astype(int), axis=0, return_inverse=True)[1].ravel()
    top = np.full(columns.max() + 1, -np.inf)
    np.maximum.at(top, columns, body.x[:, 2])
    depth = top[columns] - body.x[:, 2] + 0.5 * spacing
    vertical = -constants.density * body.scene.loads.gravity * depth
    poisson = body.scene.material.poisson
    horizontal = poisson / (1.0 - poisson) * vertical
    mean = (2.0 * horizontal + vertical) / 3.0
    strain = [
        (stress - mean) / (2.0 * constants.shear) + mean / (3.0 * constants.bulk) for stress in (horizontal, vertical)
    ]
    return np.stack([strain[0], strain[0], strain[1]], axis=1)
