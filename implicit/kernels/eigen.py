"""Principal axes of a symmetric 3x3 matrix by Jacobi rotations.

Warp's `eig3` makes a fixed number of approximate rotations and was three quarters of a residual (benchmarks/README.md).
Exact ones converge quadratically: three or four sweeps, none for what is diagonal.
"""

import warp as wp

from implicit.kernels.layout import NAME, mat33, real, vec3

ZERO, HALF, ONE = (wp.constant(real(value)) for value in (0.0, 0.5, 1.0))
NEGLIGIBLE = wp.constant(real(1e-32))  # square of what is left beside the diagonal, over the square of the matrix
MOST_SWEEPS = 10


@wp.func(module=NAME)
def turn(first: real, second: real, between: real):
    """Cosine, sine and tangent of the rotation that takes `between` from [[first, between], [between, second]]."""
    gap = HALF * (second - first)
    square = gap * gap + between * between
    if square == ZERO:
        return ONE, ZERO, ZERO
    root = wp.sqrt(square)
    t = between / wp.where(gap < ZERO, gap - root, gap + root)
    c = ONE / wp.sqrt(ONE + t * t)
    return c, t * c, t


@wp.func(module=NAME)
def eigen(a: mat33):
    """Orthonormal eigenvectors (columns) and eigenvalues of symmetric `a`, in no order."""
    xx, yy, zz = a[0, 0], a[1, 1], a[2, 2]
    xy, xz, yz = a[0, 1], a[0, 2], a[1, 2]
    x, y, z = vec3(ONE, ZERO, ZERO), vec3(ZERO, ONE, ZERO), vec3(ZERO, ZERO, ONE)
    sweep = wp.int32(0)
    while sweep < MOST_SWEEPS:
        beside = xy * xy + xz * xz + yz * yz
        if beside <= NEGLIGIBLE * (xx * xx + yy * yy + zz * zz + beside):
            sweep = MOST_SWEEPS
        else:
            sweep += 1
            c, s, t = turn(xx, yy, xy)
            xx, yy, xy = xx - t * xy, yy + t * xy, ZERO
            xz, yz = c * xz - s * yz, s * xz + c * yz
            x, y = c * x - s * y, s * x + c * y
            c, s, t = turn(xx, zz, xz)
            xx, zz, xz = xx - t * xz, zz + t * xz, ZERO
            xy, yz = c * xy - s * yz, s * xy + c * yz
            x, z = c * x - s * z, s * x + c * z
            c, s, t = turn(yy, zz, yz)
            yy, zz, yz = yy - t * yz, zz + t * yz, ZERO
            xy, xz = c * xy - s * xz, s * xy + c * xz
            y, z = c * y - s * z, s * y + c * z
    return wp.matrix_from_cols(x, y, z), vec3(xx, yy, zz)
