"""A page, pictures and exports show a log and its estimate, in the log's own unit."""

import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import trimesh

from tests.browser import probe
from tiswarm.app.drawing import draw_log
from tiswarm.app.formats import export_view
from tiswarm.app.inspection import Findings
from tiswarm.app.logs import Log
from tiswarm.base.progress import Progress
from tiswarm.cli import main
from tiswarm.measurements.advice.further import AdviceTable
from tiswarm.measurements.observability import observability
from tiswarm.records.estimate import MOST_WITHIN, CommonCause, Convergence, Estimate, Solution
from tiswarm.records.messages import MISSING
from tiswarm.records.outputs import Outputs
from tiswarm.records.sensing_log import SensingLog
from tiswarm.report.pictures import pictures
from tiswarm.report.pictures.pictures import build_pictures
from tiswarm.report.swarm_view import view_data, view_log
from tiswarm.sensing import SensingParams, observe

PROBE = """
const at = (x, y) => Object.assign(new Event("pointermove"), {buttons: 0, offsetX: x, offsetY: y});
for (let x = 0; x < view.clientWidth && !found.pointed; x += 5)
  for (let y = 0; y < view.clientHeight && !found.pointed; y += 5) {
    view.dispatchEvent(at(x, y));
    found.pointed = document.getElementById("pointed").textContent;
  }
found.first = view.toDataURL();
const menu = document.getElementById("case");
menu.value = 2;
menu.dispatchEvent(new Event("change"));
found.second = view.toDataURL();
found.quantity = document.getElementById("quantity").value;
document.body.dataset.found = JSON.stringify(found);
"""
"""Points at a robot, then chooses the third entry of the menu."""

FOLLOW = """
const at = (type, x, y) => Object.assign(
  new Event(type), {buttons: 0, pointerId: 1, clientX: x, clientY: y, offsetX: x, offsetY: y});
const send = (type, place) => view.dispatchEvent(at(type, ...place));
const click = (place) => { send("pointerdown", place); send("pointerup", place); };
const read = () => document.getElementById("pointed").textContent;
view.setPointerCapture = () => {}; // no real pointer has this number
let place = null;
for (let x = 0; x < view.clientWidth && !place; x += 5)
  for (let y = 0; y < view.clientHeight && !place; y += 5) {
    send("pointermove", [x, y]);
    if (read()) place = [x, y];
  }
found.named = read();
click(place);
send("pointermove", [0, 0]);
found.followed = read();
setTimeout(() => {
  const middle = [view.clientWidth / 2, view.clientHeight / 2];
  click(middle);
  found.middle = read();
  view.dispatchEvent(Object.assign(new Event("keydown"), {key: "0"}));
  send("pointermove", [0, 0]);
  found.released = read();
  document.body.dataset.found = JSON.stringify(found);
}, 500);
"""
"""Clicks at a robot, then at the middle, and lets it go."""

SPHERES = """
const click = (name) => document.getElementById(`show-${name}`).click();
const pixels = () => {
  view.dispatchEvent(Object.assign(new Event("keydown"), {key: "0"})); // draws again
  return new Promise((done) => setTimeout(() => done(
    view.getContext("2d").getImageData(0, 0, view.width, view.height).data), 500));
};
(async () => {
  found.on = document.getElementById("show-spheres").checked;
  ["estimate", "ground"].forEach(click);
  const without = await pixels();
  click("spheres");
  const drawn = await pixels();
  found.area = drawn.reduce((sum, v, k) => sum + (k % 4 === 3 && v > without[k]), 0);
  found.missing = !document.getElementById("no-spheres").hidden;
  const data = JSON.parse(document.getElementById("data").textContent), [shown] = data.cases;
  const box = boxOf([shown], data.radius), {clientWidth: width, clientHeight: height} = view;
  const {place} = cameraOf(box, START, fitOf(box, width, height).fit, width, height);
  found.scale = place(shown.estimate[7])[2];
  document.body.dataset.found = JSON.stringify(found);
})();
"""
"""Counts the pixels that spheres alone cover, and the pixels per R of robot 7."""

