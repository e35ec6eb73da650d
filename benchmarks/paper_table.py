"""Print the rows of tables made by `paper_runs.py` beside theory and experiment, as Markdown.

python benchmarks/paper_table.py benchmarks/results/paper_runs_cpu.csv
"""

import csv
import sys
from pathlib import Path

from compare.experiments import measured_runout
from mpm.analytic import eq6

HEADINGS = (
    "lambda0", "D", "cone", "pressure averaged", "apex memory", "R_995", "R_995 / Eq. 4 - 1", "R_max", "experiments",
    "Eq. 6", "t [s]", "ended by", "energy residual",
)  # fmt: skip


def cells(row):
    lambda0, r_995 = float(row["lambda0"]), float(row["R_995"])
    return (
        row["lambda0"], row["damping"], row["cone"], row["pressure_averaging"], row["apex_memory"],
        f"{r_995:.3f}", f"{r_995 / float(row['eq4']) - 1:+.1%}", f"{float(row['R_max']):.3f}",
        f"{measured_runout(lambda0):.3f}", f"{eq6(lambda0):.3f}", f"{float(row['sim_time']):.2f}",
        row["stop_reason"], f"{float(row['energy_residual']):.2%}",
    )  # fmt: skip


def main():
    rows = [row for path in sys.argv[1:] for row in csv.DictReader(Path(path).read_text().splitlines())]
    rows.sort(key=lambda r: (float(r["lambda0"]), r["apex_memory"] != "true", r["pressure_averaging"], r["cone"],
                             float(r["damping"])))  # fmt: skip
    print("| " + " | ".join(HEADINGS) + " |\n" + "|---" * len(HEADINGS) + "|")
    for row in rows:
        print("| " + " | ".join(cells(row)) + " |")


if __name__ == "__main__":
    main()
