"""The report: JSON and page say the same, nothing is left outside the page, and a browser shows all of it."""

import base64
import copy
import json
import re
from html.parser import HTMLParser

import pytest
from browser import measure
from matplotlib.figure import Figure

from compare.report.page import add_rows, write_report
from mpm.errors import SceneError

REPORT = {
    "title": "column_small: implicit & explicit",
    "lead": "Both solvers on <one> scene.",
    "verdict": {"holds": False, "sentence": "1 of 3 checks holds; run-out differs by 6.3 %, allowed < 5 %."},
    "checks": [
        {"name": "Final height", "holds": True, "sentence": "0.5 m in both, 5 % allowed."},
        {"name": "Run-out <R_995>", "holds": False, "sentence": 'implicit "0.289" & explicit 0.308'},
        {"name": "Fine grid", "holds": None, "sentence": "the run failed in step 13"},
    ],
    "sections": [
        {
            "title": "Run-outs & heights",
            "text": ["R = (r - r0)/r0.", "tan(phi) > 0 & c = 0"],
            "tables": [
                {
                    "caption": "Measures of <both>",
                    "columns": ["measure", "explicit", "implicit", "difference", "stopped by", "lambda0 of the rest"],
                    "rows": [
                        ["R_995 [-]", 0.308342, 0.28891, "-6.3 %", "rest", 4],
                        ["points", 25120, 25120, None, "<rest>", 0.5],
                        ["time [s]", 12345.6, float("nan"), "+1.2 %", "a_name_without_any_place_to_break_it", 1],
                    ],
                }
            ],
            "figures": [
                {"file": "profiles.png", "caption": "Profiles at rest.", "alt": "two profiles"},
                {"file": "history.png", "caption": "Run-out over time.", "alt": "two histories"},
                {"file": "wide.png", "caption": "Three sections.", "alt": "three sections"},
            ],
        },
        {"title": "Words alone", "text": ["Nothing to see."], "tables": [], "figures": []},
    ],
    "provenance": {"repose": "0.1.0", "folder": "runs/" + "a-long-name" * 20, "points": 25120, "memory [MB]": None},
    "metrics": {"R_995": [0.308342, float("inf")], "hidden": "not on the page"},
}
SIGNS = {True: "✓ Holds", False: "✗ Does not hold", None: "? Not judged"}
VOID = {"meta", "img", "link", "br", "hr", "input", "base", "source"}
LOADED = ("src", "srcset", "poster", "data", "background", "href", "action")


class Page(HTMLParser):
    """The page's elements as (tag, attributes, text with single spaces), in order of their start."""

    def __init__(self, text):
        super().__init__()
        self.elements, self.open = [], []
        self.feed(text)

    def handle_starttag(self, tag, attributes):
        element = [tag, dict(attributes), ""]
        self.elements.append(element)
        if tag not in VOID:
            self.open.append(element)

    def handle_endtag(self, tag):
        assert self.open.pop()[0] == tag

    def handle_data(self, data):
        for element in self.open:
            element[2] += data

    def find(self, *tags, **attributes):
        wanted = attributes.items()
        return [
            (found, " ".join(text.split()))
            for tag, found, text in self.elements
            if tag in tags and all(found.get(name) == value for name, value in wanted)
        ]

    def texts(self, *tags):
        return [text for _, text in self.find(*tags)]


def draw(path, width, height):
    figure = Figure(figsize=(width, height), dpi=100)
    figure.add_subplot().plot([0, 1, 2], [1, 0, 2])
    figure.savefig(path)


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    """The page of REPORT, in a folder of its own."""
    folder = tmp_path_factory.mktemp("report")
    draw(folder / "profiles.png", 6, 4)
    draw(folder / "history.png", 6, 4)
    draw(folder / "wide.png", 11, 4)
    return write_report(REPORT, folder)


@pytest.fixture
def page(written):
    return Page(written.read_text(encoding="utf-8"))


