"""What walls hold of the increment on the background mesh."""

import numpy as np
import pytest

from mpm.devices import start_warp
from mpm.errors import SceneError
from mpm.walls import FIXED, FREE, NOWHERE, ROLLER, TANGENTIAL, Walls

pytest.importorskip("implicit._dolfinx", reason="dolfinx or petsc4py is not installed", exc_type=SceneError)
from implicit.mesh import BackgroundMesh

CELL = 0.5


@pytest.mark.parametrize("axis", range(3))
@pytest.mark.parametrize(
    ("kind", "normal", "tangential"),
    [(FREE, False, False), (ROLLER, True, False), (FIXED, True, True), (TANGENTIAL, False, True)],
)
def test_a_wall_holds_the_components_of_its_kind(axis, kind, normal, tangential):
    """On its plane and beyond; at a lower wall and at an upper one."""
    start_warp()
    nowhere, free = np.full(3, NOWHERE), np.full(3, FREE)
    plane, kinds = nowhere.copy(), free.copy()
    plane[axis], kinds[axis] = 1, kind
    for walls in (Walls(plane, nowhere, kinds, free), Walls(-nowhere, plane, free, kinds)):
        background = BackgroundMesh(CELL, walls)
        background.follow(np.array([[0, 0, 0], [1, 0, 0]]))
        nodes = np.argwhere(background.dof_of >= 0)
        held = background.held[background.dof_of[tuple(nodes.T)]]
        at = (nodes + background.corner)[:, axis]
        beyond = at <= 1 if walls.low is plane else at >= 1
        expected = np.where(np.arange(3) == axis, normal, tangential)
        assert np.all(held[beyond] == expected) and not held[~beyond].any()
