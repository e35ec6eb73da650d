"""What a history row is made of, side by side on the device: the host sees all of it in one look."""

import numpy as np
import warp as wp

from explicit.kernels import layout as K


class Figures:
    """`energy` (ENERGY_ROWS, columns) and `ledger` (LEDGER_ROWS, columns) float64 (see `explicit.kernels.layout`), and
    `more` numbers float64 for what else is to be seen."""

    def __init__(self, columns: int, more: int, device):
        self.shape = (K.ENERGY_ROWS + K.LEDGER_ROWS, columns)
        self.size = self.shape[0] * columns
        self.array = wp.zeros(self.size + more, dtype=wp.float64, device=device)
        rows = self.array[: self.size].reshape(self.shape)
        self.energy, self.ledger = rows[: K.ENERGY_ROWS], rows[K.ENERGY_ROWS :]
        self.more = self.array[self.size :] if more else None

    def read(self) -> tuple[np.ndarray, np.ndarray]:
        """Energies and ledger (ENERGY_ROWS + LEDGER_ROWS,), their columns added up, and what else there is (more,)."""
        seen = self.array.numpy()
        return seen[: self.size].reshape(self.shape).sum(axis=1), seen[self.size :]


def energies_of(rows: np.ndarray) -> dict[str, float]:
    """The rows of energies and ledger [J] by name."""
    energy, ledger = np.split(rows, [K.ENERGY_ROWS])
    return {
        "KE_points": float(energy[K.KE_POINTS]),
        "KE_grid": float(energy[K.KE_GRID]),
        "E_elastic": float(energy[K.E_ELASTIC]),
        "W_ext": float(ledger[K.WORK_EXTERNAL]),
        "W_damping": float(ledger[K.WORK_DAMPING]),
        "W_plastic": float(ledger[K.WORK_PLASTIC]),
        "W_decay": float(ledger[K.WORK_DECAY]),
    }