MM = 32.9
"""Radius of a dock of the log [mm]."""


@pytest.fixture
def log(towers) -> SensingLog:
    """What thirty robots sensed, in millimeters."""
    log = observe(towers[0], SensingParams())
    lengths = ("dock_radius", "dock_offset_body", "anchor_position", "flip_height")
    scaled = {name: getattr(log, name) * MM for name in lengths}
    return replace(log, **scaled, length_unit="mm")


@pytest.fixture
def true(towers):
    """True positions of the robots [mm]."""
    return towers[0].position * MM


@pytest.fixture
def estimate(log, true) -> Estimate:
    """An estimate that is off by 3 mm and 4 mm, and the second of two solutions."""
    off = np.zeros((30, 3))
    off[1:] = [3.0, 0.0, 4.0]
    sd = np.linspace(0.0, 2.9, 30)
    sd[7] = np.nan
    far = true + np.array([0.0, 100.0, 0.0])
    return Estimate(
        robot_id=log.robot_id,
        position=true + off,
        disconnected=np.zeros(30, bool),
        sd=sd,
        solutions=tuple(
            Solution(
                weight=0.5,
                chi_square=1.0,
                chains=chains,
                residual=0.5,
                residual_sd=1.0,
                position=position,
            )
            for chains, position in [(5, true), (3, far)]
        ),
        iteration=np.empty(0, np.int64),
        trace=np.empty((0, 30, 3)),
        residual=np.array([0.25]),
        length_unit="mm",
        dock_radius=MM,
    )


def _explained(log, estimate) -> dict[str, object]:
    found = Findings(log, Path("log"), estimate)
    return {name: getattr(found, name) for name in ("warnings", "notes", "advice")}


def _page(path, log, estimate, **more) -> tuple[str, dict]:
    """Draw a page; returns its text and the data of its 3D view."""
    outputs = Outputs(overwrite=True)
    draw_log(path / "view.html", log, estimate, name="a log", outputs=outputs, **more)
    text = (path / "view.html").read_text()
    found = re.search(r'<script type="application/json" id="data">(.*?)</script>', text, re.DOTALL)
    return text, json.loads(found[1])


def _viewed(path, log, estimate) -> str:
    """Show an estimate as the command does; returns the text of the page."""
    return (
        Log.of(log).with_estimate(estimate).view(out=path / "view.html", overwrite=True).read_text()
    )


def test_a_page_needs_no_truth(log, estimate, tmp_path):
    """It shows the standard deviation and each solution, and offers nothing that it lacks."""
    text, data = _page(tmp_path, log, estimate, notes=["one contact only: 2 robots"])

    assert "<li>one contact only: 2 robots</li>" in text
    near = "29 of 30 robots are within 33 mm (1 R) of where they are shown (95 %)"
    assert f"{near}; the position of 1 is a guess; expected RMSE " in text
    assert "RMSE" not in text.replace("expected RMSE", "")
    assert 'id="show-truth"' not in text
    assert [case["name"] for case in data["cases"]] == ["estimate", "solution 1", "solution 2"]
    assert all(case["true"] == [] for case in data["cases"])
    within, sd = data["cases"][0]["colors"]
    assert (within["label"], within["unit"], sd["label"]) == ("within 33 mm (1 R)", "%", "sd")
    assert within["value"][0] == 100.0
    assert within["value"][7] is sd["value"][7] is None
    assert ">within 33 mm (1 R) [%]<" in text


def test_guesses_do_not_stretch_the_scale(log, estimate, tmp_path):
    """The sd of a disconnected robot is neither in the sentence nor in the colors."""
    lost = np.arange(30) == 29
    sd = np.where(lost, 1e4, 2.0)

    found = replace(estimate, sd=sd, disconnected=lost, outlier_contacts=np.zeros((2, 5), int))

    text, data = _page(tmp_path, log, found)

    assert "The estimate judges 2 measurements wrong." in text
    assert "(95 %); the position of 1 is a guess; expected RMSE 2 mm." in text
    within, color = data["cases"][0]["colors"]
    assert color["value"] == [2.0] * 29 + [None]
    assert [value is None for value in within["value"]] == [False] * 29 + [True]
    assert "disconnected from the anchor are gray" in text


