"""What the explicit step asks of a GPU, counted in its compiled kernels: no GPU is needed.

    python benchmarks/gpu_counts.py [--arch 90] [--label "four launches" --out benchmarks/results/gpu_counts.csv]
    python benchmarks/gpu_counts.py --looks

A row a launch of a step, and of what else a GPU does between outputs, appended to the table: registers and local
memory [bytes] of a thread, shared memory [bytes] of a block, with what Warp and the driver keep there, and how many
reductions (`red`, `atom`) and bytes of loads and stores in global memory its code has, which is less than a thread does
where there are loops. Registers need `cuobjdump` (pip install nvidia-cuda-cuobjdump). `--looks` counts, in the first
steps of a run, how often the host looks at the device and the bytes that it reads, with Warp's block runtime on a CPU
in a GPU's place.
"""

import argparse
import re
import shutil
import subprocess
import tempfile
from functools import partial
from importlib.metadata import PackageNotFoundError, files
from pathlib import Path
from unittest.mock import patch

import warp as wp

from compare.report.page import add_rows
from explicit.kernels.look import look_kernels
from explicit.kernels.sparse_grid import sparse_grid_kernels
from explicit.run import ExplicitRun
from explicit.solver import ExplicitSolver
from mpm.body import build
from mpm.devices import find_device, start_warp
from mpm.load import load_scene
from mpm.results import Results

NUMBER_BYTES = {"8": 1, "16": 2, "32": 4, "64": 8}


def name_of(kernel) -> str:
    """A kernel's own name, without that of the function that makes it."""
    return kernel.key.rpartition("__")[2]


def step_of(real) -> list:
    """The kernels of one step as a GPU takes it, in order; they are built for a CPU on the way, in blocks."""
    settings = ["grid.cell=0.25", f"explicit.precision={real.__name__}", "explicit.damping=0.05"]
    solver = ExplicitSolver(build(load_scene("column_0.5", settings)), "cpu", fused=True)
    return [launch.kernel for launch in solver.fused_step.phases]


def between_outputs(real) -> list:
    """The kernels that follow the points with the stored nodes and look at them for a history row."""
    fit, look = sparse_grid_kernels(real), look_kernels(real)
    return [kernel for kernels in (fit, look) for kernel in vars(kernels).values()]


def looks(steps: int, rows: bool) -> dict[str, int]:
    """Looks of the host in so many steps of `column_0.5` at 10 cells per r0, and bytes that it reads: of a run that
    writes history `rows`, or of steps alone."""
    wp.config.enable_cpu_blocks = True
    settings = ["grid.cell=0.1", "explicit.precision=float32", "explicit.damping=0.05", "output.every=60.0"]
    scene, place = load_scene("column_0.5", settings), {"device": "cpu", "device_name": "-"}
    sizes, as_numpy = [], wp.array.numpy
    with (
        tempfile.TemporaryDirectory() as folder,
        patch("explicit.run.ExplicitSolver", partial(ExplicitSolver, fused=True)),
        patch.object(wp.array, "numpy", lambda array: sizes.append(array.capacity) or as_numpy(array)),
    ):
        results = Results.create(Path(folder) / "run", scene, place)
        run = ExplicitRun(build(scene), results, find_device("cpu"))
        run.begin()
        run.solver.set_target(60.0)
        sizes.clear()
        while run.solver.steps < steps:
            run.advance() if rows else run.solver.advance(60.0)
    return {"looks": len(sizes), "bytes": sum(sizes), "history rows": run.rows - 1}


def compiled(module, arch: int, folder: Path, ptx: bool) -> Path:
    """A module's code for sm_`arch`, as PTX or as machine code."""
    wp.compile_aot_module(module, arch=arch, module_dir=folder, use_ptx=ptx)
    (path,) = folder.glob(f"wp_{module.name}_*.{'ptx' if ptx else 'cubin'}")
    return path


def ptx_of(kernel, ptx: str) -> str:
    """The PTX of one kernel of a module."""
    (text,) = [part for part in ptx.split(".entry ")[1:] if f"__{name_of(kernel)}_" in part.partition("(")[0]]
    return text


