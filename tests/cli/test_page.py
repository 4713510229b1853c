"""The page of a run works in a browser and agrees with the tables."""

import base64
import io
import json
import re
import shutil
import subprocess
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from PIL import Image

CHROMIUM = next(
    filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None
)
LISTEN = """<script>
const troubles = [];
addEventListener("error", (event) => troubles.push(event.message));
console.error = (...words) => troubles.push(words.join(" "));
// Frames hardly come where time is virtual.
window.requestAnimationFrame = (draw) => setTimeout(draw, 10);
</script>"""
PROBE = """<script>
const found = {troubles};
const column = (place) => [...document.querySelectorAll("table.sortable tbody tr")]
  .filter((row) => !row.hidden).map((row) => row.cells[place].textContent);
const heads = [...document.querySelectorAll("table.sortable th button")];
const rmse = heads.findIndex((head) => head.textContent === "RMSE [R]");
heads[rmse].click();
found.ascending = column(rmse);
heads[rmse].click();
found.descending = column(rmse);
const filter = document.getElementById("filter");
filter.value = "NO-Z done";
filter.dispatchEvent(new Event("input"));
found.filtered = column(0);
const event = (kind, more) => Object.assign(new Event(kind), more);
const acts = {
  whole: () => {},
  part: () => {
    const joins = document.getElementById("joins");
    joins.value = 4;
    joins.dispatchEvent(event("input"));
  },
  turned: () => view.dispatchEvent(event("pointermove", {buttons: 1, movementX: 90, movementY: 0})),
  emptied: () => ["truth", "estimate", "error"].forEach((name) =>
    document.getElementById(`show-${name}`).click()),
};
(async () => {
  for (const [name, act] of Object.entries(acts)) {
    act();
    await new Promise((done) => setTimeout(done, 500));
    found[name] = view.toDataURL();
  }
  for (let x = 0; x < view.clientWidth && !found.pointed; x += 5)
    for (let y = 0; y < view.clientHeight && !found.pointed; y += 5) {
      view.dispatchEvent(event("pointermove", {buttons: 0, offsetX: x, offsetY: y}));
      found.pointed = document.getElementById("pointed").textContent;
    }
  document.body.dataset.found = JSON.stringify(found);
})();
</script>"""


@pytest.fixture(scope="module")
def seen(small_run, tmp_path_factory):
    """Results of a script in the page of a small run, in a browser."""
    if CHROMIUM is None:
        pytest.skip("no chromium or chrome here; install the package chromium")
    page = (small_run / "report.html").read_text()
    probed = tmp_path_factory.mktemp("page") / "probed.html"
    probed.write_text(
        page.replace("<head>", f"<head>{LISTEN}").replace("</body>", f"{PROBE}</body>")
    )
    options = ["--headless=new", "--no-sandbox", "--use-angle=swiftshader"]
    options += ["--enable-unsafe-swiftshader", "--virtual-time-budget=10000", "--dump-dom"]
    done = subprocess.run(
        [CHROMIUM, *options, probed.as_uri()], capture_output=True, text=True, timeout=200,
        check=False,
    )  # fmt: skip
    found = re.search(r'<body data-found="([^"]*)"', done.stdout)
    assert found, done.stderr[-2000:]
    return json.loads(found[1].replace("&quot;", '"').replace("&amp;", "&"))


def test_the_page_draws_without_a_complaint(seen):
    """The browser reports no error, and the 3D view shows robots."""
    assert seen["troubles"] == []
    assert _colored(seen["whole"]) > 0.01


def test_the_view_takes_the_structure_apart(seen):
    """Slider, rotation and check boxes change the view."""
    assert _colored(seen["part"]) < 0.7 * _colored(seen["whole"])
    assert seen["turned"] != seen["part"]
    assert _colored(seen["emptied"]) < 1e-4  # rims of letters
    assert re.fullmatch(r"Robot \d+, join index [0-3]: error [\d.]+ R\.", seen["pointed"])


def _colored(picture: str) -> float:
    """Share of a canvas that robots cover [1]: what is neither grey nor transparent."""
    kind, _, data = picture.partition(",")
    assert kind == "data:image/png;base64"
    with Image.open(io.BytesIO(base64.b64decode(data))) as image:
        pixels = np.asarray(image.convert("RGBA")).astype(int)
    return float((np.ptp(pixels[..., :3], axis=2) * (pixels[..., 3] > 0) > 60).mean())


def test_the_table_of_cases_sorts_and_filters(seen, small_run):
    """Sorting is numeric in both directions; rows that contain all words remain."""
    rmse = pd.read_csv(small_run / "summary.csv")["rmse_R"]
    ascending = [f"{value:.2f}" for value in sorted(rmse)]

    assert seen["ascending"] == ascending
    assert seen["descending"] == ascending[::-1]
    assert len(seen["filtered"]) == 4
    assert all("no-z" in name for name in seen["filtered"])


class _Sources(HTMLParser):
    """Gathers the addresses that a page loads."""

    def __init__(self, page):
        super().__init__()
        self.found = []
        self.feed(page)

    def handle_starttag(self, tag, attrs):
        self.found += [value for name, value in attrs if name in {"src", "href"}]


def test_the_page_is_one_small_file(small_run):
    """It loads no other file."""
    page = small_run / "report.html"

    sources = _Sources(page.read_text()).found

    assert len(sources) >= 6
    assert all(source.startswith("data:") for source in sources)
    assert page.stat().st_size < 8_000_000


def test_the_page_says_what_the_tables_say(small_run):
    """It contains means with their intervals, and the command that repeats the run."""
    page = (small_run / "report.html").read_text()

    for row in pd.read_csv(small_run / "table.csv").to_dict("records"):
        assert f"{row['rmse_R_mean']:.2f} ± {row['rmse_R_ci95']:.2f}" in page
    assert "tiswarm run scenario.yaml --out again --arch cpu" in page


def test_the_command_on_the_page_repeats_the_run(tiswarm, small_run, tmp_path):
    """The command needs only the files of the run."""
    run = tmp_path / "run"
    shutil.copytree(small_run, run)
    page = (run / "report.html").read_text()
    command = re.search(r"<pre>tiswarm (.*)</pre>", page)[1].split()
    repository = str(Path(__file__).parents[2])

    done = tiswarm(*command, "--no-pictures", cwd=run, PYTHONPATH=repository)

    assert done.returncode == 0, done.stderr
    again = next((run / "again").iterdir())
    assert again.name == small_run.name
    assert (again / "table.csv").read_bytes() == (small_run / "table.csv").read_bytes()


def test_an_animation_becomes_part_of_the_page(tiswarm, tmp_path):
    """`--animate` adds it to the page even without other pictures."""
    done = tiswarm(
        "run", "scenarios/tower.yaml", "--set", "robots=4", "--set", "seeds=1",
        "--set", "conditions={baseline: {}}", "--no-pictures", "--animate", "--out", tmp_path,
    )  # fmt: skip

    assert done.returncode == 0, done.stderr
    run = next(tmp_path.iterdir())
    movie = base64.b64encode((run / "renders" / "growth.gif").read_bytes()).decode()
    assert f"data:image/gif;base64,{movie}" in (run / "report.html").read_text()
