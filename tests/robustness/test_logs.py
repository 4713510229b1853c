"""Mutations of a sensing log are refused in one line, or checked and localized to the end."""

import json
import re

import numpy as np
import pytest

from tests.robustness.mutations import as_json_lines, damaged, mutated, other_number
from tests.structures import Rule, structure, with_heights
from tiswarm.drawing import draw_log
from tiswarm.errors import InputError
from tiswarm.inspection import explain_estimate, inspect
from tiswarm.localization.registry import localize
from tiswarm.records.positions import read_estimate, write_estimate
from tiswarm.records.sensing_file import read_sensing_log, write_sensing_log
from tiswarm.robot import RobotGeometry
from tiswarm.scenario.validation import localization_params
from tiswarm.sensing import SensingParams, observe
from tiswarm.sensing.suites import STATIONS
from tiswarm.world.growth import grow
from tiswarm.world.params import TowerParams

pytestmark = pytest.mark.slow

NOISE = SensingParams(
    tilt_noise_deg=1.0,
    yaw_noise_deg=2.0,
    yaw_bias_deg=3.0,
    spawn_noise=0.1,
    false_contacts=0.1,
    beacons=STATIONS,
    beacon_kind="sweep",
    fix_bias=0.5,
    range_reach=6.0,
)
METHODS = {
    "virtual-force": ["iterations=20"],
    "joint": ["steps=40", "chains=2"],
    "least-squares": [],
    "hop-by-hop": [],
}
"""Methods with settings that keep an attempt short."""


@pytest.fixture(scope="module")
def logs(tmp_path_factory):
    """Lines of a log with every key, and of one with four docks and contacts alone."""
    [history] = grow(TowerParams(), robots=8, seeds=[0], robot=RobotGeometry())
    foreign = with_heights(*structure(Rule(kind="loops", docks=4), robots=8, seed=1))
    path = tmp_path_factory.mktemp("logs") / "sensing.jsonl"
    found = []
    for log in (observe(history, NOISE), foreign):
        write_sensing_log(log, path)
        found.append([json.loads(line) for line in path.read_text().splitlines()])
    return found


def _write_mutant(random, logs, path):
    """Write a log with up to three wrong numbers, values or keys, or with damaged bytes."""
    lines = random.choice(logs)
    edit = random.choice([mutated, other_number, None])
    for _ in range(random.randint(1, 3) if edit else 0):
        lines = edit(random, lines)
    raw = as_json_lines(lines)
    path.write_bytes(raw if edit else damaged(random, raw))


def _assert_localized(path, log, method):
    estimate = localize(log, localization_params(method, METHODS[method]))
    written = path.with_name("estimate.csv")
    write_estimate(written, estimate)
    back = read_estimate(log, written)
    assert back.position.shape == (log.robot_count, 3)
    assert np.isfinite(back.position).all()
    page = path.with_name("view.html")
    for found in (estimate, back):
        draw_log(page, log, found, name="log", **explain_estimate(log, path, found)._asdict())
    assert "NaN" not in page.read_text().partition('id="data">')[2].partition("</script>")[0]


def test_malformed_logs_are_refused_or_localized(trial, logs, tmp_path):
    """Nothing but InputError is raised; an estimate is finite, reads back and becomes a page."""
    path = tmp_path / "sensing.jsonl"
    for number in trial.numbers(2000):
        _write_mutant(trial.random(number), logs, path)
        outcome = "read and localized by each method"
        with trial.attempt(number, path):
            try:
                log = read_sensing_log(path)
            except InputError as mistake:
                said = str(mistake)
                assert re.match(rf"{re.escape(str(path))}:\d+: ", said), said
                assert said.isprintable(), said
                assert len(said) <= 1000, said
                outcome = "refused"
            else:
                assert not inspect(path).mistakes
                for method in METHODS:
                    _assert_localized(path, log, method)
            trial.outcomes[outcome] += 1

    assert trial.failures == []
    assert len(trial.outcomes) == 2  # some were refused and some were read
