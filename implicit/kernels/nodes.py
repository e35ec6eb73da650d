"""The pressure law of `mpm.drucker_prager` at the nodes, and its slope."""

import warp as wp

from implicit.kernels.layout import LAW, NAME, Material, real

ONE = wp.constant(real(1.0))
node_law, node_slope, node_gap = LAW.node_law, LAW.node_slope, LAW.node_gap


@wp.kernel(module=NAME)
def apply_node_law(
    theta: wp.array(dtype=real),
    material: Material,
    stress: wp.array(dtype=real),
    gap: wp.array(dtype=real),
):
    """Mean stress [Pa] of the nodes at volume strain `theta` [-], and the strain by which they are open [-]."""
    n = wp.tid()
    stress[n] = node_law(theta[n], material)
    gap[n] = node_gap(theta[n], material)


@wp.kernel(module=NAME)
def node_slopes(theta: wp.array(dtype=real), material: Material, blend: real, slope: wp.array(dtype=real)):
    """Slope of the mean stress over K [-], with the share `blend` of the elastic one."""
    n = wp.tid()
    own = node_slope(theta[n], material)
    slope[n] = own + blend * (ONE - own)
