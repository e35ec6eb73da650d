"""The command line: run, resume, plot, export, compare, study, bench, validate, scenes, info, demo."""

import sys
from enum import StrEnum
from importlib import metadata
from pathlib import Path
from typing import Annotated

import typer

from compare.cli.options import SpacedNumbers, SpacedWords
from compare.cli.ranks import runs_at_a_time, spread, take_part
from compare.cli.terminal import BatchMonitor, Monitor, announce, err, out, summary_table
from compare.solvers import runs_of
from mpm.caches import announce_compilation
from mpm.command import command
from mpm.errors import INTERRUPTED, NumericalError, SceneError

app = typer.Typer(
    help="Granular column collapse: one scene file, explicit and implicit MPM, compared with theory.",
    epilog="`./repose test` runs the tests; what follows it goes to pytest.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
)


class Mode(StrEnum):
    explicit = "explicit"
    implicit = "implicit"


class Format(StrEnum):
    vtu = "vtu"
    csv = "csv"


class Precision(StrEnum):
    float32 = "float32"
    float64 = "float64"


DEMO = ("column_sand", [])  # scene and settings
DEMO_FOLDER = Path("runs/demo")
SIDE_BY_SIDE = 8  # runs of a study that times none, where the cores hold them; more would crowd a GPU

study = typer.Typer(help="Many runs and a report of them; what is finished is kept.", no_args_is_help=True)
app.add_typer(study, name="study")


def _presets(typed: str) -> list[str]:
    """The presets whose names start with `typed`, for the shell to complete; it completes files itself."""
    from mpm.load import preset_names

    return [name for name in preset_names() if name.startswith(typed)]


SceneArg = Annotated[
    str, typer.Argument(metavar="SCENE", help="scene file (TOML) or a preset's name", autocompletion=_presets)
]
SetOption = Annotated[list[str], typer.Option("--set", metavar="KEY=VALUE", help="override a scene key")]
DeviceOption = Annotated[str, typer.Option(help="cpu, cuda:0, cuda:1, ..., or cuda: on ranks a GPU each")]
AgainOption = Annotated[bool, typer.Option("--force", help="run again what is there, replace another report in DIR")]
RanksOption = Annotated[str, typer.Option("--ranks", metavar="N|all", help="MPI ranks; all: one a core, or a GPU")]
RealisationsOption = Annotated[
    int | None, typer.Option(help="runs of each case, from points that start at random; at least 2")
]
DirArg = Annotated[Path, typer.Argument(metavar="DIR", help="folder of a run")]


def _out(default: str):
    """`--out`, whose help says the default."""
    return typer.Option("--out", metavar="DIR", help=f"default: {default}")


def _jobs(default: str):
    """`--jobs`, whose help says the default."""
    return typer.Option(min=1, help=f"runs at a time; default: {default}")


def _say_version(asked: bool):
    if asked:
        out.print(f"repose {metadata.version('repose')}")
        raise typer.Exit


@app.callback()
def options(
    version: Annotated[
        bool, typer.Option("--version", callback=_say_version, is_eager=True, help="say the version and stop")
    ] = False,
):
    """What every command takes."""


@app.command()
def run(
    scene: SceneArg,
    mode: Annotated[Mode, typer.Option(help="solver")] = Mode.explicit,
    device: DeviceOption = "cpu",
    set_: SetOption = [],  # noqa: B006 (typer reads the default, nothing mutates it)
    directory: Annotated[Path | None, _out("runs/SCENE-MODE")] = None,
    force: Annotated[bool, typer.Option("--force", help="replace an earlier run in DIR")] = False,
    ranks: RanksOption = "1",
):
    """Run a scene: writes DIR/results.h5, DIR/summary.json and DIR/vtk for ParaView."""
    from mpm.load import load_scene

    spread(ranks, device)
    validated = load_scene(scene, set_)
    solver = runs_of(mode.value)
    directory = directory or Path("runs") / f"{validated.name}-{mode.value}"
    _follow(directory, solver.run, validated, directory, device, force, Monitor())


@app.command()
def resume(
    directory: DirArg,
    device: Annotated[str | None, typer.Option(help="default: the device the run was started on")] = None,
    ranks: RanksOption = "1",
):
    """Go on with a run from its last checkpoint, on as many ranks as you like."""
    from mpm.results import Results

    started_as = Results.open(directory).provenance
    mode = str(started_as.get("mode", Mode.explicit.value))
    spread(ranks, device or str(started_as["device"]))
    solver = runs_of(mode)
    _follow(directory, solver.resume, directory, device, Monitor())