def test_a_page_says_which_robots_are_mirrored_and_what_each_solution_weighs(
    log, estimate, tmp_path
):
    """A reader sees in the first screen that the mean lies between two places."""
    good = Convergence(converged=True, consistent=True, misfit_sd=0.3, chains=8, restarted=0)
    found = replace(
        estimate,
        convergence=good,
        mirrored=np.arange(30) == 4,
        observability=observability(log, ["contacts", "height"], estimate.position),
        solutions=tuple(
            replace(each, weight=weight, chi_square=cost, sd=np.full(30, 2.0))
            for each, weight, cost in zip(
                estimate.solutions, (0.714, 0.286), (3.0, 4.8), strict=True
            )
        ),
    )

    text, data = _page(tmp_path, log, found, **_explained(log, found))

    said = "; measurements do not determine where 19 of 30 robots are; mirrored: 1 robot (4)"
    assert f"2 configurations fit, the likeliest has 71 %{said}" in text
    assert "<li>mirrored: 1 robot (4); configurations that fit" in text
    cells = re.findall("<td[^>]*>(.*?)</td>", text.partition("Solutions</a>")[2])
    assert cells[:7] == ["1", "71", "0", "5", "0.5", "0", "0"]
    assert cells[7:11] == ["2", "29", "+1.8", "3"]
    assert 'class="text">mirrored</td>' in text
    assert "mirrored if configurations that fit" in text
    assert [[color["label"] for color in case["colors"]] for case in data["cases"]] == [
        ["within 33 mm (1 R)", "sd"],
        ["distance from the estimate", "sd"],
        ["distance from the estimate", "sd"],
    ]


@pytest.mark.parametrize("is_converged", [True, False], ids=["at-odds", "lost"])
def test_a_page_of_an_estimate_that_is_not_trusted_says_why(is_converged, log, estimate, tmp_path):
    """The line under the result points to the warning, which has the reason."""
    verdicts = Convergence(
        converged=is_converged, consistent=False, misfit_sd=27.0, chains=8, restarted=0,
        reason="heights disagree",
    )  # fmt: skip
    found = replace(estimate, convergence=verdicts, outlier_robots=np.array([3]))

    text, _ = _page(tmp_path, log, found, **_explained(log, found))

    verdict = "Not consistent" if is_converged else "Neither converged nor consistent"
    assert f"{verdict}: see Warnings. The estimate judges 1 orientation wrong." in text
    assert f"<li>{verdict.lower()}: heights disagree (chi-square exceeds its expectation" in text


def test_a_page_without_truth_works_in_a_browser(log, estimate, tmp_path):
    """The browser reports no error; the menu shows another solution, and robots have names."""
    text, _ = _page(tmp_path, log, estimate)

    seen = probe(text, PROBE, tmp_path)

    assert seen["troubles"] == []
    assert seen["first"] != seen["second"]
    assert re.fullmatch(
        r"Robot \d+, join index \d+: within 33 mm \(1 R\) [\d.]+ %, sd [\d.]+ mm\.", seen["pointed"]
    )
    assert seen["quantity"] == "distance from the estimate"


def test_a_click_keeps_a_robot_in_the_middle(log, estimate, tmp_path):
    """Its values stay until the view is reset, wherever the pointer goes."""
    text, _ = _page(tmp_path, log, estimate)

    seen = probe(text, FOLLOW, tmp_path)

    assert seen["troubles"] == []
    assert seen["named"].startswith("Robot ")
    assert seen["followed"] == seen["middle"] == seen["named"]
    assert seen["released"] == ""


