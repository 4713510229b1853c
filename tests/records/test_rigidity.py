"""The count of floppy modes is what moving the robots shows."""

import numpy as np

from tiswarm.compute.rotations import dock_offsets
from tiswarm.records.rigidity import floppy_modes, rigidity_matrix
from tiswarm.sensing import SensingParams, observe


def _gaps(position, log):
    """Every distance of docks in contact, and every height that is known."""
    dock = position[:, None] + dock_offsets(log.orientation_wxyz, log.dock_offset_body)
    i, a, j, b = log.contacts.T
    ground, own = log.ground_docks.T
    distance = np.linalg.norm(dock[i, a] - dock[j, b], axis=1)
    return np.r_[distance, dock[ground, own, 2], position[:, 2]]


def test_the_matrix_is_the_derivative_of_what_is_sensed(towers):
    """Central differences of the sensed quantities give the same numbers."""
    log = observe(towers[0], SensingParams())
    position = towers[0].position
    matrix = rigidity_matrix(position, log, height_known=True)
    rng = np.random.default_rng(0)

    for _ in range(5):
        motion = rng.normal(size=position.shape)
        motion[0] = 0.0
        step = 1e-6 * motion
        slope = (_gaps(position + step, log) - _gaps(position - step, log)) / 2e-6
        np.testing.assert_allclose(matrix @ motion[1:].ravel(), slope, atol=1e-6)


def test_heights_leave_fewer_motions(towers):
    """Each known height can only take freedom away; more robots than equations leave some."""
    log = observe(towers[0], SensingParams())
    position = towers[0].position

    without = floppy_modes(position, log, height_known=False)
    with_height = floppy_modes(position, log, height_known=True)

    unknowns = 3 * (log.robot_count - 1)
    assert 0 <= with_height < without
    assert without >= unknowns - len(log.contacts) - len(log.ground_docks)
