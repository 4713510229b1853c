"""A cue is one function and one line; everything that takes cues uses it then."""

import numpy as np

from tests.structures import NOISY
from tiswarm.localization.methods import localize
from tiswarm.localization.peers.settings import LeastSquaresParams
from tiswarm.localization.settings import Cues, JointParams
from tiswarm.measurements import cues
from tiswarm.measurements.model import Coordinates
from tiswarm.measurements.observability import observability
from tiswarm.measurements.odometry import CENTER
from tiswarm.sensing import SensingParams, observe


def test_a_new_cue_serves_every_method_and_analysis(towers, monkeypatch):
    """Marks on a wall that every other robot sees say how far along x it is, to 0.05 R."""
    history = towers[0]
    log = observe(history, NOISY)
    params = JointParams(cues=Cues(walk_contacts=False, ground=False), steps=1500, chains=4)
    before = [localize(log, params), observability(log, params.used_cues)]

    def wall(centered, odometry, _precision):
        robot = np.arange(1, log.robot_count, 2)
        x = history.position[robot, 0] - log.anchor_position[0] + centered.anchor_position[0]
        dock = np.full(len(robot), CENTER)
        return Coordinates.of(odometry.final[robot], dock, np.eye(3)[0], x, variance=0.05**2)

    monkeypatch.setattr(cues, "CUES", [*cues.CUES, cues.Cue(name="wall", rows=wall)])

    after = [localize(log, params), observability(log, params.used_cues)]
    reference = localize(log, LeastSquaresParams())

    off = [np.abs(found[0].position - history.position)[:, 0].mean() for found in (before, after)]
    assert off[1] < 0.5 * off[0]
    assert after[0].sd.mean() < before[0].sd.mean()
    assert after[1].cues[-1] == "wall"
    assert after[1].floppy_modes < before[1].floppy_modes
    assert np.abs(reference.position - history.position)[1::2, 0].max() < 0.5


def test_a_dock_that_stays_put_counts_once(towers):
    """What it touches at two stances in a row is one measurement, of a contact or the ground."""
    log = observe(towers[0], SensingParams())
    rows = cues.measure(log, cues.cue_names())
    stances = log.stances

    touches = len(log.contacts) + len(stances.contacts)
    grounds = len(log.ground_docks) + len(stances.ground_docks)
    heights = np.isfinite(log.flip_height).sum()
    assert 0 < len(rows.neighbor) < touches
    assert 0 < len(rows.places.value) - heights < grounds
    assert len(np.unique(rows.sensed_contacts, axis=0)) == len(rows.neighbor)