def without_figures():
    report = copy.deepcopy(REPORT)
    report["sections"][0]["figures"] = []
    return report


def test_json_is_the_report_with_null_for_what_is_not_finite(written):
    assert written.name == "report.html"
    report = copy.deepcopy(REPORT)
    report["sections"][0]["tables"][0]["rows"][2][2] = None
    report["metrics"]["R_995"][1] = None
    assert json.loads((written.parent / "report.json").read_text(encoding="utf-8")) == report
    assert sorted(path.name for path in written.parent.glob("report*")) == ["report.html", "report.json"]


def test_page_and_json_agree_on_the_verdict_and_on_every_check(written, page):
    report = json.loads((written.parent / "report.json").read_text(encoding="utf-8"))
    (verdict,) = page.find("p", **{"class": "verdict no"})
    assert verdict[1] == f"{SIGNS[report['verdict']['holds']]} {report['verdict']['sentence']}"
    expected = [f"{SIGNS[check['holds']]} {check['name']} {check['sentence']}" for check in report["checks"]]
    assert page.texts("li") == expected
    assert [found["class"] for found, _ in page.find("li")] == ["yes", "no", "none"]


def test_a_verdict_that_holds_says_so(tmp_path):
    report = without_figures()
    report["verdict"] = {"holds": True, "sentence": "3 of 3 checks hold."}
    page = Page(write_report(report, tmp_path).read_text(encoding="utf-8"))
    assert page.find("p", **{"class": "verdict yes"})[0][1] == "✓ Holds 3 of 3 checks hold."


def test_every_text_is_on_the_page_as_it_was_given(page):
    """Parsed, so with <, > and & escaped: unescaped they would be other elements or gone."""
    section = REPORT["sections"][0]
    assert page.texts("title") == page.texts("h1") == [REPORT["title"]]
    assert REPORT["lead"] in page.texts("p")
    assert [text for text in section["text"] if text not in page.texts("p")] == []
    captions = [item["caption"] for item in section["tables"] + section["figures"]]
    assert page.texts("figcaption") == captions
    assert [found["alt"] for found, _ in page.find("img")] == [figure["alt"] for figure in section["figures"]]
    assert page.texts("h1", "h2")[1:] == ["Checks", "Run-outs & heights", "Words alone", "Provenance"]
    assert "not on the page" not in "".join(page.texts("html"))


def test_cells_are_formatted_and_what_is_not_available_is_a_dash(page):
    cells = page.texts("td", "th")
    assert cells[:6] == REPORT["sections"][0]["tables"][0]["columns"]
    assert cells[6:12] == ["R_995 [-]", "0.3083", "0.2889", "-6.3 %", "rest", "4"]
    assert cells[12:18] == ["points", "25,120", "25,120", "–", "<rest>", "0.5"]
    assert cells[18:23] == ["time [s]", "12,350", "–", "+1.2 %", "a_name_without_any_place_to_break_it"]
    assert cells[24:] == [
        *("repose", "0.1.0", "folder", REPORT["provenance"]["folder"]),
        *("points", "25,120", "memory [MB]", "–"),
    ]
    assert page.texts("span").count("–") == len(page.find("span", title="not available")) == 3


def test_columns_of_numbers_are_set_apart_from_columns_of_words(page):
    right = [found.get("class") == "number" for found, _ in page.find("td", "th")]
    assert right[:24] == 4 * [False, True, True, True, False, True]


@pytest.mark.parametrize(
    ("value", "shown"),
    [
        *((0.0, "0"), (-0.0612345, "-0.06123"), (99999.0, "100,000"), (5.84e6, "5,840,000")),
        *((5.84e8, "5.84 × 10⁸"), (-3.21e-9, "-3.21 × 10⁻⁹"), (1234567, "1,234,567"), ("1e9", "1e9")),
    ],
)
def test_numbers_have_four_digits_and_no_computer_notation(tmp_path, value, shown):
    report = without_figures()
    report["provenance"] = {"value": value}
    page = Page(write_report(report, tmp_path).read_text(encoding="utf-8"))
    assert page.texts("td")[-1] == shown


