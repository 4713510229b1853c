"""Tables of orientations count what their page says."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from benchmarks.orientations import _down, angles, fitted, lattice, names, slipped


def test_an_arm_comes_down_where_its_end_is_level_again():
    """Heights are sampled along the turn: the end sinks through the height of its pivot."""
    rng = np.random.default_rng(3)
    for _ in range(50):
        arm, axis = rng.normal(size=3), rng.normal(size=3)
        axis /= np.linalg.norm(axis)

        height = [Rotation.from_rotvec(t * axis).apply(arm)[2] for t in np.linspace(0, 6.28, 629)]

        sinks = [0.01 * k for k in range(6, 622) if height[k] > 0 >= height[k + 1]]
        found = sorted(t for t in _down(arm, axis) if 0.08 < t < 6.2)
        np.testing.assert_allclose(found, [t for t in sinks if t > 0.08], atol=0.011)


@pytest.mark.trial
def test_tables_of_one_structure():
    """Fits err less in yaw than sensors, random turns at each flip undo that, few slots confuse."""
    counted = [*angles(1)]
    assert all(row["angles"] <= row["flips"] for row in counted)

    assert all(row["fitted yaw [deg]"] < 0.8 * row["sensed yaw [deg]"] for row in fitted(1))

    kept = {
        row["by, 1 sd [deg]"]: row["kept [%]"]
        for row in slipped(1)
        if row["turned at"] == "each flip"
    }
    assert kept[0.0] < 10
    assert kept[4.0] > 50

    assert {row["robots"] for row in names(1)} == {25, 50, 100, 200}
    assert next(lattice(1))["orientations"] == 16
