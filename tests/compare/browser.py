"""What a browser makes of a page: measured by headless Chromium, in a frame of any width."""

import html
import json
import re
import shutil
import subprocess
from pathlib import Path

import pytest

BROWSERS = ("chromium", "chromium-browser", "google-chrome")
WINDOW_HEIGHT = 900  # [px], less than a page's: a scroll bar takes its place, as on a screen
PROBE = """
<script>
// Boxes of all lines of text and of all pictures, as far as one sees them: within what scrolls them.
function boxes() {
  const found = [];
  const add = (what, element, rects) => {
    const holder = element.closest(".scroll");
    const frame = holder && holder.getBoundingClientRect();
    for (const box of rects) {
      const left = holder ? Math.max(box.left, frame.left) : box.left;
      const right = holder ? Math.min(box.right, frame.right) : box.right;
      if (right - left > 1 && box.height > 1) found.push({what, left, right, top: box.top, bottom: box.bottom});
    }
  };
  const texts = document.createTreeWalker(document.body, NodeFilter.SHOW_TEXT);
  while (texts.nextNode()) {
    const node = texts.currentNode, parent = node.parentElement;
    if (node.textContent.trim() === "" || parent.closest("script, style")) continue;
    const range = document.createRange();
    range.selectNodeContents(node);
    add(node.textContent.trim().slice(0, 60), parent, range.getClientRects());
  }
  for (const image of document.images) add("picture: " + image.alt, image, [image.getBoundingClientRect()]);
  return found;
}
function trouble() {
  const all = boxes(), wide = document.documentElement.clientWidth, said = [];
  all.forEach((one, index) => {
    if (one.left < -1 || one.right > wide + 1) said.push(one.what + " is cut");
    for (const other of all.slice(index + 1)) {
      const width = Math.min(one.right, other.right) - Math.max(one.left, other.left);
      const height = Math.min(one.bottom, other.bottom) - Math.max(one.top, other.top);
      // Lines of one paragraph touch: a font's box is taller than its letters.
      if (width > 1 && height > 0.3 * Math.min(one.bottom - one.top, other.bottom - other.top)) {
        said.push(one.what + " overlaps " + other.what);
      }
    }
  });
  return said;
}
addEventListener("load", () => {
  const shown = element => element.getClientRects().length > 0 && element.innerText.trim() !== "";
  parent.postMessage({
    window: innerWidth,
    client_width: document.documentElement.clientWidth,
    scroll_width: document.documentElement.scrollWidth,
    font_size: parseFloat(getComputedStyle(document.body).fontSize),
    images: Array.from(document.images, image => {
      const box = image.getBoundingClientRect();
      const column = image.parentElement.getBoundingClientRect();
      return {alt: image.alt, natural_width: image.naturalWidth, left: box.left, width: box.width,
              height: box.height, column: column.width};
    }),
    trouble: trouble(),
    tables: Array.from(document.querySelectorAll("table"), table => {
      const rows = Array.from(table.tBodies).flatMap(body => Array.from(body.rows));
      return {text: table.innerText.trim(), rows: rows.filter(shown).length};
    }),
  }, "*");
});
</script>
"""
# Chromium's own window cannot be as narrow as a telephone's; a frame in it can.
WRAPPER = """<!DOCTYPE html>
<pre id="probe"></pre>
<script>
addEventListener("message", event => document.getElementById("probe").textContent = JSON.stringify(event.data));
</script>
<iframe src="probed.html" style="width: {width}px; height: {height}px; border: 0"></iframe>
"""


def measure(page: Path, width: int, tmp_path: Path) -> dict:
    """Lay `page` out `width` px wide. All lengths in px, as CSS counts them.

    "window", "client_width" (the window without its scroll bar), "scroll_width" (larger than that: the page scrolls
    sideways), "font_size" of the body, "images" [{"alt", "natural_width" (0: broken), "left", "width", "height",
    "column" (width of what holds it)}], "tables" [{"text", "rows" (of the body, with text to see)}], "trouble" [what is
    wrong with lines of text and pictures: one is cut, or overlaps another].

    The page is copied into `tmp_path`, away from its neighbours: an image that is not inside it is broken.
    Skips the test where there is no browser; RuntimeError where it gave no answer.
    """
    browser = next(filter(None, map(shutil.which, BROWSERS)), None)
    if browser is None:
        pytest.skip(f"no browser to look at the page with: none of {', '.join(BROWSERS)} is on PATH")
    folder = tmp_path / "browser"
    folder.mkdir(exist_ok=True)
    (folder / "probed.html").write_text(page.read_text(encoding="utf-8") + PROBE, encoding="utf-8")
    wrapper = folder / "wrapper.html"
    wrapper.write_text(WRAPPER.format(width=width, height=WINDOW_HEIGHT), encoding="utf-8")
    command = [browser, "--headless", "--no-sandbox", "--disable-gpu", f"--user-data-dir={folder / 'profile'}"]
    command += ["--virtual-time-budget=10000", "--dump-dom", wrapper.as_uri()]
    answer = subprocess.run(command, capture_output=True, text=True, timeout=120)
    probe = re.search(r'<pre id="probe">(.+?)</pre>', answer.stdout, re.DOTALL)
    if probe is None:
        raise RuntimeError(f"{browser} did not measure {page}:\n{answer.stdout[-1000:]}\n{answer.stderr[-2000:]}")
    return json.loads(html.unescape(probe[1]))
