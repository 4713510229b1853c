"""Mutations of a sensing log are refused in one line, or checked, localized and exported."""

import json
import re
from dataclasses import replace

import numpy as np
import pytest

from tests.robustness.mutations import as_json_lines, damaged, mutated, other_number
from tests.robustness.quick_methods import JOINING, METHODS
from tests.robustness.sensed_rows import ALL_SENSES
from tests.structures import (
    Rule,
    grown,
    structure,
    with_connections,
    with_directions,
    with_fixes,
    with_heights,
    with_ranges,
)
from tiswarm.app.formats import export_view
from tiswarm.app.inspection import inspect
from tiswarm.app.logs import Log
from tiswarm.base.errors import InputError
from tiswarm.base.progress import Progress
from tiswarm.base.registry import BUILT_IN
from tiswarm.localization.methods import localize
from tiswarm.records.mcap import SENSING, encode_messages
from tiswarm.records.outputs import Outputs
from tiswarm.records.positions import read_estimate, write_estimate
from tiswarm.records.sensing_file import read_sensing_log, write_sensing_log
from tiswarm.report.swarm_view import view_log
from tiswarm.sensing import observe
from tiswarm.world.params import TowerParams

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def logs(tmp_path_factory):
    """Lines of a log with every key of each version, one with four docks, and one with events."""
    history = grown(TowerParams(), robots=8, seed=0)
    first = observe(history, ALL_SENSES)
    foreign = with_heights(*structure(Rule(kind="loops", docks=4), robots=8, seed=1))
    second = with_ranges(
        with_fixes(first, history, [2, 5], each=2, sd=0.1), history, reach=6.0, sd=0.1
    )
    second = with_connections(with_directions(second, history, sd_deg=1.0), history, sd_deg=1.0)
    unknown = observe(history, replace(ALL_SENSES, contact_docks="own"))
    path = tmp_path_factory.mktemp("logs") / "sensing.jsonl"
    found = []
    for log in (first, foreign, second, unknown):
        write_sensing_log(log, path)
        found.append([json.loads(line) for line in path.read_text().splitlines()])
    header, *robots = found[2]
    own, other, its = robots[7]["contacts"][0]
    events = [
        {"event": "release", "robot": other, "contacts": [[its, 7, own]]},
        {"event": "leave", "robot": 4},
        {**robots[5], "event": "replace", "stances": robots[5]["stances"][1:]},
    ]
    return [*found, [{**header, "version": 3}, *robots[:-1], *events[1:], robots[-1], events[0]]]


def _write_mutant(random, logs, path):
    """Write a log with up to three wrong numbers, values or keys, or with damaged bytes."""
    lines = random.choice(logs)
    edit = random.choice([mutated, other_number, None])
    for _ in range(random.randint(1, 3) if edit else 0):
        lines = edit(random, lines)
    raw = as_json_lines(lines) if path.suffix == ".jsonl" else _as_messages(lines)
    path.write_bytes(raw if edit else damaged(random, raw))


def _as_messages(lines):
    """Write plain data as MCAP; what JSON cannot express is text there."""
    content = json.loads(json.dumps(lines), parse_constant=str)
    return encode_messages({SENSING: ((0, entry) for entry in content)})


def _methods_for(log):
    """Name the methods; those that place robots as they join may refuse a log, in one line."""
    for method, params in METHODS.items():
        try:
            if method in JOINING:
                localize(log, params)
        except InputError as refusal:
            if not re.search("choose (method )?joint", str(refusal)):
                raise
        else:
            yield method


def _localized(path, log, method):
    """Localize a log by a method; the estimate reads back and becomes a page."""
    estimate = localize(log, METHODS[method])
    written = path.with_name("estimate.csv")
    write_estimate(written, estimate)
    back = read_estimate(log, written)
    assert back.position.shape == (log.robot_count, 3)
    assert np.isfinite(back.position).all()
    page = path.with_name("view.html")
    for found in (estimate, back):
        Log.of(log).with_estimate(found).view(out=page, overwrite=True)
    assert "NaN" not in page.read_text().partition('id="data">')[2].partition("</script>")[0]
    return estimate


def _assert_exported(folder, log, estimate):
    """Every format takes what a method made of the log."""
    true = np.where(np.isfinite(estimate.position), estimate.position + 0.5, 0.0)
    for shown in (view_log(log, estimate), view_log(log, estimate, true)):
        for form in BUILT_IN["export_format"]:
            export_view(shown, form, folder, Progress(), Outputs(overwrite=True))
    assert all(file.stat().st_size for file in folder.iterdir())


@pytest.mark.parametrize("suffix", [".jsonl", ".mcap"])
def test_malformed_logs_are_refused_or_localized(trial, logs, tmp_path, suffix):
    """Nothing but InputError is raised; an estimate is finite, reads back and is exported."""
    path = tmp_path / f"sensing{suffix}"
    for number in trial.numbers(1000):
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
                estimates = [_localized(path, log, method) for method in _methods_for(log)]
                _assert_exported(tmp_path / "export", log, trial.random(number).choice(estimates))
            trial.outcomes[outcome] += 1

    assert trial.failures == []
    assert len(trial.outcomes) == 2  # some were refused and some were read
