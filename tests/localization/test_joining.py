"""A robot that joins is placed where the whole log would have placed it."""

import json
import tempfile
from pathlib import Path

import numpy as np
import pytest

import tiswarm
from tiswarm.base.errors import InputError
from tiswarm.compute import backend
from tiswarm.localization.peers.settings import LeastSquaresParams
from tiswarm.localization.settings import BackPropagation, VirtualForceParams
from tiswarm.records.sensing_file import write_sensing_log
from tiswarm.sensing import SensingParams, observe

SETTINGS = {"iterations": 60, "initial_offset_axis": "body"}


@pytest.fixture(scope="module")
def lines(towers):
    """Header and robots of a tower's sensing file, as text."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "sensing.jsonl"
        write_sensing_log(observe(towers[0], SensingParams(tilt_noise_deg=1.0)), path)
        header, *robots = path.read_text().splitlines()
    keys = json.loads(header)
    del keys["lines"]  # as robots write it that have yet to join
    return [json.dumps(keys), *robots]


@pytest.mark.filterwarnings("ignore:.*converged")
def test_joining_one_by_one_gives_the_bytes_of_the_whole_log(lines, tmp_path):
    """Online and offline are one code path, whether lines come as text or as mappings."""
    path = tmp_path / "sensing.jsonl"
    path.write_text("\n".join(lines))
    whole = tiswarm.localize(path, "virtual-force", **SETTINGS)

    localizer = tiswarm.Localizer(lines[0], VirtualForceParams(**SETTINGS), capacity=40)
    joined = [localizer.join(line) for line in lines[1:10]]
    joined += [localizer.join(json.loads(line)) for line in lines[10:]]

    assert np.array(joined).tobytes() == whole.position.tobytes()
    assert localizer.positions.tobytes() == whole.position.tobytes()
    again = tiswarm.localize(localizer.log, "virtual-force", **SETTINGS)
    assert again.position.tobytes() == whole.position.tobytes()


def test_a_robot_that_is_refused_leaves_no_trace(lines):
    """After a bad line the right one can follow, and all is as if nothing had happened."""
    localizer = tiswarm.Localizer(lines[0], VirtualForceParams(**SETTINGS))
    for line in lines[1:5]:
        localizer.join(line)
    bad = json.loads(lines[5])
    bad["stances"][0]["pivot_dock"] = 7

    with pytest.raises(InputError, match=r"stances\[0\].pivot_dock: there is no dock 7"):
        localizer.join(bad)
    place = localizer.join(lines[5])

    other = tiswarm.Localizer(lines[0], VirtualForceParams(**SETTINGS))
    assert place.tobytes() == [other.join(line) for line in lines[1:6]][-1].tobytes()


def test_what_cannot_join_is_told(lines):
    """Methods that move robots again, and more robots than there is room for, are refused."""
    with pytest.raises(InputError, match="least-squares needs the log of all robots"):
        tiswarm.Localizer(lines[0], LeastSquaresParams())
    with pytest.raises(InputError, match="back_propagation moves robots"):
        tiswarm.Localizer(lines[0], VirtualForceParams(back_propagation=BackPropagation()))
    with pytest.raises(InputError, match="together moves all robots at once"):
        tiswarm.Localizer(lines[0], VirtualForceParams(schedule="together"))
    full = tiswarm.Localizer(lines[0], capacity=1)
    full.join(lines[1])
    with pytest.raises(InputError, match="capacity is 1 robot;"):
        full.join(lines[2])


@pytest.mark.parametrize(
    "method", ["virtual-force", "least-squares", "joint", "hop-by-hop", "online", "distributed"]
)
def test_an_anchor_alone_is_where_it_is(lines, tmp_path, method):
    """The first line of a log that robots have yet to join is a log."""
    path = tmp_path / "sensing.jsonl"
    path.write_text("\n".join(lines[:2]))

    estimate = tiswarm.localize(path, method)

    anchor = json.loads(lines[0])["anchor_position"]
    np.testing.assert_allclose(estimate.position, [anchor], rtol=0.0, atol=1e-12)
    assert estimate.sd is None or estimate.sd.tolist() == [0.0]


def test_python_callers_choose_method_cues_and_settings(lines, tmp_path):
    """What the command line takes, `tiswarm.localize` takes, and refuses the same."""
    path = tmp_path / "sensing.jsonl"
    path.write_text("\n".join(lines[:12]))
    log = tiswarm.read_log(path)

    estimate = tiswarm.localize(log, "least-squares", cues=["contacts", "height"], rounds=1)

    assert estimate.observability.cues == ("contacts", "height")
    assert len(estimate.iteration) == 2
    for call, message in (
        ({"method": "guess"}, "method: "),
        ({"chainz": 3}, "chainz: unknown key; did you mean chains"),
        ({"method": "least-squares", "cues": ["smell"]}, "cues: smell is not a cue"),
        ({"chains": -1}, "chains: -1 should be greater"),
        ({"method": "jint"}, "method: .*; did you mean joint"),
        ({"method": "virtual-force", "seed": 1}, "seed: unknown key of virtual-force; leave it"),
        (
            {"method": "virtual-force", "cues": ["contacts"]},
            "cues: virtual-force has no choice of cues but its settings z_correction, ",
        ),
        (
            {"method": "hop-by-hop", "cues": ["contacts", "touches"]},
            "cues: hop-by-hop cannot use touches; choose method joint",
        ),
        (
            {"method": "hop-by-hop", "cues": {"touches": True}},
            "cues.touches: true should be false with hop-by-hop; leave it out, or choose method j",
        ),
        ({"cues": {"hieght": False}}, "cues.hieght: unknown key; did you mean height"),
        ({"cues": {"height": 0}}, "cues.height: 0 should be true or false"),
        ({"height": False}, "height: the key is now cues.height; write cues.height: false"),
        (
            {"method": "virtual-force", "cues": {"height": False}},
            "cues: unknown key of virtual-force; leave it out, or choose method distributed or ",
        ),
        ({"method": "hop-by-hop", "order": "hps"}, "order: .*; did you mean hops"),
    ):
        with pytest.raises(InputError, match=message):
            tiswarm.localize(log, **call)
    assert backend.current().precision == "f64"
