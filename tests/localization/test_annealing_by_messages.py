"""Robots that anneal at once step by what they heard last, and nothing else."""

import json
from dataclasses import replace

import numpy as np
import pytest

from tests.structures import NOISY
from tiswarm.localization.distributed.chain_kernels import ChainDocks, ChainRows
from tiswarm.localization.distributed.heard_kernels import SENT, TIME, Hearing, step_as_heard
from tiswarm.localization.params import DistributedParams
from tiswarm.localization.registry import localize_many
from tiswarm.records.sensing_file import write_sensing_log
from tiswarm.sensing import observe

QUICK = DistributedParams(scheme="annealing", channel="radio", steps=60)
DOCKS = 1.2 * np.array([[1.0, 0.0, 0.0], [-0.5, 0.8, 0.0], [-0.5, -0.8, 0.0]])
REACH = 2.0 * 1.2 + 2.0


@pytest.fixture(scope="module")
def log(towers):
    """Log of a noisy tower."""
    return observe(towers[0], NOISY)


class _Robots:
    """Three robots: 0 and 1 share a row and touch, 2 has a height and overlaps."""

    def __init__(self, rounds=3):
        self.rows = ChainRows(
            np.array([0, 1, 2, 3], np.int32),
            np.array([1, 0, -1], np.int32),
            np.array([[0.3, 0.1, 0.0], [-0.3, -0.1, 0.0], [0.0, 0.0, 0.0]]),
            np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 0.0], [0.0, 0.0, 1.0]]),
            np.array([[2.0, 0.02, 0.75], [2.0, 0.02, 0.75], [1.0, 0.05, 0.0]]),
        )
        self.docks = ChainDocks(
            np.tile(DOCKS, (3, 1, 1)),
            np.array([0, 1, 2, 2], np.int32),
            np.array([[0, 1, 1], [1, 0, 0]], np.int32),
        )
        self.place = np.array([[0.0, 0.0, 0.0], [2.5, 0.4, 0.2], [1.2, 2.0, 0.6]])
        self.view = np.tile(self.place, (3, 1, 1))
        self.hops = (1 - np.eye(3)).astype(np.int32)
        self.sent = np.zeros((rounds, 3, SENT))
        self.speed, self.total = np.zeros((3, 3)), np.zeros((3, 3))

    def step(self, t, *, sigma=0.0, loss=0.0, delay=0, bits=0):
        step_as_heard(
            5, t, 1, sigma, 0.8, REACH, loss, delay, bits, *self.rows, *self.docks,
            *Hearing(self.hops, self.sent, self.view), self.place, self.speed, self.total,
        )  # fmt: skip


def _force(robots, i, sigma):
    """Write the force on a robot out, row by row and dock by dock, and the mass that it needs."""
    force, held, here, view = np.zeros(3), 0.0, robots.place[i].copy(), robots.view[i]
    rows = robots.rows
    for e in range(rows.start[i], rows.start[i + 1]):
        j, (length, variance, share) = rows.partner[e], rows.value[e]
        between = here - view[j] if j >= 0 else np.zeros(3)
        apart = between + rows.arm[e] if j >= 0 else here
        way = rows.axis[e] if rows.axis[e].any() else apart / np.linalg.norm(apart)
        missed = way @ apart - length
        stiff = sigma**2 / (sigma**2 + variance + missed**2 / 9.0)
        push = stiff * sigma**2 * share / max(np.linalg.norm(between), 1.0)
        force += push * between - stiff * missed * way
        held += stiff
    touching = {tuple(row) for row in robots.docks.contact[slice(*robots.docks.start[i : i + 2])]}
    for j in {0, 1, 2} - {i}:
        for k, own in enumerate(DOCKS):
            for m, its in enumerate(DOCKS):
                apart = here + own - view[j] - its
                if apart @ apart < 4.0 and (k, j, m) not in touching:
                    force += 0.5 * (1.0 - apart @ apart / 4.0) * apart
                    held += 1.0
    return force, max(1.0, held / 1.2)


@pytest.mark.parametrize("sigma", [0.05, 0.5])
def test_a_step_is_that_of_the_equations(sigma):
    """Without losses: forces from what was heard, friction, and kicks of the temperature."""
    robots, cold = _Robots(), _Robots()
    expected = [_force(robots, i, sigma) for i in range(3)]
    before = robots.place.copy()

    robots.step(0, sigma=sigma)

    assert robots.place[0].tolist() == [0.0, 0.0, 0.0]
    assert expected[2][1] > 1.0  # an overlap is stiff
    for i in (1, 2):
        force, mass = expected[i]
        kick = (robots.speed[i] - 0.8 * force / mass) / (sigma * np.sqrt(0.36 / mass))
        assert np.abs(kick).max() <= np.sqrt(3.0)
        moved = 0.5 * (force / mass + robots.speed[i])
        np.testing.assert_allclose(robots.place[i] - before[i], moved, atol=1e-12)
    np.testing.assert_array_equal(robots.sent[0, :, :TIME], robots.place)
    np.testing.assert_array_equal(robots.total, robots.place)
    # At no temperature rows have no stiffness, and overlaps alone move robots.
    force, mass = _force(cold, 1, 0.0)
    cold.step(0)
    np.testing.assert_allclose(cold.speed[1], 0.8 * force / mass, atol=1e-12)