@pytest.mark.trial
@pytest.mark.parametrize("options", [(), ("--disable-3d-apis",)], ids=["webgl", "canvas"])
def test_spheres_contain_nine_of_ten_positions(options, log, estimate, tmp_path):
    """A switch, off at first, draws them with their radius; without WebGL the page says so."""
    sd = np.where(np.arange(30) == 7, 3.0 * MM, 0.0)
    sd[9] = np.nan
    text, _ = _page(tmp_path, log, replace(estimate, sd=sd, solutions=()))

    seen = probe(text, SPHERES, tmp_path, more=options)

    assert not seen["on"]
    assert seen["troubles"] == []
    assert seen["missing"] == bool(options)
    area = 0.0 if options else np.pi * (MOST_WITHIN * 3.0 * seen["scale"]) ** 2
    assert seen["area"] == pytest.approx(area, rel=0.05)  # without lines of the box
    assert f"a ball of radius {MOST_WITHIN} sd" in text


def test_a_page_explains_the_least_certain_robot(log, estimate, tmp_path):
    """Of those that touch two docks of earlier robots; the caption says which and why."""
    touched = np.bincount(log.contacts[:, 2], minlength=30)
    expected = max(np.flatnonzero(touched >= 2), key=lambda k: np.nan_to_num(estimate.sd[k]))

    text = _viewed(tmp_path, log, estimate)

    caption = re.search("<figcaption>(.*?)</figcaption>", text)[1]
    assert f"How the measurements of robot {log.robot_id[expected]} narrow its place" in caption
    assert f"the largest standard deviation, {estimate.sd[expected]:.2f} mm." in caption
    figure = text.partition('<div class="drawing across"')[2]
    assert re.search(r"[125] R = [\d.]+ mm<", figure)


def test_without_sd_a_page_explains_the_robot_that_touches_most(log, estimate, tmp_path):
    """A table of positions alone has no standard deviations."""
    most = int(np.bincount(log.contacts[:, 2]).argmax())

    text = _viewed(tmp_path, log, replace(estimate, sd=None))

    assert f"measurements of robot {most} narrow" in text
    assert "No robot touches more docks of earlier robots than this one" in text


def test_a_page_without_contacts_explains_no_robot(log, estimate, tmp_path):
    """Nothing ties one place to another there."""
    alone = replace(log, contacts=np.empty((0, 4), np.int32))

    text = _viewed(tmp_path, alone, estimate)

    assert "narrow its place" not in text


def test_with_a_truth_a_page_shows_errors(log, estimate, true, tmp_path):
    """The sentence, the table of robots and the view agree."""
    text, data = _page(tmp_path, log, estimate, true=true)

    assert f". The RMSE is {5.0 * np.sqrt(29 / 30):.3g} mm." in text
    error, _, sd = data["cases"][0]["colors"]
    assert (error["label"], error["unit"], sd["label"]) == ("error", "mm", "sd")
    assert error["value"] == [0.0] + [5.0] * 29
    assert 'id="show-truth"' in text


def test_the_view_is_in_radii_and_its_labels_in_the_unit_of_the_log(log, estimate, true, tmp_path):
    """Robots have the same size on the screen in any unit."""
    _, data = _page(tmp_path, log, estimate, true=true)

    assert (data["radius"], data["unit"]) == (MM, "mm")
    np.testing.assert_allclose(data["cases"][0]["true"], true / MM, atol=1e-4)
    moved = next(case for case in data["cases"] if case["name"] == "solution 2")
    np.testing.assert_allclose(
        np.array(moved["estimate"])[:, 1], true[:, 1] / MM + 100.0 / MM, atol=1e-4
    )
    (away,) = moved["colors"]
    assert (away["label"], away["unit"]) == ("distance from the estimate", "mm")


def test_a_method_without_uncertainty_has_no_colors_of_its_own(log, estimate, tmp_path):
    """The page colors robots by join index, which is always known."""
    text, data = _page(tmp_path, log, replace(estimate, sd=None, solutions=()))

    (case,) = data["cases"]
    assert (case["name"], case["colors"]) == ("estimate", [])
    assert "a ball of radius" not in text


def test_texts_of_a_log_stay_texts(log, estimate, tmp_path):
    """A log of somebody else cannot run a script in a reader's browser."""
    unit = "</script><script>boom()</script>"

    text, data = _page(tmp_path, replace(log, length_unit=unit), estimate, notes=[unit])

    assert "<script>boom" not in text
    assert data["unit"] == unit


