"""Suites sense what their systems do, and say where their numbers come from."""

import dataclasses
from pathlib import Path

import numpy as np
import pytest

from tests.structures import SUITES
from tiswarm.records.sensing_file import read_sensing_log, write_sensing_log
from tiswarm.records.sensing_log import LISTS
from tiswarm.scenario.expansion import load_scenario, variants
from tiswarm.sensing import SensingParams, observe
from tiswarm.sensing.suites import CEILING, STATIONS

SENSED = {
    "fireant-v3": {"contacts", "ground_docks"},
    "coachbot-v1": {"fixes"},
    "coachbot-v2": {"fixes"},
    "zooids": {"fixes"},
    "kilobot": {"fixes", "ranges"},
    "freesn": {"contacts", "directions"},
    "m-blocks": {"contacts", "directions", "connections"},
    "atron": {"contacts", "directions", "connections"},
    "swarmbang": {"fixes"},
}

NEW_LISTS = [name for name, key in LISTS.items() if key.version == 2]
KINDS = ("measured by its authors", "second-hand", "inferred")


@pytest.mark.parametrize("name", SENSED)
def test_a_log_has_what_its_suite_senses(towers, name):
    """Nothing else is in the log, and touch adds the senses of FireAntV3 as they are."""
    plain = observe(towers[0], SensingParams())

    alone = observe(towers[0], SensingParams(suite=name))
    touching = observe(towers[0], SensingParams(suite=name, touch=True))

    assert {key for key in LISTS if len(getattr(alone, key))} == SENSED[name]
    is_ours = name == "fireant-v3"
    assert (alone.stances is not None, alone.ground_z is not None) == (is_ours, is_ours)
    assert np.isnan(alone.flip_height).all() != is_ours
    assert np.isnan(alone.spawn_position).all()
    for log in (touching, touching.stances):
        ours = plain if log is touching else plain.stances
        np.testing.assert_array_equal(log.contacts, ours.contacts)
        np.testing.assert_array_equal(log.ground_docks, ours.ground_docks)
    for key in NEW_LISTS:
        np.testing.assert_array_equal(getattr(touching, key), getattr(alone, key))
    if not SUITES[name].settings.get("yaw_noise_deg"):
        np.testing.assert_array_equal(touching.flip_height, plain.flip_height)
        np.testing.assert_array_equal(touching.orientation_wxyz, plain.orientation_wxyz)


@pytest.mark.parametrize("touch", [False, True])
@pytest.mark.parametrize("name", SENSED)
def test_logs_of_suites_survive_their_files(towers, name, touch, tmp_path):
    """A log that is written, read and written again keeps its bytes."""
    params = SensingParams(suite=name, touch=touch, yaw_noise_deg=1.0, sight_at="stances")
    first, second = tmp_path / "first.jsonl", tmp_path / "second.jsonl"

    write_sensing_log(observe(towers[2], params), first)
    write_sensing_log(read_sensing_log(first), second)

    assert first.read_bytes() == second.read_bytes()
    assert (b'"version": 1' in first.read_bytes()) == (name == "fireant-v3")


def test_fireant_is_the_default(towers, tmp_path):
    """A file without new settings has no keys that earlier programs cannot read."""
    path = tmp_path / "sensing.jsonl"

    write_sensing_log(observe(towers[0], SensingParams(touch=True)), path)

    assert SensingParams() == SensingParams(suite="fireant-v3")
    assert not [key for key in (*NEW_LISTS, '_deg": null') if key in path.read_text()]


def test_the_header_states_the_noise_in_use(towers):
    """A suite's noise of orientation, directions and connections, unless a key overrides it."""
    noise = observe(towers[0], SensingParams(suite="atron", direction_noise_deg=5.0)).noise
    heading = observe(towers[0], SensingParams(suite="swarmbang")).noise

    assert (noise.direction_deg, noise.connection_deg) == (5.0, 1.0)
    assert (heading.yaw_deg, heading.direction_deg) == (1.44, None)