@app.command()
def plot(directory: DirArg):
    """Draw morphology.png, history.png and, for a column, profile.png in DIR."""
    for path in _draw(directory):
        out.print(str(path))


@app.command(cls=SpacedWords)
def export(
    directory: DirArg,
    fields: Annotated[list[str], typer.Option(metavar="NAME...", help="point fields, in place of all")] = [],  # noqa: B006
    format: Annotated[Format, typer.Option(help="vtu for ParaView, csv: a table a snapshot")] = Format.vtu,
    target: Annotated[Path | None, _out("vtk or csv in DIR")] = None,
):
    """Write the snapshots of a run as files of other programs, also of one that was stopped, killed or failed."""
    from mpm.export import write_csv
    from mpm.results import Results
    from mpm.vtk import write_vtk

    write = write_csv if format is Format.csv else write_vtk
    results = Results.open(directory)
    out.print(f"{write(results, fields or None, target)} lists {results.snapshot_count} snapshots")


@app.command()
def compare(
    scene: SceneArg,
    device: DeviceOption = "cpu",
    set_: SetOption = [],  # noqa: B006
    directory: Annotated[Path | None, _out("runs/SCENE-compare")] = None,
    force: AgainOption = False,
    ranks: RanksOption = "1",
):
    """Implicit against explicit (D = 0.4) and Eq. 4, from one scene: writes DIR/report.html, report.json, table.csv."""
    from compare.comparison import compare_solvers

    name = _announced(scene, set_).name
    directory = directory or Path("runs") / f"{name}-compare"
    _report(directory, force, compare_solvers, scene, set_, device, _workers(1, ranks, device).ranks)


@study.command("error", cls=SpacedNumbers)
def study_error(
    scene: SceneArg,
    cells: Annotated[list[float], typer.Option(metavar="N...", help="cells per r0 of both solvers")] = [  # noqa: B006
        5,
        8,
        10,
        16,
        20,
    ],
    finer: Annotated[list[float], typer.Option(metavar="N...", help="more of the explicit solver alone")] = [],  # noqa: B006
    realisations: RealisationsOption = None,
    device: DeviceOption = "cpu",
    set_: SetOption = [],  # noqa: B006
    directory: Annotated[Path | None, _out("runs/SCENE-error")] = None,
    jobs: Annotated[int | None, _jobs("1, as times are taken")] = None,
    force: AgainOption = False,
    ranks: RanksOption = "1",
):
    """Speed against error of both solvers, over resolution, precision, step and stiffness (hours)."""
    from compare.ensembles import REALISATIONS
    from compare.studies.error import study_error

    name = _announced(scene, set_).name
    directory = directory or Path("runs") / f"{name}-error"
    made = REALISATIONS if realisations is None else realisations
    _report(directory, force, study_error, scene, set_, cells, finer, made, device, _workers(jobs, ranks, device))


@study.command("paper", cls=SpacedNumbers)
def study_paper(
    lambda0: Annotated[list[float], typer.Option(metavar="N...", help="aspect ratios h0/r0")] = [0.5, 1, 2, 4],  # noqa: B006
    damping: Annotated[list[float], typer.Option(metavar="N...", help="local damping D")] = [0, 0.05, 0.1, 0.2, 0.4],  # noqa: B006
    realisations: RealisationsOption = None,
    quick: Annotated[bool, typer.Option("--quick", help="5 cells per r0 instead of 20, 3 realisations not 5")] = False,
    device: DeviceOption = "cpu",
    directory: Annotated[Path | None, _out("runs/paper, or runs/paper-quick")] = None,
    jobs: Annotated[int | None, _jobs("8, or fewer where there are fewer cores")] = None,
    force: AgainOption = False,
    ranks: RanksOption = "1",
):
    """The paper remade, figure by figure: claims, ensembles of its runs, theory, experiments, the implicit solver."""
    from compare.ensembles import QUICK_REALISATIONS, REALISATIONS
    from compare.studies.paper.study import study_paper

    directory = directory or Path("runs") / f"paper{'-quick' if quick else ''}"
    if realisations is None:
        realisations = QUICK_REALISATIONS if quick else REALISATIONS
    workers = _workers(jobs, ranks, device, SIDE_BY_SIDE)
    _report(directory, force, study_paper, lambda0, damping, realisations, quick, device, workers)