def test_a_page_tabulates_the_parameters_that_may_be_wrong(log, estimate, tmp_path):
    """The line under the result names them, and each has its own remedy."""
    verdicts = Convergence(converged=True, consistent=True, misfit_sd=9.0, chains=8, restarted=0)
    causes = (
        CommonCause("dock radius", "dock_radius", 32.9, 33.6334, 0.019, "mm"),
        CommonCause("dock offset", "dock_offsets", 48.705, 47.6891, 0.018, "mm"),
    )
    wrong = replace(estimate, convergence=verdicts).with_common_causes(causes)

    text, _ = _page(tmp_path, log, wrong, **_explained(log, wrong))
    without, _ = _page(tmp_path, log, estimate)

    assert "Not consistent: a wrong dock radius or dock offset, see Warnings." in text
    assert "measure which of them is wrong; dock radius: state it in the log (dock_radius)" in text
    assert "dock offset: state it in the log (dock_offsets)" in text
    table = text[text.index("Parameters that may be wrong") :]
    assert re.findall(r"<td[^>]*>([^<]*)</td>", table)[:12] == [
        *("dock radius", "32.900", "33.633", "0.019", "mm", "dock_radius"),
        *("dock offset", "48.705", "47.689", "0.018", "mm", "dock_offsets"),
    ]
    assert "Parameters that may be wrong" not in without


@pytest.mark.parametrize(
    ("file", "heading"),
    [
        ("take/sensing.jsonl", "take/sensing.jsonl, 30 robots"),
        ("take/sensing.jsonl.xz", "take/sensing.jsonl.xz, 30 robots"),
        ("take/monday.jsonl", "monday.jsonl, 30 robots"),
    ],
)
def test_the_heading_of_a_page_tells_logs_of_one_name_apart(log, estimate, file, heading):
    """Imports and runs call each log sensing; robots and the method follow."""
    shown = Log.of(log, Path(file)).with_estimate(estimate)

    assert shown.title == heading
    assert replace(shown, method="joint").title == f"{heading} by joint"
    assert shown.with_solution(2).title == f"solution 2 of 2, weight 50 %: {heading}"


def test_what_to_measure_next_is_a_table(log, estimate, tmp_path):
    """Advice has the headings of its rows; a page without advice has no such section."""
    advice = [{"rank": "1", "further measurement": "height of robot 3", "robots determined": "2"}]

    with_it, _ = _page(tmp_path, log, estimate, advice=advice)
    without, _ = _page(tmp_path, log, estimate)

    assert "What to measure next" in with_it
    assert "height of robot 3" in with_it
    assert "What to measure next" not in without


def test_advice_may_lack_numbers(log, estimate, tmp_path):
    """Of a damaged log some expected errors are not finite; the page shows a dash for these."""
    row = {"rank": "1", "further measurement": "height of robot 3", "robots determined": "2"}
    advice = AdviceTable([row, {**row, "rank": "2", "expected RMSE [mm]": "1.5"}])

    text, _ = _page(tmp_path, log, estimate, advice=advice)

    assert "<td>2</td>" in text
    _, _, table = text.partition("What to measure next")
    assert f"<td>{MISSING}</td>" in table
    assert "<td>1.5</td>" in table
    assert [line.split()[-1] for line in str(advice).splitlines()] == ["[mm]", MISSING, "1.5"]


def test_pictures_show_what_is_known(log, estimate, true):
    """Without a truth they show the estimate; a log has no forces."""
    known = [build_pictures(view_log(log, estimate, truth)) for truth in (None, true)]

    assert [*known[0]] == ["estimate", "sd", "contact-graph"]
    assert [*known[1]] == ["structure", "truth-and-estimate", "error", "sd", "contact-graph"]
    assert known[1]["error"].legend.low == "error [mm]  0"
    assert known[1]["error"].legend.high == "5.00"


