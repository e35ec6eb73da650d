"""What `validate`, `scenes` and `info` print: a scene that was checked, the presets, versions and devices."""

import itertools
from pathlib import Path

from rich.table import Table

from compare.cli.terminal import announce, out
from compare.solvers import runs_of
from mpm.body import Body, build
from mpm.errors import SceneError
from mpm.load import load_scene, preset_file, preset_names
from mpm.precheck import refusals, refuse
from mpm.provenance import PROJECT, git_commit, installed, warp_devices
from mpm.results import Results
from mpm.scene import Column
from mpm.stiffness import limit_bulk
from mpm.theory import theory
from mpm.walls import paper_grid


def print_checked(reference: str, settings: list[str], mode: str, table1: bool):
    """What the solver `mode` would compute of a scene; with the counts of the paper's `table1`.

    Raises SceneError for all that it would refuse.
    """
    body = build(load_scene(reference, settings))
    refuse(body, mode)
    if mode == "implicit":
        runs_of(mode)
    scene = body.scene
    out.print(f"{scene.name}: valid. {len(body.x):,} points, cell {scene.grid.cell:g} m")
    for line in body.fit.lines() if body.fit else ():
        out.print(line)
    time = f"time scale sqrt(h0/g) = {body.time_scale:.4g} s"
    if mode == "explicit":
        adaptive = scene.explicit.cfl * scene.grid.cell / limit_bulk(body).constants.p_wave_speed
        time = f"first time step {scene.explicit.time_step or adaptive:.4g} s, {time}"
    out.print(time)
    other = "implicit" if mode == "explicit" else "explicit"
    for problem in refusals(body, other):
        out.print(f"the {other} solver would refuse it: {problem}")
    run_outs = [f"{key} = {value:.4f}" for key, value in theory(scene).items() if value is not None]
    if run_outs:
        out.print("run-out in theory: " + ", ".join(run_outs))
    announce(body)
    if table1:
        out.print(_table1(body))


def _table1(body: Body) -> Table:
    """The paper's counts beside the nodes that are really stored."""
    from explicit.solver import ExplicitSolver  # slow to import, and only this table needs it
    from mpm.devices import find_device

    scene = body.scene
    if not isinstance(scene.geometry, Column) or scene.geometry.symmetry != "quarter":
        raise SceneError("--table1: Table 1 lists quarter columns only")
    n_el, n_no = paper_grid(round(scene.geometry.radius / scene.grid.cell), scene.geometry.aspect_ratio)
    table = Table(box=None, padding=(0, 2))
    for heading in ("lambda0", "n_el", "n_no", "n_mp", "nodes stored at start", "nodes stored at most"):
        table.add_column(heading, justify="right")
    at_most, folder = "run it first", Path("runs") / f"{scene.name}-explicit"
    if (folder / "summary.json").is_file() and Results.open(folder).scene == scene:
        at_most = f"{Results.open(folder).summary()['nodes_stored_max']:,}"
    start = ExplicitSolver(body, find_device("cpu")).nodes_stored_start
    table.add_row(f"{scene.geometry.aspect_ratio:g}", str(n_el), str(n_no), str(len(body.x)), f"{start:,}", at_most)
    return table


def print_presets(show: str | None):
    """The presets, each with what its file says first; or the file of the one to `show`, as it is."""
    if show is not None:
        print(preset_file(show).read_text(encoding="utf-8"), end="")  # rich would wrap and colour it
        return
    for name in preset_names():
        lines = preset_file(name).read_text(encoding="utf-8").splitlines()
        heading = itertools.takewhile(lambda line: line.startswith("#"), lines)
        out.print(f"{name:14} {' '.join(line.lstrip('# ') for line in heading)}")


def print_system():
    """Versions, devices, what is missing and how to get it."""
    table = Table(box=None, padding=(0, 2))
    for heading in ("package", "version", "needed for"):
        table.add_column(heading)
    packages, refusal = installed(), None
    for package in packages:
        table.add_row(package.name, package.version or "missing", package.needed_for)
    try:
        from implicit._dolfinx import libraries

        for name, version in libraries().items():
            table.add_row(name, version, "the implicit solver")
    except SceneError as error:
        refusal = error
    out.print(table)
    # Lines of their own: a table would break them, and they are there to be copied.
    if missing := [package.name for package in packages if not package.version]:
        out.print(f"to get {' and '.join(missing)}: run ./repose, which installs what it needs")
    if refusal:
        out.print(str(refusal))
    for device in warp_devices():
        out.print(f"device {device['alias']}: {device['name']}, {device['memory_mb']:,.0f} MB")
    out.print(f"commit {git_commit(PROJECT)}")
