"""What became of every test since a commit: a line a test function, `results/test_names.csv`.

    git worktree add --detach /tmp/before 6cc6b77^
    (cd /tmp/before && PYTHONPATH=. python -m pytest --collect-only -q) > before.txt
    python -m pytest --collect-only -q > now.txt
    python benchmarks/tests_moved.py before.txt now.txt > benchmarks/results/test_names.csv

A test that has vanished without a successor is an error. Cases are the parametrised tests of a function.
"""

import csv
import sys
from collections import Counter, defaultdict
from pathlib import Path

# Tests that have another name now, and why.
FAULTS, INTERRUPTED = "tests/hard/test_faults.py", "tests/hard/test_interrupted.py"
PLAIN = "each finding is a plain test now"
SUCCESSORS = {
    "tests/hard/test_hard_faults.py": (FAULTS, PLAIN),
    "tests/hard/test_hard_interrupted.py": (INTERRUPTED, PLAIN),
    "tests/compare/test_plots.py::test_picture_is_written_where_asked_and_not_blank": (
        "tests/compare/test_plots.py::test_picture_is_not_blank",
        "pictures are returned as figures; that they are written is tested with `repose plot`",
    ),
    "tests/compare/test_plots.py::test_200_000_points_are_thinned_to_the_surface_and_drawn_in_time": (
        "tests/compare/test_plots.py::test_200_000_points_are_drawn_as_the_surface_of_their_cells",
        "a deposit is drawn as a surface, no longer as thinned points",
    ),
    "tests/compare/test_plots.py::test_surface_points_are_those_of_the_outer_cells": (
        "tests/compare/test_surface.py",
        "a deposit is drawn as a surface, no longer as thinned points",
    ),
    "tests/mpm/test_config.py::test_the_presets_are_the_papers_columns_and_three_small_scenes": (
        "tests/mpm/test_config.py::test_the_presets_are_the_papers_columns_and_four_small_scenes",
        "column_sand is new",
    ),
}
COLUMNS = ("before", "now", "became", "cases before", "cases now")


def functions(listing: str) -> Counter:
    """Test functions in what pytest collected, with the number of their cases."""
    lines = Path(listing).read_text(encoding="utf-8").splitlines()
    return Counter(line.split("[")[0] for line in lines if "::" in line)


def main():
    """Print the table. Arguments: what pytest collected before and now."""
    before, now = map(functions, sys.argv[1:3])
    by_name, successors = defaultdict(list), set()
    for test in now:
        by_name[test.partition("::")[2]].append(test)
    table = csv.DictWriter(sys.stdout, COLUMNS, lineterminator="\n")
    table.writeheader()

    def row(old, new, became):
        counts = [before[old] if old else "", sum(now[test] for test in new) if new else ""]
        table.writerow(dict(zip(COLUMNS, (old, "; ".join(new), became, *counts), strict=True)))

    vanished = []
    for test in before:
        file, name = test.split("::", 1)
        if test in now:
            row(test, [test], "same")
        elif known := SUCCESSORS.get(test) or SUCCESSORS.get(file):
            new = [one for one in now if one == known[0] or one.startswith(f"{known[0]}::")]
            successors.update(new)
            row(test, new, f"rewritten: {known[1]}")
        elif len(by_name[name]) == 1:
            successors.update(by_name[name])
            row(test, by_name[name], "moved")
        else:
            vanished.append(test)
    for test in now:
        if test not in before and test not in successors:
            row("", [test], "new")
    if vanished:
        sys.exit("vanished without a successor:\n" + "\n".join(vanished))


if __name__ == "__main__":
    main()
