"""The page of a run works in a browser and agrees with the tables."""

import base64
import csv
import io
import re
import shutil
from html.parser import HTMLParser

import numpy as np
import pandas as pd
import pytest
from PIL import Image

from tests.browser import probe
from tiswarm.records.messages import three_digits

PROBE = """
const cases = document.querySelector("table[data-name=cases]");
const column = (place) => [...cases.tBodies[0].rows]
  .filter((row) => !row.hidden).map((row) => row.cells[place].textContent);
const heads = [...cases.querySelectorAll("th button")];
found.unsortable = [...document.querySelectorAll("th:not(:has(button))")].length;
const rmse = heads.findIndex((head) => head.textContent === "RMSE [R]");
heads[rmse].click();
found.ascending = column(rmse);
heads[rmse].click();
found.descending = column(rmse);
found.sorted = cases.querySelector("[aria-sort]").textContent;
const link = cases.closest("section").querySelector("a.csv");
link.addEventListener("click", (event) => event.preventDefault());
link.click();
found.csv = decodeURIComponent(link.href);
found.overflow = document.documentElement.scrollWidth - innerWidth;
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
  turned: () => view.dispatchEvent(event("keydown", {key: "ArrowLeft"})),
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
"""


@pytest.fixture(scope="module")
def seen(small_run, tmp_path_factory):
    """Results of a script in the page of a small run, in a browser."""
    page = (small_run / "report.html").read_text()
    return probe(page, PROBE, tmp_path_factory.mktemp("page"))


def test_the_page_draws_without_a_complaint(seen):
    """The browser reports no error, and the 3D view shows robots."""
    assert seen["troubles"] == []
    assert _colored(seen["whole"]) > 0.01


def test_the_view_takes_the_structure_apart(seen):
    """Slider, arrow keys and check boxes change the view."""
    assert _colored(seen["part"]) < 0.7 * _colored(seen["whole"])
    assert seen["turned"] != seen["part"]
    assert _colored(seen["emptied"]) < 3e-4  # rims of letters, of the title too
    assert re.fullmatch(
        r"Robot \d+, join index [0-3]: error [\d.]+ R, sensed force .*", seen["pointed"]
    )


@pytest.mark.trial
@pytest.mark.parametrize("options", [(), ("--disable-3d-apis",)], ids=["webgl", "canvas"])
def test_many_robots_look_like_few(seen, small_run, tmp_path, options):
    """WebGL and, without it, balls on a canvas cover the pixels that docks and arms cover."""
    page = (
        (small_run / "report.html").read_text().replace("const SOLID = 3000;", "const SOLID = 0;")
    )
    script = "found.whole = view.toDataURL(); document.body.dataset.found = JSON.stringify(found);"

    many = probe(page, script, tmp_path, more=options)

    few, shown = _is_colored(seen["whole"]), _is_colored(many["whole"])
    assert many["troubles"] == []
    least = 0.3 if options else 0.8  # the canvas has one ball a robot
    assert (few & shown).sum() > least * (few | shown).sum()


def _colored(picture: str) -> float:
    """Share of a canvas that robots cover [1]."""
    return float(_is_colored(picture).mean())


def _is_colored(picture: str) -> np.ndarray:
    """Whether each pixel of a canvas is neither grey nor transparent."""
    kind, _, data = picture.partition(",")
    assert kind == "data:image/png;base64"
    with Image.open(io.BytesIO(base64.b64decode(data))) as image:
        pixels = np.asarray(image.convert("RGBA")).astype(int)
    return np.ptp(pixels[..., :3], axis=2) * (pixels[..., 3] > 0) > 60


def test_the_table_of_cases_sorts_and_filters(seen, small_run):
    """Sorting is numeric in both directions; rows that contain all words remain."""
    rmse = pd.read_csv(small_run / "summary.csv")["rmse_R"]
    ascending = [three_digits(value) for value in sorted(rmse)]

    assert seen["ascending"] == ascending
    assert seen["descending"] == ascending[::-1]
    assert seen["sorted"] == "RMSE [R]"
    assert len(seen["filtered"]) == 4
    assert all("no-z" in name for name in seen["filtered"])


def test_every_table_sorts_and_can_be_downloaded(seen):
    """The downloaded rows are in the order and form of the page, which is not too wide."""
    kind, _, text = seen["csv"].partition(",")
    rows = list(csv.reader(text.splitlines()))

    assert kind == "data:text/csv;charset=utf-8"
    assert [row[rows[0].index("RMSE [R]")] for row in rows[1:]] == seen["descending"]
    assert seen["unsortable"] == 0
    assert seen["overflow"] <= 0


class _Sources(HTMLParser):
    """Gathers the addresses that a page loads."""

    def __init__(self, page):
        super().__init__()
        self.found = []
        self.feed(page)

    def handle_starttag(self, tag, attrs):
        self.found += [value for name, value in attrs if name in {"src", "href"}]


