"""Face ghost penalty on the displacement increment (Burman 2010; for MPM, Coombs 2023).

Across a face between two cells, [[d_n u]] = (u_- - 2 u_0 + u_+)/h at each of its four nodes. With the nodes
lumped, the penalty is a spring on the second difference along the face's normal: it ties the displacement of
nodes that hardly any material touches to that of the nodes behind them, and lets every linear motion pass.
"""

import warp as wp

from implicit.kernels.layout import NAME, SELF, mat33, real, vec3

TWO = wp.constant(real(2.0))


@wp.kernel(module=NAME)
def ghost_force(
    triple: wp.array(dtype=wp.vec3i),
    strength: real,
    u: wp.array(dtype=vec3),
    force: wp.array(dtype=vec3),
):
    """Add the penalty's force [N] to `force`; `triple` nodes (-, 0, +), `strength` [N/m] of the springs."""
    t = wp.tid()
    i, j, k = triple[t][0], triple[t][1], triple[t][2]
    pull = strength * (u[i] - TWO * u[j] + u[k])
    wp.atomic_add(force, i, pull)
    wp.atomic_add(force, j, -TWO * pull)
    wp.atomic_add(force, k, pull)


@wp.kernel(module=NAME)
def ghost_stiffness(
    triple: wp.array(dtype=wp.vec3i),
    strength: real,
    stride: wp.array(dtype=wp.int32),
    place: wp.array2d(dtype=wp.int32),
    values: wp.array(dtype=mat33),
):
    """Add the penalty's stiffness; `stride` is the place of the next node along the axis among 125 neighbours."""
    t = wp.tid()
    one = strength * wp.identity(3, dtype=real)
    step = stride[t]
    for a in range(3):
        for b in range(3):
            factor = real(1.0)
            if a == 1:
                factor = -TWO
            if b == 1:
                factor = -TWO * factor
            wp.atomic_add(values, place[triple[t][a], SELF + (b - a) * step], factor * one)
