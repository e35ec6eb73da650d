"""Sums over the nodes that ranks share, on a device: what this rank has of them in one buffer, and all added up."""

import functools
from types import SimpleNamespace

import warp as wp

from explicit.kernels.layout import DT
from mpm.devices import KERNEL_OPTIONS


@functools.cache
def halo_kernels(real):
    """Return the kernels for `real` (wp.float32 or wp.float64).

    They are in a Warp module of their own, which runs on one rank do not compile. `first` (nodes, w) and `second`
    (nodes, u) are node arrays as plain numbers, `second` perhaps with u = 0; a row of a buffer has the w + u numbers of
    a node. A thread takes one number.
    """
    name = f"repose_halo_{real.__name__}"
    wp.set_module_options(KERNEL_OPTIONS, module=wp.get_module(name))
    zero = wp.constant(real(0.0))

    @wp.kernel(module=name)
    def pack(
        first: wp.array2d(dtype=real),
        second: wp.array2d(dtype=real),
        nodes: wp.array(dtype=wp.int32),
        packed: wp.array2d(dtype=real),
    ):
        """Row r of `packed`: the numbers of node `nodes[r]`."""
        row, column = wp.tid()
        width = first.shape[1]
        if column < width:
            packed[row, column] = first[nodes[row], column]
        else:
            packed[row, column] = second[nodes[row], column - width]

    @wp.kernel(module=name)
    def add_up(
        clock: wp.array(dtype=wp.float64),
        first: wp.array2d(dtype=real),
        second: wp.array2d(dtype=real),
        nodes: wp.array(dtype=wp.int32),
        starts: wp.array(dtype=wp.int32),
        rows: wp.array(dtype=wp.int32),
        received: wp.array2d(dtype=real),
    ):
        """Node `nodes[p]` gets the sum of the rows `rows[starts[p]]` to `rows[starts[p + 1] - 1]` of `received`, in
        that order; -1 stands for what the node holds itself."""
        if clock[DT] == wp.float64(0.0):
            return
        place, column = wp.tid()
        node = nodes[place]
        width = first.shape[1]
        own = zero
        if column < width:  # noqa: SIM108 (Warp would read both)
            own = first[node, column]
        else:
            own = second[node, column - width]
        total = zero
        for part in range(starts[place], starts[place + 1]):
            if rows[part] < 0:
                total += own
            else:
                total += received[rows[part], column]
        if column < width:
            first[node, column] = total
        else:
            second[node, column - width] = total

    return SimpleNamespace(pack=pack, add_up=add_up)
