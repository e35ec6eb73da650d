"""ParaView files from a results store: one .vtu per snapshot and a .pvd that lists them with their times."""

from pathlib import Path
from xml.etree import ElementTree

import numpy as np

from mpm.export import Snapshots
from mpm.results import Results

# Stored are xx, yy, zz, yz, xz, xy; ParaView reads six components as xx, yy, zz, xy, yz, xz.
_PARAVIEW_TENSOR = [0, 1, 2, 5, 3, 4]


def write_vtk(results: Results, fields: list[str] | None = None, directory=None) -> Path:
    """Write every snapshot for ParaView and return the path of the collection, run.pvd.

    fields: names of the point data to write, by default all (see `mpm.export.Snapshots`); positions [m] always come
    from "x". directory: where to, by default vtk/ in the run directory.
    Raises SceneError where there is no snapshot, or for a field that there is not.
    """
    snapshots = Snapshots(results, fields)
    folder = Path(directory) if directory is not None else results.directory / "vtk"
    folder.mkdir(parents=True, exist_ok=True)

    collection = ElementTree.Element("VTKFile", type="Collection", version="0.1")
    series = ElementTree.SubElement(collection, "Collection")
    for index, snapshot in enumerate(snapshots):
        file_name = f"{index:06d}.vtu"
        _write_points(folder / file_name, snapshot, snapshots.names)
        ElementTree.SubElement(series, "DataSet", timestep=repr(snapshot["time"]), part="0", file=file_name)
    ElementTree.indent(collection)
    path = folder / "run.pvd"
    ElementTree.ElementTree(collection).write(path, encoding="utf-8", xml_declaration=True)
    return path


def _write_points(path, snapshot, names):
    """One snapshot as a cloud of vertex cells, binary and compressed (meshio's default for .vtu)."""
    import meshio  # slow to import, and needed here only

    x = snapshot["x"]
    data = {name: _paraview_order(snapshot[name]) for name in names}
    cells = [("vertex", np.arange(len(x)).reshape(-1, 1))]
    meshio.Mesh(x, cells, point_data=data).write(path, file_format="vtu", binary=True, compression="zlib")


def _paraview_order(array):
    """Symmetric tensors, shape [n, 6], in ParaView's component order; anything else as it is."""
    is_tensor = array.ndim == 2 and array.shape[1] == 6
    return array[:, _PARAVIEW_TENSOR] if is_tensor else array
