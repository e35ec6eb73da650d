"""The results store of one run: snapshots, history, provenance and restart. The one thing solvers hand on.

A run directory holds

    results.h5       root attributes `scene` and `provenance` (JSON);
                     static/NAME; snapshots/000000/FIELD with attributes `time` [s] and `step`; history/COLUMN
    checkpoint.h5    the newest restart state, replaced whole
    summary.json     written when the run ends
    vtk/, csv/, *.png  made from the above by `mpm.vtk`, `mpm.export` and `compare.plots.run`

Arrays keep the precision they are given in. All quantities are SI.
"""

import io
import json
import math
import os
from contextlib import contextmanager, suppress
from pathlib import Path

import h5py
import numpy as np

from mpm.command import command
from mpm.errors import SceneError
from mpm.load import parse_scene
from mpm.scene import Scene

RESULTS, CHECKPOINT, SUMMARY = "results.h5", "checkpoint.h5", "summary.json"
PLOTS = ("morphology.png", "profile.png", "history.png")
_SNAPSHOT_STORAGE = {"compression": "gzip", "compression_opts": 1, "shuffle": True}
_HISTORY_CHUNK = 1024  # rows
_ROWS = "rows"  # attribute of the history: how many of its rows are whole
_BOOKKEEPING = 1 << 16  # bytes that HDF5 may need beside the arrays that are written


class Results:
    """A run directory. Make one with `Results.create` or `Results.open`.

    The HDF5 file is open only while a method runs, so that a run killed between two calls leaves it whole.
    Reading methods raise SceneError where a file is damaged or not Repose's; writing methods raise OSError, with what
    was in the files before still in them.
    """

    def __init__(self, directory):
        self.directory = Path(directory)

    @classmethod
    def create(cls, directory, scene: Scene, provenance: dict, force: bool = False) -> "Results":
        """Start a run in `directory`, made if need be.

        provenance: flat, str or number (versions, device, ...).
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
                resume = command("resume", folder)
                raise SceneError(f"{folder} is not empty: `--force` replaces the run in it, `{resume}` continues it")
            # Python's own open gives the plain reason ("Permission denied"); HDF5 buries it in a paragraph.
            (folder / RESULTS).touch()
            with h5py.File(folder / RESULTS, "w") as file:
                file.attrs["scene"] = scene.model_dump_json()
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
    def scene(self) -> Scene:
        """The validated scene of the run. Raises SceneError where it is none by what this version asks of a scene."""
        with self._reading() as file:
            table = json.loads(file.attrs["scene"])
        try:
            return parse_scene(table)
        except SceneError as error:
            where = self.directory
            raise SceneError(f"{where}: made by another version of Repose; run its scene again ({error})") from None

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
        with self._writing(array.nbytes) as file:
            file["static"].create_dataset(name, data=array)

    def read_static(self, name: str) -> np.ndarray:
        """The array stored under `name`. Raises SceneError where there is none."""
        with self._reading() as file:
            return file["static"][name][()]

    def write_snapshot(self, time: float, step: int, fields: dict[str, np.ndarray]) -> None:
        """Append one snapshot at `time` [s]; each field has the point as its first axis."""
        with self._writing(sum(array.nbytes for array in fields.values())) as file:
            snapshots = file["snapshots"]
            group = snapshots.create_group(None)
            group.attrs["time"], group.attrs["step"] = float(time), int(step)
            for name, array in fields.items():
                group.create_dataset(name, data=array, **_SNAPSHOT_STORAGE)
            file.flush()  # in the file before it has a name there: a kill in between leaves nothing half-written
            snapshots[f"{len(snapshots):06d}"] = group

    def snapshot(self, index: int, names=None) -> dict:
        """Fields of one snapshot (all, or `names`) with "time" [s] and "step"; index -1 is the last.

        Raises SceneError for a snapshot or field that is not there.
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
        # A column grows by whole chunks.
        with self._writing(8 * (len(rows) + _HISTORY_CHUNK) * len(rows[0])) as file:
            history = file["history"]
            columns = set(history) or set(rows[0])
            if "time" not in columns or any(set(row) != columns for row in rows):
                raise ValueError(f"history rows need exactly these columns: {sorted(columns | {'time'})}")
            for name in columns:
                if name not in history:
                    history.create_dataset(name, shape=(0,), maxshape=(None,), dtype="f8", chunks=(_HISTORY_CHUNK,))
                column = history[name]
                column.resize(len(column) + len(rows), axis=0)
                column[-len(rows) :] = [row[name] for row in rows]
            file.flush()
            # Counted once they are in the file: a kill between two columns leaves whole rows.
            history.attrs.modify(_ROWS, len(history["time"]))

    def history(self) -> dict[str, np.ndarray]:
        """Every history column, float64, shape [row_count]."""
        with self._reading() as file:
            history = file["history"]
            count = min([int(history.attrs.get(_ROWS, 2**62)), *map(len, history.values())])
            return {name: column[:count] for name, column in history.items()}

    def truncate_after(self, time: float) -> None:
        """Go back to `time` [s]: later snapshots and history rows go, and so does the summary."""
        later, history = self.times > time, self.history()  # read first: says what is damaged
        with self._writing() as file:
            for name in np.array(list(file["snapshots"]))[later]:
                del file["snapshots"][name]
            kept = history["time"] <= time if history else np.zeros(0, bool)
            file["history"].attrs.modify(_ROWS, int(kept.sum()))
            for name, column in history.items():
                rows = column[kept]
                file["history"][name].resize(rows.shape)
                file["history"][name][...] = rows
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

        # In memory first: HDF5 cannot let go of a file whose disk is full, a plain write can.
        image = io.BytesIO()
        with h5py.File(image, "w") as file:
            for name, value in state.items():
                if isinstance(value, np.ndarray | np.generic):
                    file.create_dataset(name, data=value)
                else:
                    file.attrs[name] = value
        replace_file(self.directory / CHECKPOINT, lambda path: path.write_bytes(image.getbuffer()))

    def read_checkpoint(self) -> dict:
        """The restart state, bit for bit as it was given. Raises SceneError where there is none to read."""
        path = self.directory / CHECKPOINT
        if not self.has_checkpoint:
            raise SceneError(f"nothing to resume in {self.directory}: {CHECKPOINT} is missing")
        with _reading(path) as file:
            scalars = {name: _python(value) for name, value in file.attrs.items()}
            return scalars | {name: array[()] for name, array in file.items()}

    def finish(self, summary: dict) -> None:
        """Mark the run as ended, by summary.json. NaN and infinities become null."""
        text = json.dumps(json_value(summary), indent=2, allow_nan=False) + "\n"
        replace_file(self.directory / SUMMARY, lambda path: path.write_text(text, encoding="utf-8"))

    def summary(self) -> dict | None:
        """The summary of a run that has ended, else None."""
        path = self.directory / SUMMARY
        if not path.is_file():
            return None
        with _told_apart(path):
            return json.loads(path.read_text(encoding="utf-8"))

    def _reading(self):
        return _reading(self.directory / RESULTS)

    def _writing(self, more: int = 0):
        """results.h5, to write arrays of `more` bytes to. Raises OSError where the disk has no room for them: asked
        first, as HDF5 cannot let go of a file whose disk is full, and crashes on the way out.
        """
        path = self.directory / RESULTS
        with open(path, "r+b") as file, suppress(AttributeError):  # macOS has no such call
            size = os.fstat(file.fileno()).st_size
            try:
                os.posix_fallocate(file.fileno(), size, more + _BOOKKEEPING)
            except OSError as error:
                raise OSError(error.errno, error.strerror, str(path)) from None
            finally:
                # Given back before HDF5 comes: it would do so between its own writes, and a kill hit that moment in
                # 5 of 60 runs.
                os.ftruncate(file.fileno(), size)
        return h5py.File(path, "r+")


