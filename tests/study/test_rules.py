"""Studies of rules whose robots speak and leave: tables of messages and departures."""

import warnings
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest

import tiswarm
from tiswarm.base import plugins
from tiswarm.study.tables import profiles
from tiswarm.world.history_file import from_arrays, to_arrays

RULE = '''
import numpy as np
import tiswarm


@tiswarm.rule("brief", local=True)
class Brief:
    """Say how old one is; leave at an age, or never."""

    age: int = 3
    message = 2
    rounds_after = 8

    def choose(self, step):
        return tiswarm.reactive_build(step)

    def act(self, members):
        members.say[:] = members.age[:, None, None]
        return members.age >= self.age
'''


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """Run in which the robots of one point leave, and those of the other stay."""
    folder = tmp_path_factory.mktemp("rules")
    file = folder / "brief.py"
    file.write_text(RULE)
    scenario = {
        "name": "brief",
        "robots": 8,
        "seeds": 2,
        "structure": {"kind": "tower", "rule": "brief"},
        "localization": {"method": "distributed", "chains": 0},
        "sweep": {"structure.rule.age": [4, 1000]},
    }
    with warnings.catch_warnings():
        warnings.simplefilter("error", FutureWarning)
        result = tiswarm.run(
            scenario, out=folder / "runs", plugins=[file], pictures=False, quiet=True
        )
    yield result
    plugins.forget()


def test_a_run_counts_the_bytes_of_the_messages_of_its_rule(run):
    """They are beside those of localization, in the summary, the table and for each robot."""
    summary = run.summary

    robots = pd.read_csv(run.folder / "cases" / summary["case"][0] / "robots.csv")
    assert summary["rule_sent_B"][0] == pytest.approx(robots["rule_sent_B"].mean())
    assert summary["worst_rule_sent_B"][0] == robots["rule_sent_B"].max() > 0
    assert not np.array_equal(robots["rule_sent_B"], robots["sent_B"])
    table = pd.read_csv(run.folder / "table.csv")
    assert (table["rule_sent_B_mean"] > 0.0).all()


def test_where_robots_may_leave_a_structure_that_keeps_all_has_lost_none(run):
    """Zero, not unknown, so that means are over all structures."""
    stays = run.summary[run.summary["structure.rule.age"] == 1000]

    assert (stays[["left", "fell", "died"]] == 0).all(axis=None)


def test_departures_have_their_rounds_also_after_growth(run):
    """Robots that leave at an age leave that many rounds after they joined."""
    leaves = run.summary[run.summary["structure.rule.age"] == 4].iloc[0]
    robots = pd.read_csv(run.folder / "cases" / leaves["case"] / "robots.csv")

    [swarm] = tiswarm.grow("tower", robots=8, seeds=1, rule={"name": "brief", "age": 4}, quiet=True)

    left = np.flatnonzero(swarm.departures[:, 2] == 0)
    leavers = swarm.departures[left, 0]
    assert (swarm.leave_round[leavers] - swarm.join_round[leavers] >= 4).all()
    assert swarm.leave_round.max() > swarm.join_round.max()
    assert robots["lost_round"].dropna().tolist() == swarm.leave_round[swarm.is_gone].tolist()
    kept = from_arrays(to_arrays(swarm), swarm.scenario.structure, swarm.scenario.robot)
    assert kept.leave_round.tolist() == swarm.leave_round.tolist()


def test_bytes_of_robots_that_did_not_join_are_zero():
    """Sums over a batch count what robots sent."""
    growth = tiswarm.Growth({"kind": "tower", "rule": "brief"}, robots=6, seeds=1)
    while growth.robot_count[0] < 3:
        growth.step(tiswarm.reactive_build(growth.observe()))

    sent = growth.swarms().sent

    assert sent.min() == 0
    assert sent[0, 3:].sum() == 0


@pytest.mark.filterwarnings("error")
def test_profiles_take_structures_of_one_robot(tmp_path):
    """A table without pairs counts nothing, and warns of nothing."""
    robots = "z_R,error_R,hops_from_anchor,contacts,lost\n1.0,0.5,0,0,\n3.0,0.5,1,0,left\n"
    columns = "hops_apart,pairs,mean_error_R,rmse_R\n"
    for case, rows in (("1-a", "1,3,0.5,0.6\n"), ("2-a", "")):
        folder = tmp_path / case
        folder.mkdir()
        (folder / "robots.csv").write_text(robots)
        (folder / "relative.csv").write_text(columns + rows)
    shared = {"is_done": True, "series": "a", "condition": "a", "point_cells": {}}
    records = [SimpleNamespace(case=case, **shared) for case in ("1-a", "2-a")]

    table = profiles(records, tmp_path)

    [pairs] = table[table["by"] == "hops_apart"].to_dict("records")
    assert (pairs["count"], pairs["rmse_R"]) == (3, pytest.approx(0.6))