@study.command("damping")
def study_damping(
    scene: SceneArg,
    target: Annotated[str, typer.Option(metavar="NUMBER|eq4", help="run-out R_995 to meet, or that of Eq. 4")],
    realisations: RealisationsOption = None,
    device: DeviceOption = "cpu",
    set_: SetOption = [],  # noqa: B006
    directory: Annotated[Path | None, _out("runs/SCENE-damping-TARGET")] = None,
    jobs: Annotated[int | None, _jobs("8, or fewer where there are fewer cores")] = None,
    force: AgainOption = False,
    ranks: RanksOption = "1",
):
    """The local damping D that meets a run-out, with its interval, and what the solver without D gives."""
    from compare.ensembles import REALISATIONS
    from compare.studies.damping import study_damping

    name = _announced(scene, set_).name
    directory = directory or Path("runs") / f"{name}-damping-{target}"
    made = REALISATIONS if realisations is None else realisations
    workers = _workers(jobs, ranks, device, SIDE_BY_SIDE)
    _report(directory, force, study_damping, scene, set_, target, made, device, workers)


@study.command("stability")
def study_stability(
    quick: Annotated[bool, typer.Option("--quick", help="leave out the longest cases")] = False,
    directory: Annotated[Path | None, _out("runs/stability, or runs/stability-quick")] = None,
    jobs: Annotated[int | None, _jobs("2, or fewer where there are fewer cores")] = None,
    force: AgainOption = False,
    ranks: RanksOption = "1",
):
    """Hard cases of both solvers: what is stable, degraded or refused, with figures and limits."""
    from compare.studies.stability import study_stability

    directory = directory or Path("runs") / f"stability{'-quick' if quick else ''}"
    _report(directory, force, study_stability, quick, _workers(jobs, ranks, usual=2))


@app.command("bench", cls=SpacedNumbers)
def bench(
    mode: Annotated[Mode, typer.Argument(metavar="explicit|implicit", help="solver")],
    device: DeviceOption = "cpu",
    precision: Annotated[Precision, typer.Option(help="of the explicit solver")] = Precision.float64,
    cells: Annotated[list[float], typer.Option(metavar="N...", help="cells per r0, in place of the usual sizes")] = [],  # noqa: B006
    ranks: Annotated[list[int], typer.Option(metavar="N...", help="speed over so many MPI ranks instead")] = [],  # noqa: B006
    directory: Annotated[
        Path | None, _out("runs/bench-MODE-PRECISION-DEVICE; of --ranks: runs/bench-MODE-ranks-PRECISION")
    ] = None,
    force: AgainOption = False,
):
    """Speed over size, what a step goes into, memory (three minutes on a CPU; run nothing beside it)."""
    from compare.bench.ladder import bench
    from compare.bench.scaling import bench_ranks

    if ranks:
        directory = directory or Path("runs") / f"bench-{mode.value}-ranks-{precision.value}"
        _report(directory, force, bench_ranks, mode.value, device, precision.value, cells, ranks)
        return
    directory = directory or Path("runs") / f"bench-{mode.value}-{precision.value}-{device.replace(':', '')}"
    _report(directory, force, bench, mode.value, device, precision.value, cells)


@app.command()
def validate(
    scene: SceneArg,
    set_: SetOption = [],  # noqa: B006
    mode: Annotated[Mode, typer.Option(help="solver")] = Mode.explicit,
    table1: Annotated[bool, typer.Option("--table1", help="element, node and point counts of Table 1")] = False,
):
    """Check a scene file and say what `run` would compute, or refuse; nothing is run."""
    from compare.cli.inspection import print_checked

    print_checked(scene, set_, mode.value, table1)


@app.command()
def scenes(
    show: Annotated[
        str | None,
        typer.Option(metavar="NAME", help="print the file of one of them, to start from", autocompletion=_presets),
    ] = None,
):
    """List the scenes that come with Repose."""
    from compare.cli.inspection import print_presets

    print_presets(show)


@app.command()
def info():
    """Versions, devices, what is missing and how to get it."""
    from compare.cli.inspection import print_system

    print_system()


