"""Robots build by what the method of their case estimates as they join."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from tests.runs import REPOSITORY
from tests.world.test_beliefs import same
from tiswarm import study
from tiswarm.base.progress import Progress
from tiswarm.localization.methods import joining, localize
from tiswarm.parts import navigation
from tiswarm.scenario.expansion import load_scenario, variants
from tiswarm.sensing import observe
from tiswarm.world.growth import grow

SETS = ["robots=10", "seeds=2", "sensing.tilt_noise_deg=1"]
BY_ESTIMATE = "structure.navigate_by=estimate"
BOTH = [
    "sweep={structure.navigate_by: [truth, estimate]}",
    "conditions={once: {}, back: {localization.back_propagation: {every: 5}}}",
]


def _loaded(*sets):
    return load_scenario(REPOSITORY / "tests" / "tower.yaml", [*SETS, *sets])


def _run(folder, *sets) -> Path:
    return study.run(_loaded(*sets), folder, progress=Progress()).folder


@pytest.fixture(scope="module")
def built(tmp_path_factory) -> Path:
    """A run whose robots know the truth or go by either of two ways to localize."""
    return _run(tmp_path_factory.mktemp("loop"), *BOTH)


def test_each_condition_builds_structures_of_its_own(built):
    """By the truth, conditions share their structures; by estimates, no two have the same."""
    cases = pd.read_csv(built / "summary.csv")
    truth = cases["structure.navigate_by"] == "truth"

    assert cases.loc[truth].groupby("seed")["rms_radius_R"].nunique().tolist() == [1, 1]
    assert cases.loc[~truth].groupby("seed")["rms_radius_R"].nunique().tolist() == [2, 2]
    assert cases.loc[truth, "flips_as_planned"].isna().all()
    assert cases.loc[~truth, "flips_as_planned"].between(0.2, 0.999).all()


def test_conditions_that_built_different_structures_are_not_paired(built):
    """Differences on the same structures are those of robots that know the truth."""
    pairs = pd.read_csv(built / "paired.csv")

    assert set(pairs["structure.navigate_by"]) == {"truth"}


def _believed(settings, *, robots):
    """Structures of a growth, each with where its docks are believed [R]."""
    believe, found = navigation.believe_by(settings), []

    def spy(grown):
        docks = believe(grown)
        found.extend(zip(grown, docks, strict=True))
        return docks

    grow(settings.structure, robots=robots, seeds=[4], robot=settings.robot, believe=spy)
    return found


def test_robots_go_by_what_the_log_of_those_before_them_localizes_to():
    """Beliefs are the estimates of the method, on what a structure's robots sensed by then."""
    settings = variants(_loaded(BY_ESTIMATE))[0].settings

    believed = _believed(settings, robots=9)

    assert [history.robot_count for history, _ in believed] == [*range(1, 10)]
    for history, docks in believed:
        log = observe(history, settings.sensing)
        center = docks.reshape(-1, 3, 3).mean(axis=1)  # docks are symmetric about it
        np.testing.assert_allclose(center, localize(log, settings.localization).position, atol=1e-9)


def test_each_side_of_a_gap_has_an_anchor_and_does_not_know_the_other_side():
    """The first robot of each side is where it is; others are where their own side puts them."""
    structure = "structure={kind: bridge, gap: 30, navigate_by: estimate}"

    history, docks = _believed(variants(_loaded(structure))[0].settings, robots=10)[-1]

    error = np.linalg.norm(docks.reshape(-1, 3, 3).mean(axis=1) - history.position, axis=1)
    side = history.position[:, 0] > 15.0
    assert 0 < side.sum() < 10
    assert error[np.flatnonzero(side)[0]] < 1e-9
    assert error[np.flatnonzero(~side)[0]] < 1e-9
    assert error.max() < 8.0  # of 30 R and more if both took their place from one anchor


def test_methods_that_place_robots_as_they_join_build_what_whole_logs_do(monkeypatch):
    """Placed one by one or localized anew after each join, robots are believed at one place."""
    settings = variants(_loaded(BY_ESTIMATE))[0].settings
    assert joining(settings.localization)

    def built():
        return grow(
            settings.structure, robots=10, seeds=[1], robot=settings.robot,
            believe=navigation.believe_by(settings),
        )[0]  # fmt: skip

    one_by_one = built()
    monkeypatch.setattr(navigation.methods, "joining", lambda _: None)
    anew = built()

    assert all(same(a, b) for a, b in zip(one_by_one.walks, anew.walks, strict=True))
