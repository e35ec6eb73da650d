"""Clock, speeds and faults of a solver, side by side on the device: the host sees all of them in one look."""

from dataclasses import dataclass

import numpy as np
import warp as wp

from explicit.kernels import layout as K


@dataclass(frozen=True)
class Seen:
    """What the host has seen: arrays as `explicit.kernels.layout` names their numbers."""

    clock: np.ndarray
    speed: np.ndarray
    fault: np.ndarray


class Dials:
    """`clock` (CLOCK_SIZE,) float64, `speed` (SPEED_SIZE,) of `real` and `fault` (FAULT_SIZE,) int32 on `device`.

    Each look at a GPU waits for all that it was given to do, so what was seen is kept until `forget`. `bytes` (n,)
    uint8 holds all three.
    """

    def __init__(self, real, device):
        kinds = {"clock": (K.CLOCK_SIZE, wp.float64), "speed": (K.SPEED_SIZE, real), "fault": (K.FAULT_SIZE, wp.int32)}
        self._parts, start = {}, 0
        for name, (size, dtype) in kinds.items():
            stop = start + size * wp.types.type_size_in_bytes(dtype)
            self._parts[name], start = (slice(start, stop), wp.dtype_to_numpy(dtype)), stop
        self.bytes = wp.zeros(start, dtype=wp.uint8, device=device)
        self._seen: Seen | None = None
        self.clock, self.speed, self.fault = (
            wp.array(ptr=self.bytes.ptr + self._parts[name][0].start, shape=size, dtype=dtype, device=device)
            for name, (size, dtype) in kinds.items()
        )

    def read(self) -> Seen:
        """What the device holds now."""
        return self.named(self.bytes.numpy())

    def named(self, seen: np.ndarray) -> Seen:
        """The numbers that a copy of `bytes` has."""
        return Seen(**{name: seen[part].view(dtype) for name, (part, dtype) in self._parts.items()})

    @property
    def seen(self) -> Seen:
        """What was seen since the last `forget`; on the CPU what is there now."""
        if self._seen is None:
            self._seen = self.read()
        return self._seen

    def forget(self):
        """The device was given something to do that moves the dials."""
        self._seen = None
