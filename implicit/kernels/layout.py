"""What the kernels of the implicit step share: types, the Warp module they go into, index names.

Everything is float64: Newton's residual falls over ten orders, which float32 cannot hold.
"""

import warp as wp

from mpm.devices import KERNEL_OPTIONS
from mpm.drucker_prager import drucker_prager
from mpm.gimp import gimp

real = wp.float64
vec3, mat33, vec6 = wp.vec3d, wp.mat33d, wp.types.vector(6, real)
NAME = "repose_implicit"
LAW, BASIS = drucker_prager(real), gimp(real)
Material, LawState = LAW.Material, LAW.LawState

wp.set_module_options(KERNEL_OPTIONS, module=wp.get_module(NAME))

STENCIL = 27  # nodes that a point can reach
NEIGHBOURS = 125  # nodes that can share a point with a node: 5 along each axis
SELF = 62  # place of the node itself among them
OUTSIDE = -1  # in place of a node that is not solved for
