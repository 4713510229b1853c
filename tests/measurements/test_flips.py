"""Orientations that fit a robot's own flips: axes, the fit beside a slow one, its limits."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

import tiswarm
from tests.structures import NOISY, grown
from tiswarm.base.robot import SHAPES, RobotGeometry
from tiswarm.measurements.flips import fit_orientations, flip_axes
from tiswarm.records.sensing_log import SensingNoise
from tiswarm.sensing import SensingParams, observe
from tiswarm.world.growth import grow
from tiswarm.world.params import CantileverParams, ClimbParams, TowerParams

EXACT = SensingParams()


def turns(wxyz):
    """Rotations of quaternions."""
    return Rotation.from_quat(wxyz, scalar_first=True)


def errors(log, history):
    """Turns from true to logged final orientations [deg], shape (N, 3)."""
    found = turns(log.orientation_wxyz) * turns(history.orientation_wxyz).inv()
    return np.degrees(found.as_rotvec())


def rms(errors):
    """Root mean square of tilt and yaw [deg]."""
    return np.sqrt([(errors[:, :2] ** 2).mean(), (errors[:, 2] ** 2).mean()])


@pytest.mark.parametrize("shape", SHAPES)
def test_robots_flip_about_the_listed_axes(shape):
    """An axis of the pivot dock points the same way before and after each flip."""
    robot = RobotGeometry(shape=shape, rho=2.0)
    rule = CantileverParams(climb=ClimbParams(twists=6))
    [history] = grow(rule, robots=4, seeds=[3], robot=robot)
    axes = flip_axes(robot.dock_offset_body, 6)

    assert sum(len(walk.pivot_dock) for walk in history.walks) > 0
    for walk in history.walks:
        turn = turns(walk.orientation_wxyz)
        for k, dock in enumerate(walk.pivot_dock):
            moved = turn[k + 1].apply(axes[dock]) - turn[k].apply(axes[dock])
            assert np.linalg.norm(moved, axis=1).min() < 1e-7
    arm = robot.dock_offset_body[:, None]
    np.testing.assert_allclose((axes * arm).sum(axis=2), 0.0, atol=1e-12)
    np.testing.assert_allclose(np.linalg.norm(axes, axis=2), 1.0, atol=1e-12)


def test_exact_orientations_stay(towers):
    """Without noise there is nothing to fit."""
    log = observe(towers[0], EXACT)

    found = fit_orientations(log, 6)

    off = turns(found.orientation_wxyz) * turns(log.orientation_wxyz).inv()
    assert off.magnitude().max() < 1e-4
    assert (found.noise.tilt_deg, found.noise.yaw_deg) == (0.0, 0.0)


def test_errors_fall_as_the_log_states(towers):
    """What the log then states is what orientations err by."""
    found = [fit_orientations(observe(history, NOISY), 6) for history in towers]
    error = np.concatenate([errors(*pair) for pair in zip(found, towers, strict=True)])
    stated = np.mean([[log.noise.tilt_deg, log.noise.yaw_deg] for log in found], axis=0)

    # Errors of some 100 robots: four standard errors of a standard deviation are 30 %.
    assert (rms(error) / stated < 1.3).all()
    assert (rms(error) / stated > 0.7).all()
    assert (stated < [0.9, 1.6]).all()


def slowly(sensed, pivot, ground, body, axes, sd):
    """Minimize the sum of squares of one walk over all turns, with numerical derivatives.

    The axis of a flip is the one whose two directions, as sensed, are nearest.
    """
    chosen = []
    for k, dock in enumerate(pivot):
        gap = [np.linalg.norm(sensed[k].apply(a) - sensed[k + 1].apply(a)) for a in axes[dock]]
        chosen.append(axes[dock][int(np.argmin(gap))])

    def residual(x):
        found = [Rotation.from_rotvec(e) * s for e, s in zip(x.reshape(-1, 3), sensed, strict=True)]
        rows = [(s * f.inv()).as_rotvec() / sd for s, f in zip(sensed, found, strict=True)]
        for k, axis in enumerate(chosen):
            rows.append((found[k + 1].apply(axis) - found[k].apply(axis)) / 1e-3)
        for f, docks in zip(found, ground, strict=True):
            height = f.apply(body[docks])[:, 2] if docks else np.empty(0)
            rows.append((height - height.mean() if docks else height) / 0.01)
        return np.concatenate(rows)

    best = least_squares(residual, np.zeros(3 * len(sensed)), xtol=1e-12, ftol=1e-12)
    return [Rotation.from_rotvec(e) * s for e, s in zip(best.x.reshape(-1, 3), sensed, strict=True)]


def test_the_fit_is_the_least_sum_of_squares(towers):
    """A general solver with numerical derivatives finds the same orientations."""
    history, sd = towers[0], np.radians([1.0, 1.0, 2.0])
    log = observe(history, NOISY)
    found = fit_orientations(log, 6)
    axes, start = flip_axes(log.dock_offset_body, 6), log.stances.start
    walked = [i for i in range(log.robot_count) if 2 <= start[i + 1] - start[i] <= 6][:3]

    assert walked
    for i in walked:
        rows = range(start[i], start[i + 1])
        sensed = [*turns(log.stances.orientation_wxyz[rows]), turns(log.orientation_wxyz[i])]
        at = log.stances.ground_docks
        ground = [at[at[:, 0] == k, 1].tolist() for k in rows]
        ground.append(log.ground_docks[log.ground_docks[:, 0] == i, 1].tolist())
        expected = slowly(
            sensed, log.stances.pivot_dock[rows], ground, log.dock_offset_body, axes, sd
        )
        ours = [*turns(found.stances.orientation_wxyz[rows]), turns(found.orientation_wxyz[i])]
        off = [(a * b.inv()).magnitude() for a, b in zip(ours, expected, strict=True)]
        assert max(off) < 2e-4


@settings(max_examples=10, deadline=None)
@given(angle=st.floats(-3.0, 3.0))
def test_a_turn_about_the_vertical_turns_the_fit(towers, angle):
    """No flip says where north is."""
    log, turn = observe(towers[0], NOISY), Rotation.from_euler("z", angle)

    def turned(log):
        final, earlier = log.orientation_wxyz, log.stances.orientation_wxyz
        final, earlier = ((turn * turns(q)).as_quat(scalar_first=True) for q in (final, earlier))
        stances = replace(log.stances, orientation_wxyz=earlier)
        return replace(log, orientation_wxyz=final, stances=stances)

    one, other = turned(fit_orientations(log, 6)), fit_orientations(turned(log), 6)

    off = turns(one.orientation_wxyz) * turns(other.orientation_wxyz).inv()
    assert off.magnitude().max() < 1e-6


def test_robots_keep_what_no_flip_explains(towers):
    """Sensors that are stuck repeat their value, and walks without any of the axes stay."""
    stuck = observe(towers[0], replace(NOISY, stuck=1.0))
    log = observe(towers[0], NOISY)
    rng = np.random.default_rng(0)
    walked = np.flatnonzero(np.diff(log.stances.start) > 0)[1:]
    wild = Rotation.random(len(log.stances.pivot_dock), rng=rng).as_quat(scalar_first=True)
    other = replace(log, stances=replace(log.stances, orientation_wxyz=wild))

    assert (fit_orientations(stuck, 6).orientation_wxyz[1:] == stuck.orientation_wxyz[1:]).all()
    found = fit_orientations(other, 1)
    kept = (turns(found.orientation_wxyz) * turns(other.orientation_wxyz).inv()).magnitude()
    assert np.median(kept[walked]) < 1e-6


def test_a_log_without_stances_or_noise(towers):
    """Level docks are all that is left; noise that a log does not state is the usual one."""
    log = observe(towers[0], replace(NOISY, stances=False))

    found = fit_orientations(replace(log, noise=None), 6)

    up = turns(found.orientation_wxyz[:1]).apply([0.0, 0.0, 1.0])[0]
    sensed = turns(log.orientation_wxyz[:1]).apply([0.0, 0.0, 1.0])[0]
    assert found.stances is None
    assert isinstance(found.noise, SensingNoise)
    assert np.hypot(*up[:2]) <= np.hypot(*sensed[:2])


@pytest.mark.parametrize(("method", "axes"), [("joint", 0), ("joint", 65), ("online", 6)])
def test_settings_without_meaning_are_refused(tmp_path, method, axes):
    """A tracker takes robots line by line, and a dock has some axes."""
    text = "name: own\nrobots: 3\nstructure: {kind: tower}\nlocalization:\n"
    text += f"  method: {method}\n"
    (tmp_path / "own.yaml").write_text(f"{text}  flip_axes: {axes}\n")

    [mistake] = tiswarm.check(tmp_path / "own.yaml").mistakes

    assert "own.yaml:6" in str(mistake)
    assert "flip_axes" in str(mistake)


@pytest.mark.filterwarnings("ignore::tiswarm.base.errors.ResultWarning")
def test_methods_localize_by_the_fit():
    """The door to all methods fits orientations first."""
    history = grown(TowerParams(), robots=8, seed=101)
    log = observe(history, NOISY)

    found = tiswarm.localize(log, method="hop-by-hop", flip_axes=6)

    expected = tiswarm.localize(fit_orientations(log, 6), method="hop-by-hop")
    assert (found.position == expected.position).all()
    assert (found.position != tiswarm.localize(log, method="hop-by-hop").position).any()
