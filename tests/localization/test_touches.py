"""`joint` finds the docks of touches; other methods leave touches out."""

from dataclasses import replace

import numpy as np
import pydantic
import pytest

from tiswarm.base.robot import RobotGeometry
from tiswarm.evaluation.tables import outlier_scores
from tiswarm.localization.methods import localize, localize_many
from tiswarm.localization.peers.settings import HopByHopParams
from tiswarm.localization.settings import SWITCHES, Cues, CuesOfNamedDocks, JointParams
from tiswarm.measurements.cues import measure
from tiswarm.sensing import SensingParams, observe
from tiswarm.world.growth import grow
from tiswarm.world.params import TowerParams

QUICK = JointParams(chains=3, steps=800, hold_steps=200)
NOISE = {"tilt_noise_deg": 1.0, "yaw_noise_deg": 2.0}


def touched(history, docks="own"):
    """What robots sensed that do not know all docks."""
    return observe(history, SensingParams(contact_docks=docks, **NOISE))


@pytest.mark.parametrize("docks", ["own", "none"])
def test_touches_place_robots(docks):
    """Even in few steps, errors are less than half of those without touches, in the mean."""
    towers = grow(TowerParams(), robots=12, seeds=range(2, 8), robot=RobotGeometry())
    logs = [touched(history, docks) for history in towers]

    found = [localize(log, QUICK) for log in logs]
    without = localize_many(logs, [replace(QUICK, cues=Cues(touches=False))] * len(logs))

    error, unaided = (
        np.mean([
            np.median(np.linalg.norm(e.position - history.position, axis=1))
            for e, history in zip(estimates, towers, strict=True)
        ])
        for estimates in (found, without)
    )  # fmt: skip
    assert error < 0.5 * unaided
    for log, history, estimate in zip(logs, towers, found, strict=True):
        assert "touches" in estimate.observability.cues
        scores = outlier_scores(history, estimate, rows=measure(log, QUICK.used_cues))
        assert scores.get("wrong_contacts", 0) == 0  # touches are not scored


def test_logs_without_touches_do_not_notice_others(towers):
    """An estimate is the same beside logs with touches as alone, byte by byte."""
    plain = observe(towers[1], SensingParams(**NOISE))
    logs = [touched(towers[0]), plain, touched(towers[2])]

    together = localize_many(logs, [QUICK] * 3)
    alone = localize_many([plain], [QUICK])[0]
    again = localize_many(logs[2:], [QUICK])[0]

    assert together[1].position.tobytes() == alone.position.tobytes()
    assert together[1].sd.tobytes() == alone.sd.tobytes()
    assert together[2].position.tobytes() == again.position.tobytes()


def test_touches_are_ignored_where_they_are_switched_off(towers):
    """Then a log has the bytes of an estimate that it would have without them."""
    log = replace(touched(towers[0]), stances=None)
    without = replace(log, touches=log.touches[:0])

    off, none = (localize(one, replace(QUICK, cues=Cues(touches=False))) for one in (log, without))

    assert off.position.tobytes() == none.position.tobytes()


def test_hop_by_hop_takes_no_touches():
    """Robots would have to know the docks; its cues say so."""
    assert "touches" not in HopByHopParams().used_cues
    assert "touches" in SWITCHES
    with pytest.raises(pydantic.ValidationError, match="touches"):
        HopByHopParams(cues=CuesOfNamedDocks(touches=True))