@app.command()
def demo(
    directory: Annotated[Path, typer.Option("--out", metavar="DIR")] = DEMO_FOLDER,
    force: AgainOption = False,
):
    """A quarter column of sand by both solvers, beside theory, as a page to open; without --out anew each time."""
    from compare.comparison import compare_solvers

    report = _reported(directory, force or directory == DEMO_FOLDER, compare_solvers, *DEMO, "cpu")
    if not report["failed"]:
        implicit, explicit = list(report["runs"].values())[:2]
        run_outs = f"explicit {explicit['R_995']:.4f}, implicit {implicit['R_995']:.4f}"
        out.print(f"run-out R_995: {run_outs}; quasistatic theory (Eq. 4) {explicit['eq4']:.4f}")
    _open(directory, report)


def _announced(reference: str, settings: list[str]):
    """The resolved scene, once what there is to know of it was said."""
    from mpm.body import build
    from mpm.load import load_scene

    scene = load_scene(reference, settings)
    announce(build(scene))
    return scene


def _workers(jobs: int | None, ranks: str, device: str = "cpu", usual: int = 1):
    """How many runs of a study go at a time, and on how many ranks each (see `runs_at_a_time`)."""
    from compare.batch import Workers
    from compare.launch import count_of

    count = count_of(ranks, device)
    return Workers(runs_at_a_time(jobs, count, usual), count)


def _follow(folder: Path, solve, *arguments):
    """Call `solve(*arguments)` and report the summary of the run in `folder`, or say where Ctrl-C stopped it."""
    pvd = folder / "vtk" / "run.pvd"
    try:
        summary = solve(*arguments)
    except (KeyboardInterrupt, NumericalError) as stop:
        if str(stop) and pvd.is_file():  # stopped in mid-run, not while it was set up
            out.print(f"ParaView opens {pvd}, up to the last snapshot")
        if isinstance(stop, NumericalError):
            raise
        err.print(str(stop) or "interrupted")  # not left to `main`: typer turns it into a bare exit code
        raise typer.Exit(INTERRUPTED) from None
    out.print(summary_table(summary))
    vtk = "; ParaView opens vtk/run.pvd" if pvd.is_file() else ""
    out.print(f"results in {folder} (`{command('plot', folder)}` draws them{vtk})")


def _report(directory: Path, force: bool, make, *arguments):
    """Write a report (see `_reported`) and say what to open; exit code 3 where a run failed."""
    _open(directory, _reported(directory, force, make, *arguments))


def _reported(directory: Path, force: bool, make, *arguments) -> dict:
    """Let `make(directory, force, monitor, asked, *arguments)` compute a report; write it and print its verdict."""
    from compare.report.page import write_report

    try:
        report = make(directory, force, BatchMonitor(), command(*sys.argv[1:]), *arguments)
    except KeyboardInterrupt as stop:
        err.print(str(stop) or "interrupted")
        raise typer.Exit(INTERRUPTED) from None
    write_report(report, directory)
    out.print(f"verdict: {report['verdict']['sentence']}")
    return report


def _open(directory: Path, report: dict):
    """Say which page to open; exit code 3 where a run of the report failed."""
    from compare.report.page import REPORT_HTML

    out.print(f"open {directory / REPORT_HTML} in a browser")
    if report["failed"]:
        raise typer.Exit(NumericalError.exit_code)


def _draw(directory: Path) -> list[Path]:
    from compare.plots.run import plot_history, plot_morphology, plot_profile
    from compare.plots.style import save
    from mpm.results import Results

    results = Results.open(directory)
    drawings = {"morphology.png": plot_morphology, "profile.png": plot_profile, "history.png": plot_history}
    if results.scene.geometry.shape != "column":
        del drawings["profile.png"]  # over the radius, which only a column has
    return [save(draw(results), directory / name) for name, draw in drawings.items()]


def main():
    """Entry point, of each rank where there are several (see `compare.cli.ranks`)."""
    take_part(_main)


def _main():
    """Exit codes: 0 done, 1 disk or memory failed, 2 bad input, 3 numerical failure, 130 Ctrl-C."""
    try:
        announce_compilation()
        app(prog_name="repose")  # however it was started: the shell completes that name
    except SceneError as error:
        for problem in error.problems:
            err.print(f"error: {problem}", style="red")
        sys.exit(SceneError.exit_code)
    except NumericalError as error:
        err.print(f"numerical failure: {error}", style="red")
        sys.exit(NumericalError.exit_code)
    except (OSError, MemoryError) as error:
        err.print(f"error: {str(error) or 'out of memory'}", style="red")
        sys.exit(1)