def test_without_a_compass_only_the_anchor_knows_its_orientation(towers):
    """Its orientation is known as its position is, without the noise of a compass."""
    log = observe(towers[0], SensingParams(suite="m-blocks", yaw_noise_deg=9.0))

    np.testing.assert_array_equal(log.orientation_wxyz[0], towers[0].orientation_wxyz[0])
    assert np.isnan(log.orientation_wxyz[1:]).all()
    assert (log.noise.tilt_deg, log.noise.yaw_deg, log.noise.yaw_bias_deg) == (0.0, 0.0, None)


def test_the_page_has_every_suite():
    """The note has a row for each, and sources of its numbers with the kind of each."""
    page = (Path(__file__).parents[3] / "docs" / "notes" / "sensors.md").read_text().splitlines()
    rows = [line.split(" | ") for line in page]

    assert SUITES.keys() == SENSED.keys()
    for name, suite in SUITES.items():
        assert SensingParams(suite=name).suite == name
        around = suite.infrastructure_usd
        usd = [f"{suite.robot_usd:g}", "not stated" if around is None else f"{around:g}"]
        assert f"| `{name}` | {suite.senses} | {' | '.join(usd)} | {suite.needs} |" in page
        assert any(row[0] == f"| `{name}`" and row[3:4] and row[3] in KINDS for row in rows)


def test_a_suite_sets_defaults_that_keys_override(tmp_path):
    """In a scenario, in a condition, and where a condition chooses another suite."""
    path = tmp_path / "scenario.yaml"
    path.write_text(
        "name: suites\nstructure: {kind: tower}\nlocalization: {method: joint}\n"
        "sensing: {suite: zooids, tilt_noise_deg: 1.0, beacons: [[0, 0, 99]]}\n"
        "conditions:\n  own: {}\n  wide: {sensing.fix_noise: 2.0}\n"
        "  kilobot: {sensing.suite: kilobot, sensing.touch: true}\n"
        "  coachbot: {sensing: {suite: coachbot-v2}}\n"
    )

    own, wide, kilobot, coachbot = (v.settings.sensing for v in variants(load_scenario(path)))

    tilted = SensingParams(suite="zooids", tilt_noise_deg=1.0, beacons=((0, 0, 99),))
    assert own == tilted
    assert wide == dataclasses.replace(tilted, fix_noise=2.0)
    assert kilobot == SensingParams(
        suite="kilobot", tilt_noise_deg=1.0, beacons=((0, 0, 99),), touch=True
    )
    assert coachbot == SensingParams(suite="coachbot-v2")
    assert coachbot.beacons == STATIONS
    assert SensingParams(suite="zooids").beacons == (CEILING,)


@pytest.mark.parametrize(
    ("settings", "key", "problem"),
    [
        ("{suite: zoo}", "sensing.suite", "'zooids'"),
        ("{suite: [3]}", "sensing.suite", "'zooids'"),
        ("{suite: zooids, fix_nois: 3}", "sensing.fix_nois", "did you mean fix_noise?"),
        ("{suite: zooids, beacons: [[0, 0, a]]}", "sensing.beacons[0][2]", "should be a number"),
        ("{suite: zooids, beacons: [[0, 0]]}", "sensing.beacons[0][2]", "is missing"),
        ("{suite: zooids, fix_bias: 3}", "sensing", "set beacon_kind to sweep"),
        ("{compass: false}", "sensing", "set both to false"),
        ("{fix_noise: 0}", "sensing.fix_noise", "0.000001"),
        ("{suite: coachbot-v2, fix_bias: 1e-7}", "sensing.fix_bias", "0 or at least 1e-6; correct"),
        ("{suite: kilobot, range_bias: -1}", "sensing.range_bias", "greater than or equal to 0"),
        ("{range_bias: 1}", "sensing", "set range_reach or remove it"),
    ],
)
def test_mistakes_are_named(tmp_path, settings, key, problem):
    """The message has the key and what to do."""
    path = tmp_path / "scenario.yaml"
    path.write_text(
        f"name: suites\nstructure: {{kind: tower}}\nsensing: {settings}\n"
        "localization: {method: joint}\n"
    )

    with pytest.raises(Exception, match="sensing") as raised:
        load_scenario(path)

    assert f"{path}:3: {key}: " in str(raised.value)
    assert problem in str(raised.value)
