"""Snapshots of a results store as files of other programs: fields chosen, those that follow from others among them."""

from pathlib import Path

import numpy as np

from mpm.errors import SceneError
from mpm.fields import FOLLOWS, STRESS, UNITS, follow, following
from mpm.results import Results

CSV_INDEX = "snapshots.csv"


class Snapshots:
    """The snapshots of a run, with the fields `names`: by default all that they hold or that follows from these.

    Raises SceneError where there is no snapshot, or for a field that there is not.
    """

    def __init__(self, results: Results, names: list[str] | None = None):
        if results.snapshot_count == 0:
            raise SceneError(f"{results.directory} has no snapshot to write")
        self.results = results
        self.stored = [name for name in results.field_names if name != "x"]
        self.constants = results.scene.material.constants()
        available = [*self.stored, *following(self.stored, self.constants)]
        if unknown := [name for name in names or () if name not in available]:
            raise SceneError(f"no field {', '.join(unknown)} in {results.directory}: it has {', '.join(available)}")
        self.names = available if names is None else list(dict.fromkeys(names))

    def __iter__(self):
        """Each snapshot: "time" [s], "step", "x" (n, 3) [m] and the fields, as `Results.snapshot` gives them."""
        computed = [name for name in self.names if name not in self.stored]
        needed = set(self.names).union(*(FOLLOWS[name][0] for name in computed)) - set(computed)
        for index in range(self.results.snapshot_count):
            snapshot = self.results.snapshot(index, ["x", *sorted(needed)])
            for name in computed:
                snapshot[name] = follow(name, snapshot.get, self.constants).astype(np.float32)
            yield snapshot


def write_csv(results: Results, fields: list[str] | None = None, directory=None) -> Path:
    """Write every snapshot as a table, a point a line, and return the path of snapshots.csv, which lists them.

    A table's first line names its columns with their units: x [m], y [m], z [m], then `fields` (see `Snapshots`), a
    column a component. directory: where to, by default csv/ in the run directory. Raises SceneError as `Snapshots`.
    """
    snapshots = Snapshots(results, fields)
    folder = Path(directory) if directory is not None else results.directory / "csv"
    folder.mkdir(parents=True, exist_ok=True)
    lines = ["file,time [s],step"]
    for index, snapshot in enumerate(snapshots):
        file = f"{index:06d}.csv"
        columns = [snapshot["x"], *(snapshot[name] for name in snapshots.names)]
        heading = ["x [m]", "y [m]", "z [m]"]
        heading += [word for name in snapshots.names for word in _columns(name, snapshot[name])]
        # Nine digits give single precision back to the bit.
        np.savetxt(folder / file, np.column_stack(columns), "%.9g", ",", header=",".join(heading), comments="")
        lines.append(f"{file},{snapshot['time']!r},{snapshot['step']}")
    path = folder / CSV_INDEX
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path


def _columns(name: str, values: np.ndarray) -> list[str]:
    """Headings of a field's columns."""
    components = {1: ("",), 3: ("_x", "_y", "_z"), 6: tuple(f"_{pair}" for pair in STRESS)}
    width = 1 if values.ndim == 1 else values.shape[1]
    return [f"{name}{component} [{UNITS[name]}]" for component in components[width]]
