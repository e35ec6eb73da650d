"""The results store of one run: snapshots, history, provenance and restart. The one thing solvers hand on.

A run directory holds

    results.h5       root attributes `scene` and `provenance` (JSON);
                     static/NAME; snapshots/000000/FIELD with attributes `time` [s] and `step`; history/COLUMN
    checkpoint.h5    the newest restart state, replaced whole
    summary.json     written when the run ends
    vtk/, *.png      made from the above by `mpm.vtk` and `compare.plots`

Arrays keep the precision they are given in. All quantities are SI.
"""

import json
import math
import os
from contextlib import contextmanager, suppress
from pathlib import Path

import h5py
import numpy as np

from mpm.errors import SceneError

RESULTS, CHECKPOINT, SUMMARY = "results.h5", "checkpoint.h5", "summary.json"
PLOTS = ("morphology.png", "profile.png", "history.png")
_SNAPSHOT_STORAGE = {"compression": "gzip", "compression_opts": 1, "shuffle": True}


class Results:
    """A run directory. Make one with `Results.create` or `Results.open`.

    The HDF5 file is open only while a method runs, so that a run killed between two calls leaves it whole.
    Reading methods raise SceneError where the file is not readable HDF5; writing methods raise OSError.
    """

    def __init__(self, directory):
        self.directory = Path(directory)

    @classmethod
    def create(cls, directory, scene: dict, provenance: dict, force: bool = False) -> "Results":
        """Start a run in `directory`, made if need be.

        scene: the resolved scene, JSON types only. provenance: flat, str or number (versions, device, ...).
        Raises SceneError for a folder that is not empty (unless `force`) or cannot be written.
        `force` removes the files of an earlier run there and nothing else.
        """
        results = cls(directory)
        folder = results.directory
        try:
            folder.mkdir(parents=True, exist_ok=True)
            if force:
                _remove_run_files(folder)
            elif any(folder.iterdir()):
                raise SceneError(
                    f"{folder} is not empty: `--force` replaces the run in it, `repose resume {folder}` continues it"
                )
            # Python's own open gives the plain reason ("Permission denied"); HDF5 buries it in a paragraph.
            (folder / RESULTS).touch()
            with h5py.File(folder / RESULTS, "w") as file:
                file.attrs["scene"] = json.dumps(scene)
                file.attrs["provenance"] = json.dumps(provenance)
                for group in ("static", "snapshots", "history"):
                    file.create_group(group)
        except OSError as error:
            raise SceneError(f"cannot write to {folder}: {error.strerror or error}") from error
        return results

    @classmethod
    def open(cls, directory) -> "Results":
        """An existing run. Raises SceneError where results.h5 is missing, unreadable or not Repose's."""
        results = cls(directory)
        path = results.directory / RESULTS
        if not path.is_file():
            raise SceneError(f"no run in {results.directory}: {RESULTS} is missing")
        with results._reading() as file:
            if "scene" not in file.attrs or "snapshots" not in file:
                raise SceneError(f"{path} is HDF5, but not a Repose results file")
        return results

    @property
    def scene(self) -> dict:
        """The resolved scene of the run."""
        with self._reading() as file:
            return json.loads(file.attrs["scene"])

    @property
    def provenance(self) -> dict:
        """What made the run: versions, device, precision, git commit."""
        with self._reading() as file:
            return json.loads(file.attrs["provenance"])

    @property
    def times(self) -> np.ndarray:
        """Snapshot times [s], shape [snapshot_count]."""
        with self._reading() as file:
            return np.array([group.attrs["time"] for group in file["snapshots"].values()], dtype=np.float64)

    @property
    def snapshot_count(self) -> int:
        """How many snapshots there are."""
        with self._reading() as file:
            return len(file["snapshots"])

    @property
    def field_names(self) -> list[str]:
        """Names of the fields of the last snapshot, sorted; empty where there is no snapshot."""
        with self._reading() as file:
            groups = list(file["snapshots"].values())
            return sorted(groups[-1]) if groups else []

    def write_static(self, name: str, array: np.ndarray) -> None:
        """Store an array that does not change, e.g. "x0", initial positions [m], shape [point_count, 3].

        Raises ValueError where `name` is there already.
        """
        with self._writing() as file:
            file["static"].create_dataset(name, data=array)

    def read_static(self, name: str) -> np.ndarray:
        """The array stored under `name`; KeyError where there is none."""
        with self._reading() as file:
            return file["static"][name][()]

    def write_snapshot(self, time: float, step: int, fields: dict[str, np.ndarray]) -> None:
        """Append one snapshot at `time` [s]; each field has the point as its first axis."""
        with self._writing() as file:
            snapshots = file["snapshots"]
            group = snapshots.create_group(f"{len(snapshots):06d}")
            # First of all: a snapshot cut short by a full disk still says its time, for `truncate_after`.
            group.attrs["time"], group.attrs["step"] = float(time), int(step)
            for name, array in fields.items():
                group.create_dataset(name, data=array, **_SNAPSHOT_STORAGE)

    def snapshot(self, index: int, names=None) -> dict:
        """Fields of one snapshot (all, or `names`) with "time" [s] and "step"; index -1 is the last.

        Raises IndexError for a snapshot that is not there, KeyError for a field that is not.
        """
        with self._reading() as file:
            group = list(file["snapshots"].values())[index]
            fields = {name: group[name][()] for name in (group if names is None else names)}
            return {"time": float(group.attrs["time"]), "step": int(group.attrs["step"]), **fields}

    def append_history(self, rows: list[dict[str, float]]) -> None:
        """Append rows to the history. The first rows fix the columns, "time" [s] among them.

        Raises ValueError where a row has other columns.
        """
        if not rows:
            return
        with self._writing() as file:
            history = file["history"]
            columns = set(history) or set(rows[0])
            if "time" not in columns or any(set(row) != columns for row in rows):
                raise ValueError(f"history rows need exactly these columns: {sorted(columns | {'time'})}")
            for name in columns:
                if name not in history:
                    history.create_dataset(name, shape=(0,), maxshape=(None,), dtype="f8", chunks=(1024,))
                column = history[name]
                column.resize(len(column) + len(rows), axis=0)
                column[-len(rows) :] = [row[name] for row in rows]

    def history(self) -> dict[str, np.ndarray]:
        """Every history column, float64, shape [row_count]."""
        with self._reading() as file:
            return {name: column[()] for name, column in file["history"].items()}

    def truncate_after(self, time: float) -> None:
        """Go back to `time` [s]: later snapshots and history rows go, and so does the summary."""
        with self._writing() as file:
            snapshots, history = file["snapshots"], file["history"]
            for name in [name for name, group in snapshots.items() if group.attrs["time"] > time]:
                del snapshots[name]
            if "time" in history:
                kept = history["time"][()] <= time
                for column in history.values():
                    rows = column[()][kept]
                    column.resize(rows.shape)
                    column[...] = rows
            for name in ("finished", "summary"):
                file.attrs.pop(name, None)
        (self.directory / SUMMARY).unlink(missing_ok=True)

    @property
    def has_checkpoint(self) -> bool:
        """Whether there is a restart state."""
        return (self.directory / CHECKPOINT).is_file()

    def write_checkpoint(self, state: dict[str, np.ndarray | float | int | str]) -> None:
        """Replace the restart state. A kill at any moment leaves the earlier state or the new one, whole.

        Names are free but for "/", which HDF5 reads as a path: ValueError.
        """
        if any("/" in name for name in state):
            raise ValueError(f"a checkpoint name with '/' cannot be stored: {sorted(state)}")

        def write(path):
            with h5py.File(path, "w") as file:
                for name, value in state.items():
                    if isinstance(value, np.ndarray | np.generic):
                        file.create_dataset(name, data=value)
                    else:
                        file.attrs[name] = value

        replace_file(self.directory / CHECKPOINT, write)

    def read_checkpoint(self) -> dict:
        """The restart state, bit for bit as it was given. Raises SceneError where there is none to read."""
        path = self.directory / CHECKPOINT
        if not self.has_checkpoint:
            raise SceneError(f"nothing to resume in {self.directory}: {CHECKPOINT} is missing")
        with _reading(path) as file:
            scalars = {name: _python(value) for name, value in file.attrs.items()}
            return scalars | {name: array[()] for name, array in file.items()}

    def finish(self, summary: dict) -> None:
        """Mark the run as ended: summary.json, and the same in results.h5. NaN and infinities become null."""
        text = json.dumps(json_value(summary), indent=2, allow_nan=False) + "\n"
        with self._writing() as file:
            file.attrs["finished"] = True
            file.attrs["summary"] = text
        replace_file(self.directory / SUMMARY, lambda path: path.write_text(text, encoding="utf-8"))

    def summary(self) -> dict | None:
        """The summary of a run that has ended, else None."""
        path = self.directory / SUMMARY
        return json.loads(path.read_text(encoding="utf-8")) if path.is_file() else None

    def _reading(self):
        return _reading(self.directory / RESULTS)

    def _writing(self):
        return h5py.File(self.directory / RESULTS, "r+")