@pytest.mark.parametrize("delay", [0, 2])
def test_robots_hear_what_arrived_before_they_step(delay):
    """A position of round s arrives in round s + 1 + delay, at the time at which it was sent."""
    robots = _Robots(rounds=4 + delay)
    history, times = [], []
    begin = robots.view[0].copy()
    for t in range(6):
        robots.step(t, sigma=0.3, delay=delay)
        history.append(robots.sent[t % len(robots.sent), :, :TIME].copy())
        times.append(robots.sent[t % len(robots.sent), :, TIME].copy())

        for i in range(3):
            for j in {0, 1, 2} - {i}:
                sent = t - 1 - delay
                if sent >= 0 and times[sent][j] >= times[t][i]:
                    sent -= 1
                last = history[sent][j] if sent >= 0 else begin[j]
                np.testing.assert_array_equal(robots.view[i, j], last)


def test_who_misses_a_position_keeps_the_last_one():
    """About so many positions as are lost stay as they were."""
    robots, missed, rounds = _Robots(), 0, 400
    for t in range(rounds):
        before = robots.view.copy()
        robots.step(t, sigma=0.3, loss=0.4)
        missed += int((robots.view == before).all(axis=2)[~np.eye(3, dtype=bool)].sum())

    # A position may be heard twice, a tie of two rounds: then it stays as it was, too. The anchor
    # never moves.
    assert missed / (6 * rounds) > 0.4
    assert missed / (6 * rounds) < 0.85


def test_positions_are_sent_with_so_many_bits():
    """They are multiples of a step of the range; each robot keeps its own position exactly."""
    robots = _Robots()
    robots.step(0, sigma=0.3, bits=8)

    limit = 2.0 ** np.ceil(np.log2(np.maximum(np.abs(robots.place).max(axis=1), 1.0)))
    step = 2.0 * limit / 255.0
    error = np.abs(robots.sent[0, :, :TIME] - robots.place)
    assert (error <= 0.5 * step[:, None] * (1.0 + 1e-9)).all()
    assert error.max() > 0.0


@pytest.mark.parametrize("channel", ["radio", "touch"])
def test_losses_depend_on_the_seed(log, channel):
    """So do times and kicks: the same seed gives the same bytes, another one others."""
    params = replace(QUICK, channel=channel, loss=0.2, delay=1)

    one, again, other = (
        localize_many([log], [replace(params, seed=seed)])[0] for seed in (0, 0, 1)
    )

    assert one.position.tobytes() == again.position.tobytes()
    assert one.traffic["sent"].tobytes() == again.traffic["sent"].tobytes()
    assert one.position.tobytes() != other.position.tobytes()


def test_bytes_are_those_counted_by_hand(log):
    """A pose once, the rows of each pair once, and 11 bytes a round by radio."""
    [estimate] = localize_many([log], [QUICK])
    [longer] = localize_many([log], [replace(QUICK, steps=70)])

    traffic = estimate.traffic
    assert set(longer.traffic["sent"] - traffic["sent"]) == {10 * (4 + 7)}
    assert set(longer.traffic["rounds"] - traffic["rounds"]) == {10}
    # The anchor has no rows of its own; acknowledgments of 3 bytes are all that it adds.
    assert (traffic["sent"][0] - 60 * 11 - 17) % 3 == 0
    assert estimate.at_join is None
    assert not estimate.convergence.converged


def test_annealing_runs_by_command(log, tiswarm, tmp_path):
    """Robots of a file are placed, and settings of another scheme are refused in a line."""
    write_sensing_log(log, tmp_path / "sensing.jsonl")
    command = ["localize", tmp_path / "sensing.jsonl", "--method", "distributed"]
    scheme = ["--set", "scheme=annealing", "--set", "steps=60"]

    done = tiswarm(*command, *scheme, "--out", tmp_path / "found.csv")
    refused = tiswarm(*command, *scheme, "--set", "hops=3")

    assert done.returncode == 4, done.stderr  # it never converges
    assert len((tmp_path / "found.csv").read_text().splitlines()) == 1 + log.robot_count
    assert refused.returncode == 2
    assert "hops is of scheme joiner; remove it, or set scheme to joiner" in refused.stderr
    assert json.dumps(refused.stderr).count("error") == 1