@contextmanager
def _reading(path: Path):
    """The HDF5 file at `path`, to read from; SceneError where HDF5 cannot."""
    # Unlocked: someone plotting a run that is still going must not make the solver's next write fail.
    with _told_apart(path), h5py.File(path, "r", locking=False) as file:
        yield file


@contextmanager
def _told_apart(path: Path):
    """SceneError for whatever reading `path` raises: of a damaged file h5py makes nearly every kind of error."""
    try:
        yield
    except SceneError:
        raise
    except Exception as error:
        raise SceneError(f"{path} cannot be read (cut short or damaged?): {type(error).__name__}: {error}") from error


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
    """Remove what a run writes in `folder`; other files, also in vtk/ and csv/, stay."""
    files = [folder / name for name in (RESULTS, CHECKPOINT, SUMMARY, *PLOTS)]
    files += [_temporary(folder / CHECKPOINT), _temporary(folder / SUMMARY)]
    files += [folder / "vtk" / name for name in ("background.xdmf", "background.h5")]
    files += [folder / "vtk" / "run.pvd", *folder.glob("vtk/" + "[0-9]" * 6 + ".vtu")]
    files += [folder / "csv" / "snapshots.csv", *folder.glob("csv/" + "[0-9]" * 6 + ".csv")]
    for path in files:
        path.unlink(missing_ok=True)
    for name in ("vtk", "csv"):
        with suppress(OSError):  # not there, or not empty: somebody's own files are in it
            (folder / name).rmdir()


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