@contextmanager
def _reading(path: Path):
    """The HDF5 file at `path`, to read from; SceneError where HDF5 cannot."""
    try:
        # Unlocked: someone plotting a run that is still going must not make the solver's next write fail.
        with h5py.File(path, "r", locking=False) as file:
            yield file
    except (OSError, RuntimeError) as error:  # h5py raises either for a damaged file
        raise SceneError(f"{path} is not readable HDF5 (cut short or damaged?): {error}") from error


def replace_file(path: Path, write) -> None:
    """Let `write(temporary)` make the file, then put it in the place of `path` in one step."""
    temporary = _temporary(path)
    try:
        write(temporary)
        # On the disk before it has the name, or a power cut could leave an empty file under it.
        with open(temporary, "rb") as file:
            os.fsync(file.fileno())
        os.replace(temporary, path)
    except BaseException:
        temporary.unlink(missing_ok=True)
        raise


def _temporary(path: Path) -> Path:
    return path.with_name(path.name + ".tmp")


def _remove_run_files(folder: Path) -> None:
    """Remove what a run writes in `folder`; other files, also in vtk/, stay."""
    files = [folder / name for name in (RESULTS, CHECKPOINT, SUMMARY, *PLOTS)]
    files += [_temporary(folder / CHECKPOINT), _temporary(folder / SUMMARY)]
    files += [folder / "vtk" / name for name in ("background.xdmf", "background.h5")]
    files += [folder / "vtk" / "run.pvd", *folder.glob("vtk/" + "[0-9]" * 6 + ".vtu")]
    for path in files:
        path.unlink(missing_ok=True)
    with suppress(OSError):  # not there, or not empty: somebody's own files are in it
        (folder / "vtk").rmdir()


def _python(value):
    """An HDF5 attribute as the Python scalar that was written."""
    return value.item() if isinstance(value, np.generic) else value


def json_value(value):
    """`value` with numpy types as Python's and without NaN and infinities, which JSON does not have."""
    if isinstance(value, dict):
        return {key: json_value(item) for key, item in value.items()}
    if isinstance(value, np.ndarray | np.generic):
        return json_value(value.tolist())
    if isinstance(value, list | tuple):
        return [json_value(item) for item in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value