def test_figures_are_inside_the_page_and_it_loads_nothing(written, page):
    images = [found["src"] for found, _ in page.find("img")]
    for figure, source in zip(REPORT["sections"][0]["figures"], images, strict=True):
        kind, data = source.split(",")
        assert kind == "data:image/png;base64"
        assert base64.b64decode(data, validate=True) == (written.parent / figure["file"]).read_bytes()
    assert not page.find("script", "link", "iframe", "object", "base")
    loaded = [value for _, found, _ in page.elements for name, value in found.items() if name in LOADED]
    assert loaded == images
    (style,) = page.texts("style")
    assert not re.search(r"url\(|@import|https?:|file:", style)
    assert not any("style" in found for _, found, _ in page.elements)


def test_a_figure_that_is_not_there_is_named_and_nothing_is_written(tmp_path):
    with pytest.raises(FileNotFoundError, match=r"profiles\.png"):
        write_report(REPORT, tmp_path)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("path", [("lead",), ("verdict", "holds"), ("checks", 0, "holds"), ("sections", 0, "tables")])
def test_a_key_that_is_not_there_is_a_key_error_and_nothing_is_written(tmp_path, path):
    report = without_figures()
    *outer, key = path
    inner = report
    for step in outer:
        inner = inner[step]
    del inner[key]
    with pytest.raises(KeyError, match=key):
        write_report(report, tmp_path)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("width", [1280, 420])
def test_browser_shows_every_figure_and_table_without_scrolling_sideways(written, tmp_path, width):
    seen = measure(written, width, tmp_path)
    assert seen["window"] == width
    assert seen["scroll_width"] <= seen["client_width"] <= width
    assert seen["font_size"] >= 14
    assert [image["alt"] for image in seen["images"]] == ["two profiles", "two histories", "three sections"]
    for image in seen["images"]:
        assert image["natural_width"] in (600, 1100)
        assert image["width"] >= max(250, 0.9 * image["column"])
        assert image["height"] > 100
    first, second, wide = seen["images"]
    if width == 1280:
        assert second["left"] >= first["left"] + first["width"]
        assert wide["width"] == pytest.approx(2 * first["width"], rel=0.1)
    else:
        assert first["left"] == second["left"] == wide["left"]
        assert first["width"] == wide["width"]
    assert [table["rows"] for table in seen["tables"]] == [3, 4]
    assert "0.3083" in seen["tables"][0]["text"]


def test_browser_finds_broken_images_empty_tables_and_sideways_scrolling(tmp_path):
    draw(tmp_path / "beside.png", 6, 4)
    page = tmp_path / "broken.html"
    page.write_text(
        '<!DOCTYPE html><body style="font-size: 9px"><img src="beside.png"><img src="data:image/png;base64,AAAA">'
        "<table><thead><tr><th>head</th></tr></thead><tbody><tr><td> </td></tr></tbody></table>"
        '<p style="width: 1000px">wide</p>',
        encoding="utf-8",
    )
    seen = measure(page, 420, tmp_path)
    assert [image["natural_width"] for image in seen["images"]] == [0, 0]
    assert seen["tables"] == [{"text": "head", "rows": 0}]
    assert seen["scroll_width"] > seen["window"] == 420
    assert seen["font_size"] == 9


def test_rows_are_added_to_a_table_of_the_same_columns_only(tmp_path):
    path = tmp_path / "new" / "table.csv"
    add_rows(path, [{"a": 1, "b": 2.5}])
    add_rows(path, [{"a": 3, "b": 4}, {"a": 5, "b": 6}])
    assert path.read_text().split() == ["a,b", "1,2.5", "3,4", "5,6"]
    with pytest.raises(SceneError, match=r"table\.csv has other columns"):
        add_rows(path, [{"a": 7, "c": 1, "b": 8}])
    assert path.read_text().split()[-1] == "5,6"
