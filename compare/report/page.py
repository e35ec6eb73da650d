"""The report of a comparison: report.json and report.html, the page made from what the JSON says and nothing else."""

import base64
import csv
import json
import re
import struct
from pathlib import Path

from jinja2 import Environment, PackageLoader, StrictUndefined, UndefinedError

from mpm.errors import SceneError
from mpm.results import json_value, replace_file

REPORT_JSON, REPORT_HTML, TABLE = "report.json", "report.html", "table.csv"
TEMPLATE = "report.html.jinja"
WIDE = 2.0  # width over height from which a figure gets both columns: its letters would be too small in one
SUPERSCRIPT = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")


def refuse_another(directory: Path, about: dict, force: bool):
    """Raise SceneError where `directory` holds a report about something else, or one that cannot be read.

    about: what a report's key "about" says, for example the study's name and the resolved scene. A list in it may have
    grown: a report of more runs replaces that of fewer. `force`: never refuse.
    """
    path = Path(directory) / REPORT_JSON
    if force or not path.is_file():
        return
    here = json.loads(json.dumps(about))
    try:
        there = json.loads(path.read_text(encoding="utf-8"))["about"]
        known = there.keys() == here.keys() and all(_covers(here[key], there[key]) for key in here)
    except (ValueError, KeyError, TypeError, AttributeError):
        known = False
    if not known:
        raise SceneError(f"{path} is a report about something else: choose another --out, or --force replaces it")


def _covers(new, old) -> bool:
    return set(old) <= set(new) if isinstance(new, list) and isinstance(old, list) else new == old


def write_report(report: dict, directory: Path) -> Path:
    """Write report.json and report.html into `directory`, where the figures lie; returns the page's path.

    report: "title", "lead", "verdict" {"holds", "sentence"}, "checks" [{"name", "holds", "sentence"}] with
    "holds" None where nothing could be judged, "sections" [{"title", "text" [paragraphs], "tables" [{"caption",
    "columns", "rows"}], "figures" [{"file", "caption", "alt"}]}], "opening", figures to begin with, which may be left
    out, "provenance" {key: str or number}. Table cells are str, int, float or None. Other keys go into report.json
    only. NaN and infinities become null.

    The page is one file: the figures (PNG) are inside. KeyError for a key that is missing, FileNotFoundError for
    a figure that is; nothing is written then.
    """
    directory = Path(directory)
    report = json_value(report)
    page = _page(report, directory)
    text = json.dumps(report, indent=2, allow_nan=False) + "\n"
    for name, content in ((REPORT_JSON, text), (REPORT_HTML, page)):
        replace_file(directory / name, lambda path, content=content: path.write_text(content, encoding="utf-8"))
    return directory / REPORT_HTML


def write_table(rows: list[dict], directory: Path, name: str = TABLE):
    """Write the file `name` into `directory`: a line a row, a column for each key of the first one."""
    with open(Path(directory) / name, "w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, list(rows[0]))
        writer.writeheader()
        writer.writerows(rows)


def add_rows(path: Path, rows: list[dict]):
    """Add `rows` to the table `path`, which they begin where it is not there. SceneError where it has other columns."""
    refuse_other_columns(path, list(rows[0]))
    path.parent.mkdir(parents=True, exist_ok=True)
    new = not path.exists()
    with path.open("a", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, list(rows[0]))
        if new:
            writer.writeheader()
        writer.writerows(rows)


def refuse_other_columns(path: Path, columns: list[str]):
    """Raise SceneError where there is a table `path` with other columns: a row more would stand below wrong ones."""
    if path.exists():
        with path.open(newline="", encoding="utf-8") as file:
            if next(csv.reader(file), columns) != columns:
                raise SceneError(f"{path} has other columns, of an earlier version: choose another file")


def _page(report, directory):
    """The HTML of the report."""
    environment = Environment(
        loader=PackageLoader("compare.report", ""),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )
    environment.filters |= {
        "shown": _shown,
        "number_columns": _number_columns,
        "picture": lambda file: _picture(directory / file),
    }
    try:
        return environment.get_template(TEMPLATE).render(report=report)
    except UndefinedError as error:
        raise KeyError(error.message) from error


def _picture(path):
    """A PNG as a data URI, and whether it is wide."""
    data = path.read_bytes()
    width, height = struct.unpack(">II", data[16:24])
    return {"uri": "data:image/png;base64," + base64.b64encode(data).decode(), "wide": width >= WIDE * height}


def _number_columns(table):
    """For each column of a table whether most of its cells are numbers, or text that starts like one."""
    columns = ([row[index] for row in table["rows"]] for index in range(len(table["columns"])))
    return [_mostly_numbers([cell for cell in column if cell is not None]) for column in columns]


def _mostly_numbers(cells):
    numbers = [not isinstance(cell, str) or bool(re.match(r"[-+±≤≥<>~]?\s?\.?\d", cell)) for cell in cells]
    return 2 * sum(numbers) > len(numbers)


def _shown(value):
    """Floats with 4 significant digits, integers with thousands set apart, text as it is."""
    if isinstance(value, int):
        return f"{value:,}"
    if not isinstance(value, float):
        return value
    mantissa, _, exponent = f"{value:.4g}".partition("e")
    if not exponent:
        return mantissa
    power = int(exponent)
    if 0 < power < 7:
        return f"{float(f'{value:.4g}'):,.0f}"
    return f"{mantissa} × 10{str(power).translate(SUPERSCRIPT)}"
