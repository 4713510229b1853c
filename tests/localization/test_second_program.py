"""A second program, written from the paper's text alone, places each robot at the same point."""

from dataclasses import replace

import numpy as np
import pytest

from tests import oracle_algorithm_1
from tests.oracle_algorithm_1 import Gains
from tests.runs import REPOSITORY
from tiswarm.localization.methods import localize_many
from tiswarm.scenario.expansion import load_scenario, variants
from tiswarm.sensing import SensingParams, observe
from tiswarm.world.growth import grow

CONDITIONS = ["all-cues", "no-z", "no-z-no-undock"]
EQUAL = 1e-6
"""Allowed difference [R]. Sums are rounded in another order, and stable gains let 1e-15 grow to
some 1e-12. A misfit that close to the stop would cost one program a step more."""


def stable(condition):
    """Settings of a condition of the paper's table, with stable gains."""
    experiments = load_scenario(REPOSITORY / "scenarios" / "paper-experiments.yaml")
    gains = next(v for v in variants(experiments) if v.condition == "stable")
    paper = load_scenario(REPOSITORY / "scenarios" / "paper.yaml")
    params = next(v for v in variants(paper) if v.condition == condition).settings.localization
    names = (
        "attraction_gain", "repulsion_gain", "height_gain", "initial_offset", "max_step",
        "iterations",
    )  # fmt: skip
    shipped = gains.settings.localization
    return replace(params, **{name: getattr(shipped, name) for name in names})


def placed(log, params):
    """What the second program makes of a log under the same settings."""
    assert params.max_step > 1e6  # a cap is no part of the paper
    gains = Gains(
        params.attraction_gain, params.repulsion_gain, params.height_gain, params.initial_offset,
        params.iterations, params.stop_error,
    )  # fmt: skip
    return oracle_algorithm_1.localize(
        log, gains, z_cue=params.z_correction, undocked_repulsion=params.undocked_repulsion
    )


def farthest(logs, condition):
    """Largest distance of a robot from where the second program puts it, for each log [R]."""
    params = stable(condition)
    estimates = localize_many(logs, [params] * len(logs))
    return [
        np.abs(estimate.position - placed(log, params)).max()
        for log, estimate in zip(logs, estimates, strict=True)
    ]


@pytest.mark.parametrize("condition", CONDITIONS)
def test_two_programs_place_every_robot_of_a_small_structure_alike(towers, condition):
    """With stable gains single structures can be compared, not means alone."""
    logs = [observe(tower, SensingParams()) for tower in towers[:2]]

    assert max(farthest(logs, condition)) < EQUAL


@pytest.mark.slow
@pytest.mark.parametrize("condition", CONDITIONS)
@pytest.mark.parametrize("kind", ["tower", "cantilever"])
def test_two_programs_place_every_robot_of_the_paper_alike(kind, condition):
    """All estimates of 20 structures of 100 robots under the three conditions are the same."""
    paper = load_scenario(REPOSITORY / "scenarios" / "paper.yaml")
    settings = next(v.settings for v in variants(paper) if v.settings.structure.kind == kind)
    grown = grow(settings.structure, robots=100, seeds=range(10), robot=settings.robot)

    found = farthest([observe(history, settings.sensing) for history in grown], condition)

    assert max(found) < EQUAL