MOTION = """
const byId = (id) => document.getElementById(id);
const wait = (time) => new Promise((done) => setTimeout(done, time));
(async () => {
  found.cases = ["case", "beside"].map((id) => byId(id).selectedOptions[0].textContent);
  ["case", "beside"].forEach((id, n) => {
    byId(id).value = n;
    byId(id).dispatchEvent(new Event("change"));
  });
  found.panes = [...document.querySelectorAll(".panes canvas:not([hidden])")].length;
  byId("play").click();
  await wait(2000);
  found.joining = [byId("play").textContent, byId("joins").valueAsNumber];
  view.dispatchEvent(Object.assign(new Event("keydown"), {key: " "}));
  found.paused = byId("play").textContent;
  byId("track").value = "iterations";
  byId("track").dispatchEvent(new Event("change"));
  const titles = [];
  const write = CanvasRenderingContext2D.prototype.fillText;
  CanvasRenderingContext2D.prototype.fillText = function (text, ...place) {
    titles.push(text);
    write.call(this, text, ...place);
  };
  for (const at of [0, 200]) {
    byId("joins").value = at;
    byId("joins").dispatchEvent(new Event("input"));
    await wait(200);
  }
  found.titles = titles.filter((text) => text.includes("iteration"));
  document.body.dataset.found = JSON.stringify(found);
})();
"""


@pytest.mark.trial
def test_the_view_moves(small_run, tmp_path):
    """It opens on the best; robots join while it plays, a key stops it, and estimates converge."""
    page = (small_run / "report.html").read_text()

    moved = probe(page, MOTION, tmp_path, more=("--window-size=1280,800",))

    assert moved["troubles"] == []
    rmse = pd.read_csv(small_run / "table.csv").set_index("condition")["rmse_R_mean"]
    others = [name for name in rmse.index if name != rmse.idxmin()]  # all of Algorithm 1
    # Names of series have the measurements in which they differ.
    conditions = [name.partition(" / ")[0] for name in moved["cases"]]
    assert conditions == [rmse.idxmin(), others[0]]
    assert moved["panes"] == 2
    word, robots = moved["joining"]
    assert word == "Pause"
    assert 1 < robots < len(pd.read_csv(small_run / "cases/0-baseline/truth.csv"))
    assert moved["paused"] == "Play"
    # The title of the best series is broken before the iteration.
    first, *_, last = [text for text in moved["titles"] if text.startswith("iteration ")]
    rmse = pd.read_csv(small_run / "cases/0-baseline/convergence.csv")["rmse_R"]
    assert first.startswith("iteration 0, RMSE ")
    shown = [float(re.search(r"RMSE ([\d.]+) R", text)[1]) for text in (first, last)]
    assert shown == pytest.approx([rmse.iloc[0], rmse.iloc[-1]], rel=0.01)  # three digits


def test_the_page_is_one_small_file(small_run):
    """It loads no other file, and its links lead to its own headings."""
    page = small_run / "report.html"

    text = page.read_text()
    links = _Sources(text).found
    sources = [link for link in links if link.startswith("data:")]

    assert len(sources) >= 6
    assert {link for link in links if f'id="{link[1:]}"' not in text} == set(sources)
    assert page.stat().st_size < 8_000_000


def test_the_page_says_what_the_tables_say(small_run):
    """It contains means with their ranges, and the command that repeats the run."""
    text = (small_run / "report.html").read_text()
    page = re.sub(r" <span class=.spread.>(.*?)</span>", r" \1", text)

    for row in pd.read_csv(small_run / "table.csv").to_dict("records"):
        mean, *ends = (three_digits(row[f"rmse_R_{name}"]) for name in ("mean", "least", "most"))
        assert f"{mean} ({' to '.join(ends)})" in page
    assert "tiswarm run scenario.yaml --out again --arch cpu" in page


def test_the_command_on_the_page_repeats_the_run(tiswarm, small_run, tmp_path):
    """The command needs only the files of the run."""
    run = tmp_path / "run"
    shutil.copytree(small_run, run)
    page = (run / "report.html").read_text()
    command = re.search(r"<pre>tiswarm (.*)</pre>", page)[1].split()

    done = tiswarm(*command, "--no-pictures", cwd=run)

    assert done.returncode == 0, done.stderr
    again = next((run / "again").iterdir())
    assert again.name == small_run.name
    assert (again / "table.csv").read_bytes() == (small_run / "table.csv").read_bytes()


def test_an_animation_becomes_part_of_the_page(tiswarm, tmp_path):
    """`--movie` adds it to the page even without other pictures."""
    done = tiswarm(
        "run", "tests/tower.yaml", "--set", "robots=4", "--set", "seeds=1",
        "--set", "conditions={baseline: {}}", "--no-pictures", "--movie", "webp", "--out", tmp_path,
    )  # fmt: skip

    assert done.returncode == 0, done.stderr
    run = next(tmp_path.iterdir())
    movie = base64.b64encode((run / "renders" / "growth.webp").read_bytes()).decode()
    assert f"data:image/webp;base64,{movie}" in (run / "report.html").read_text()