def reductions(text: str) -> dict[str, int]:
    """Reductions in global memory in a kernel's PTX, by kind: "red.v4.f32", "red.f64", "atom.max.u32", ..."""
    found = re.findall(r"\b(red|atom)\.(?:global\.)?(?:add\.)?([\w.]+)", text)
    kinds = [f"{kind}.{what}" for kind, what in found]
    return {kind: kinds.count(kind) for kind in sorted(set(kinds))}


def bytes_moved(text: str) -> int:
    """Bytes of the loads and stores in global memory in a kernel's PTX."""
    found = re.findall(r"\b(?:ld|st)\.global(?:\.\w+)*?(?:\.v(\d))?\.[usbf](\d+)", text)
    return sum(int(wide or 1) * NUMBER_BYTES[bits] for wide, bits in found)


def cuobjdump() -> str | None:
    """Where `cuobjdump` is; None where it is not."""
    if found := shutil.which("cuobjdump"):
        return found
    try:
        inside = [path for path in files("nvidia-cuda-cuobjdump") if path.name == "cuobjdump"]
    except PackageNotFoundError:
        return None
    return str(inside[0].locate())


def resources(kernels, cubin: Path) -> list[tuple[int, int, int]]:
    """Registers and bytes of local memory of a thread, and bytes of shared memory of a block, of each kernel in machine
    code."""
    text = subprocess.run([cuobjdump(), "-res-usage", cubin], capture_output=True, text=True, check=True).stdout
    used = []
    for kernel in kernels:
        found = re.search(rf"__{name_of(kernel)}_\w+:\s+REG:(\d+) STACK:(\d+) SHARED:(\d+) LOCAL:(\d+)", text)
        registers, stack, shared, local = map(int, found.groups())
        used.append((registers, stack + local, shared))
    return used


def counts(kernels: list, real, arch: int):
    """The rows of the table for some kernels of one precision."""
    with tempfile.TemporaryDirectory() as folder:
        ptx = {module: compiled(module, arch, Path(folder), True).read_text() for module in modules(kernels)}
        cubins = {module: compiled(module, arch, Path(folder), False) for module in modules(kernels)}
        for kernel in kernels:
            ((registers, local, shared),) = resources([kernel], cubins[kernel.module])
            text = ptx_of(kernel, ptx[kernel.module])
            yield {
                "precision": real.__name__,
                "kernel": name_of(kernel),
                "registers": registers,
                "local_bytes": local,
                "shared_bytes": shared,
                "reductions": " ".join(f"{count} {kind}" for kind, count in reductions(text).items()),
                "bytes": bytes_moved(text),
            }


def modules(kernels) -> set:
    """The Warp modules that kernels are in."""
    return {kernel.module for kernel in kernels}


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--arch", type=int, default=90, help="compute capability: 80, 90, 120")
    parser.add_argument("--label", default="present", help="what the step is called in the table")
    parser.add_argument("--looks", action="store_true", help="count looks of the host in 1,000 steps instead")
    parser.add_argument("--out", type=Path)
    options = parser.parse_args()
    if options.looks:
        start_warp()
        for rows in (False, True):
            print("  ".join(f"{count:,} {what}" for what, count in looks(1000, rows).items()))
        return
    if cuobjdump() is None:
        parser.error("no cuobjdump in PATH; pip install nvidia-cuda-cuobjdump brings one")
    start_warp()
    wp.config.enable_cpu_blocks = True
    rows = []
    for label, kernels_of in ((options.label, step_of), ("between outputs", between_outputs)):
        code = {"step": label, "arch": options.arch}
        for real in (wp.float32, wp.float64):
            rows += [code | row for row in counts(kernels_of(real), real, options.arch)]
    for row in rows:
        print("  ".join(f"{value!s:<{24 if key == 'kernel' else 10}}" for key, value in row.items()))
    if options.out:
        add_rows(options.out, rows)


if __name__ == "__main__":
    main()