def test_robots_that_left_are_not_shown(log, estimate, true, tmp_path):
    """Pictures, exports and pages take their poses from one view; the others stay as they are."""
    left = replace(log, gone=np.array([3]), left_after=np.array([9]))

    view, every = view_log(left, estimate, true), view_log(log, estimate, true)
    export_view(view, "csv", tmp_path, Progress())

    stay = np.arange(log.robot_count) != 3
    table = pd.read_csv(tmp_path / "estimate.csv").dropna(subset="x_mm")
    assert table["robot"].tolist() == log.robot_id[stay].tolist()
    assert view_data(view)["robot"] == log.robot_id[stay].tolist()
    hubs = [
        len(np.unique(build_pictures(v)["structure"].scene.start, axis=0)) for v in (view, every)
    ]
    assert hubs[0] < hubs[1]
    assert np.array_equal(view.pose[stay], every.pose[stay])


def test_pictures_of_map_coordinates_are_as_sharp(log, estimate, tmp_path, monkeypatch):
    """Pictures have 32-bit numbers, so that far from the origin robots would lose their shape."""
    drawn = []

    def draw_scenes(scenes, *_):
        drawn.append(scenes[0])
        return [np.zeros((9, 9, 3), np.uint8)] * len(scenes), "none", ""

    monkeypatch.setattr(pictures, "draw_scenes", draw_scenes)
    away = np.array([5e8, 4e9, 1e5])
    far = replace(log, ground_z=float(away[2]), anchor_position=log.anchor_position + away)
    moved = replace(estimate, position=estimate.position + away)

    export_view(view_log(replace(log, ground_z=0.0), estimate), "png", tmp_path, Progress())
    export_view(view_log(far, moved), "png", tmp_path / "far", Progress())

    np.testing.assert_allclose(drawn[0].start, drawn[1].start, atol=1e-5)
    assert drawn[0].ground is not None
    np.testing.assert_allclose(drawn[0].ground.corner, drawn[1].ground.corner, atol=1e-5)
    assert (tmp_path / "sd.png").is_file()


def test_exports_have_the_unit_of_the_log(log, estimate, true, tmp_path):
    """Tables and solids are as large as the structure is; the structure needs a truth."""
    export_view(view_log(log, estimate), "csv", tmp_path / "csv", Progress())
    export_view(view_log(log, estimate, true), "ply", tmp_path / "ply", Progress())

    assert sorted(path.name for path in (tmp_path / "csv").glob("[!.]*")) == [
        "contacts.csv", "estimate.csv",
    ]  # fmt: skip
    table = pd.read_csv(tmp_path / "csv" / "estimate.csv")
    np.testing.assert_allclose(table[["x_mm", "y_mm", "z_mm"]], estimate.position)
    np.testing.assert_allclose(table["sd_mm"], estimate.sd)
    solid = trimesh.load(tmp_path / "ply" / "structure.ply")
    extent = solid.bounds + log.anchor_position  # solids have their origin at the anchor
    assert (np.abs(extent - [true.min(axis=0), true.max(axis=0)]) < 2.506 * MM).all()


@pytest.mark.parametrize(
    ("arguments", "problem"),
    [
        (
            "export . estimate.csv",
            "ESTIMATE: a run has its own (sensing.jsonl of a case takes others); leave it out",
        ),
        (
            "export . --format csv --truth truth.csv",
            "--truth: a run has its own (sensing.jsonl of a case takes others); leave it out",
        ),
        ("view --live . --explain 3", "--explain: --live shows a run; leave it out"),
        ("export log.jsonl --format csv --case 0-a", "--case: a log is no run; leave it out"),
        ("localize log.jsonl --open", "--open: needs a page; add --report PAGE"),
        ("export . --case 0-a", "is no run folder with results"),
        ("export nowhere", "nowhere: there is no such file; check the path"),
    ],
)
def test_what_a_run_or_a_log_lacks_is_refused(arguments, problem, tmp_path, monkeypatch, capsys):
    """The message says what to leave out or to add."""
    (tmp_path / "log.jsonl").touch()
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("sys.argv", ["tiswarm", *arguments.split()])

    with pytest.raises(SystemExit) as end:
        main()

    assert end.value.code == 2
    assert problem in capsys.readouterr().err
