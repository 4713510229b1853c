"""Tables of a run beside published numbers."""

from dataclasses import replace

import numpy as np
import pytest

from tests.runs import REPOSITORY
from tiswarm import study
from tiswarm.scenario import load_scenario
from tiswarm.study import tables
from tiswarm.study.runner import failure


@pytest.mark.parametrize(
    ("changed", "published"),
    [
        ("description=the same", [1.64, 1.84, 2.36, 2.36, np.nan, 3.91, 5.26, 5.12, 5.12, np.nan]),
        ("structure.climb.settle=true", [1.64]),  # the paper leaves open how flips end
        ("robots=99", [np.nan]),
        ("structure.movers=2", [np.nan]),
        ("sensing.yaw_noise_deg=1", [np.nan]),
        ("localization.method=joint", [np.nan]),
    ],
)
def test_published_numbers_stand_beside_their_own_setting_only(changed, published):
    """Rows of the paper's settings have its numbers; rows of other settings have none."""
    only = () if len(published) > 1 else ("sweep={}", "conditions={baseline: {}}")
    paper = load_scenario(REPOSITORY / "scenarios" / "paper.yaml", ["seeds=1", *only, changed])
    cases = study.plan(paper)
    records = [replace(failure(case, ""), status="done", scores={"rmse_R": 3.0}) for case in cases]

    table = tables.table(records, [case.settings for case in cases])

    np.testing.assert_equal(table["paper_rmse_radii"].to_numpy(), published)
    np.testing.assert_allclose(table["rmse_R_to_paper"], 3.0 / np.array(published))
