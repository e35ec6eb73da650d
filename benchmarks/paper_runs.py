"""The paper's columns over aspect ratio, damping, cone and pressure averaging: run-outs and speed as a CSV.

    python benchmarks/paper_runs.py --lambda0 0.5 1 --damping 0.05 0.4 --cone inner plane_strain \
        --averaging false true --device cpu --out benchmarks/results/NAME.csv

A row is added as each run ends; rows that are there already (same scene, device name, precision) are not
run again, so an interrupted table goes on where it stopped.
"""

import argparse
import csv
import itertools
import shlex
import sys
import tempfile
from pathlib import Path

from explicit.run import run
from mpm.config import load_scene
from mpm.provenance import provenance

CASE = ("lambda0", "damping", "cone", "pressure_averaging", "apex_memory", "cell", "precision")
FROM_SUMMARY = (
    "points", "R_max", "R_995", "R_connected", "h_inf", "eq4", "eq45", "stop_reason", "sim_time", "steps",
    "grid_ke_ratio", "mass_error", "energy_residual", "wall_s", "setup_s", "point_steps_per_s",
    "peak_memory_mb", "nodes_stored_start", "nodes_stored_max",
)  # fmt: skip
FROM_MACHINE = ("device_name", "warp", "commit", "date")
COLUMNS = (*CASE, *FROM_SUMMARY, *FROM_MACHINE, "command")


def cases(options):
    material = (options.cone, options.averaging, options.memory)
    grid = itertools.product(options.lambda0, options.damping, *material, options.cell, options.precision)
    return [dict(zip(CASE, (str(value) for value in values), strict=True)) for values in grid]


def compute(case, device) -> dict:
    """Run one case in a scratch folder and return its row."""
    preset = f"column_{float(case['lambda0']):g}"
    settings = [
        f"explicit.damping={case['damping']}",
        f"material.cone={case['cone']}",
        f"explicit.pressure_averaging={case['pressure_averaging']}",
        f"material.apex_memory={case['apex_memory']}",
        f"explicit.precision={case['precision']}",
        f"grid.cell={case['cell']}",
        "output.every=1000.0",
        "output.vtk=false",
    ]
    machine = provenance(device, case["precision"])
    with tempfile.TemporaryDirectory() as folder:
        summary = run(load_scene(preset, settings), folder, device, force=True)
    command = shlex.join(["python", *sys.argv])
    return {**case, **summary, **{key: machine[key] for key in FROM_MACHINE}, "command": command}


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--lambda0", nargs="+", default=["0.5", "1"], help="0.5, 1, 2, 4: the presets")
    parser.add_argument("--damping", nargs="+", default=["0.05", "0.4"])
    parser.add_argument("--cone", nargs="+", default=["plane_strain"])
    parser.add_argument("--averaging", nargs="+", default=["false"], choices=["false", "true"])
    parser.add_argument("--memory", nargs="+", default=["true"], choices=["false", "true"], help="apex_memory")
    parser.add_argument("--cell", nargs="+", default=["0.05"], help="[m]")
    parser.add_argument("--precision", nargs="+", default=["float64"])
    parser.add_argument("--device", default="cpu")
    parser.add_argument("--out", type=Path, required=True)
    options = parser.parse_args()
    name = provenance(options.device, "")["device_name"]
    done = list(csv.DictReader(options.out.open())) if options.out.exists() else []
    for case in cases(options):
        same = {**case, "device_name": name}
        if any(all(row[key] == value for key, value in same.items()) for row in done):
            continue
        row = compute(case, options.device)
        new = not options.out.exists()
        with options.out.open("a", newline="") as file:
            writer = csv.DictWriter(file, COLUMNS, extrasaction="ignore", restval="")
            if new:
                writer.writeheader()
            writer.writerow({key: f"{value:.6g}" if isinstance(value, float) else value for key, value in row.items()})
        print({key: row[key] for key in (*CASE, "R_max", "R_995", "stop_reason", "wall_s")}, flush=True)


if __name__ == "__main__":
    main()
