"""Formats of other programs are read back with their own libraries, or by their published rules."""

import json
import re
import sys
from dataclasses import fields, replace

import gsd.hoomd
import numpy as np
import pytest
import trimesh
from mcap.reader import make_reader
from scipy.spatial.transform import Rotation

from tests.recorder import Recorder
from tests.robustness.mutations import Random, damaged
from tests.structures import exact_estimate
from tiswarm.app.formats import export_view
from tiswarm.base.errors import EnvironmentTroubleError, InputError
from tiswarm.base.progress import Progress
from tiswarm.base.registry import BUILT_IN
from tiswarm.base.robot import RobotGeometry
from tiswarm.records.mcap import encode_messages
from tiswarm.records.sensing_file import read_sensing_log
from tiswarm.report.swarm_view import view_log
from tiswarm.sensing.observation import observe
from tiswarm.sensing.params import SensingParams


@pytest.fixture(scope="module")
def view(towers):
    """A tower of 30 robots in cm, its exact log, and an estimate that is 0.25 cm off."""
    log = observe(towers[0], SensingParams())
    true = towers[0].position
    estimate = exact_estimate(
        log, true + np.array([0.25, 0.0, 0.0]), sd=np.ones(30), trace=true[None]
    )
    return view_log(replace(log, length_unit="cm"), estimate, true)


@pytest.fixture(scope="module")
def exported(view, tmp_path_factory):
    """Folder with the view in the four formats."""
    out = tmp_path_factory.mktemp("foreign")
    for form in ("gsd", "mcap", "pyfg", "tum"):
        export_view(view, form, out, Progress())
    return out


def test_gsd_shows_the_growth(view, exported):
    """A frame for each join has the robots so far, their contacts as bonds and their errors."""
    with gsd.hoomd.open(exported / "structure.gsd") as file:
        frames = list(file)

    assert [frame.configuration.step for frame in frames] == list(range(1, 31))
    for count, frame in enumerate(frames, start=1):
        assert len(frame.particles.position) == count
        place = frame.particles.position + frame.log["origin"]
        np.testing.assert_allclose(place, view.pose[:count, :3], atol=1e-5)
        np.testing.assert_allclose(frame.particles.orientation, view.pose[:count, 3:], atol=1e-6)
        contacts = view.log.contacts[view.log.contacts[:, 2] < count]
        assert {*map(tuple, frame.bonds.group.tolist())} == {
            (i, j) for i, _, j, _ in contacts.tolist()
        }
        half = np.array(frame.configuration.box[:3]) / 2.0
        assert (np.abs(frame.particles.position) < half).all()
    np.testing.assert_allclose(frames[-1].log["particles/error"], 0.25, atol=1e-9)
    np.testing.assert_array_equal(frames[-1].log["particles/sd"], 1.0)
    np.testing.assert_array_equal(frames[-1].log["particles/robot"], view.robot)


def test_gsd_has_the_docks_of_a_robot(view, exported):
    """The shape is a union of the dock spheres in the body frame."""
    with gsd.hoomd.open(exported / "estimate.gsd") as file:
        (shape,) = file[-1].particles.type_shapes

    assert shape["type"] == "SphereUnion"
    assert shape["diameters"] == [2.0, 2.0, 2.0]
    np.testing.assert_allclose(shape["centers"], RobotGeometry().dock_offset_body)


@pytest.mark.parametrize(("form", "module"), [("gsd", "gsd.hoomd"), ("mcap", "mcap.writer")])
def test_a_format_without_its_library_says_what_to_install(
    view, tmp_path, monkeypatch, form, module
):
    """One line names the extra, and nothing is written."""
    monkeypatch.setitem(sys.modules, module, None)

    with pytest.raises(EnvironmentTroubleError, match=rf"pip install 'tiswarm\[{form}\]'"):
        export_view(view, form, tmp_path / "out", Progress())

    assert not (tmp_path / "out").exists()


def test_a_robot_without_a_pose_is_left_out(view, tmp_path):
    """No format gets a NaN; contacts of the robot go with it."""
    pose = view.estimated_pose.copy()
    pose[7] = np.nan
    some = replace(view, pose=np.full_like(pose, np.nan), estimated_pose=pose)

    for form in ("gltf", "gsd", "mcap", "mjcf", "ply", "pyfg", "tum", "wbt"):
        export_view(some, form, tmp_path, Progress())

    lines = trimesh.load(tmp_path / "case.glb").geometry["contacts"]
    assert len(lines.vertices) == 2 * (view.log.contacts[:, [0, 2]] != 7).all(axis=1).sum()
    for points in (lines.vertices, trimesh.load(tmp_path / "estimate.ply").vertices):
        assert np.isfinite(points).all()
    with gsd.hoomd.open(tmp_path / "estimate.gsd") as file:
        last = file[-1]
    assert last.particles.N == 29
    names = last.log["particles/robot"][last.bonds.group]
    contacts = view.log.contacts[(view.log.contacts[:, [0, 2]] != 7).all(axis=1)]
    np.testing.assert_array_equal(
        np.unique(names, axis=0), np.unique(view.robot[contacts[:, [0, 2]]], axis=0)
    )
    lines = (tmp_path / "case.pyfg").read_text().splitlines()
    assert not any("nan" in line or " A7 " in line or " L22 " in line for line in lines)
    assert len(np.loadtxt(tmp_path / "estimate.tum")) == 29
    assert [each["robot"] for _, each in _messages(tmp_path / "case.mcap", "estimate")] == [
        robot for robot in range(30) if robot != 7
    ]


@pytest.mark.parametrize("form", BUILT_IN["export_format"])
def test_a_structure_without_contacts_is_exported(view, tmp_path, form):
    """Robots that only heights, fixes or ranges locate are a structure, too."""
    log = replace(view.log, contacts=view.log.contacts[:0])
    some = replace(view, read_log=lambda: log)

    export_view(some, form, tmp_path, Progress())

    assert all(path.stat().st_size for path in tmp_path.iterdir())
    names = {path.stem for path in tmp_path.iterdir()}
    assert names & {"estimate", "case", "structure", "growth"}, names


@pytest.mark.parametrize(("form", "task"), [("png", "render"), ("gif", "animate")])
def test_pictures_report_what_draws_them(view, tmp_path, form, task):
    """A film of many robots takes minutes."""
    begun = Recorder()

    export_view(view, form, tmp_path, begun)

    assert task in begun.tasks
    assert any(line.startswith("drawn by ") for line in begun.lines)


def test_mcap_has_the_log_and_the_poses(view, exported):
    """A log reads back from its topic, bit for bit; each message is at the join of its robot."""
    path = exported / "case.mcap"

    back = read_sensing_log(path)

    for old, new in ((view.log, back), (view.log.stances, back.stances)):
        for field in fields(old):
            if field.name not in {"noise", "stances"}:
                np.testing.assert_array_equal(getattr(new, field.name), getattr(old, field.name))
    times, poses = zip(*_messages(path, "structure"), strict=True)
    assert list(times) == [10**9 * join for join in range(30)]
    np.testing.assert_array_equal(
        [[each[f"{c}_cm"] for c in "xyz"] for each in poses], view.pose[:, :3]
    )
    assert [time for time, _ in _messages(path, "sensing")] == [0, *times]


def _messages(path, topic):
    with path.open("rb") as file:
        return [
            (message.log_time, json.loads(message.data))
            for _, channel, message in make_reader(file).iter_messages(topics=[topic])
        ]


def test_damaged_mcap_never_escapes(view, exported, tmp_path):
    """A damaged file is refused in one line, unless the log in it is whole."""
    raw, random = (exported / "case.mcap").read_bytes(), Random(0)
    path, outcomes = tmp_path / "damaged.mcap", []

    for _ in range(100):
        path.write_bytes(damaged(random, raw))
        try:
            outcomes.append(f"{read_sensing_log(path).robot_count} robots")
        except InputError as refusal:
            outcomes.append(str(refusal))

    refused = [outcome for outcome in outcomes if outcome != "30 robots"]
    assert len(refused) > 30
    assert [each for each in refused if not re.fullmatch(rf"{path}:\d+: .+", each)] == []


def test_a_log_needs_its_topic(exported, tmp_path, tiswarm):
    """Files without it, and no MCAP, are refused by name; a command reads one that has it."""
    path = tmp_path / "empty.mcap"
    path.write_bytes(encode_messages({"other": [(0, {})]}))

    done = tiswarm("check", path, exported / "case.mcap")

    assert done.returncode == 2
    assert "empty.mcap:1: there are no messages of the topic sensing; see tiswarm" in done.stderr
    assert "30 robots" in done.stdout
    path.write_text("{}")
    with pytest.raises(InputError, match="not a whole MCAP file; record or copy it again"):
        read_sensing_log(path)


def test_tum_has_a_pose_a_join(view, exported):
    """Rows are time, position and quaternion, real part last."""
    table = np.loadtxt(exported / "structure.tum")

    np.testing.assert_array_equal(table[:, 0], np.arange(30))
    np.testing.assert_array_equal(table[:, 1:4], view.pose[:, :3])
    np.testing.assert_allclose(
        Rotation.from_quat(table[:, 4:]).as_matrix(),
        Rotation.from_quat(view.pose[:, 3:], scalar_first=True).as_matrix(),
        atol=1e-12,
    )


def _graph(gtsam, path):
    """Read PyFG by its grammar into factors and values of gtsam."""
    factors, values, kinds = gtsam.NonlinearFactorGraph(), gtsam.Values(), []
    key = {"A": gtsam.symbol_shorthand.X, "L": gtsam.symbol_shorthand.L}

    def named(name):
        return key[name[0]](int(name[1:]))

    def pose(numbers):
        x, y, z, qx, qy, qz, qw = map(float, numbers)
        return gtsam.Pose3(gtsam.Rot3.Quaternion(qw, qx, qy, qz), [x, y, z])

    def noise(upper, size, order):
        covariance = np.zeros((size, size))
        covariance[np.triu_indices(size)] = np.array(upper, float)
        covariance = np.maximum(covariance, covariance.T)[np.ix_(order, order)]
        return gtsam.noiseModel.Gaussian.Covariance(covariance)

    rotation_first = [3, 4, 5, 0, 1, 2]
    for line in path.read_text().splitlines():
        kind, *words = line.split(" ")
        kinds.append(kind)
        if kind == "VERTEX_SE3:QUAT":
            values.insert(named(words[1]), pose(words[2:]))
        elif kind == "VERTEX_XYZ":
            values.insert(named(words[0]), np.array(words[1:], float))
        elif kind == "VERTEX_SE3:QUAT:PRIOR":
            spread = noise(words[9:], 6, rotation_first)
            factors.add(gtsam.PriorFactorPose3(named(words[1]), pose(words[2:9]), spread))
        elif kind == "EDGE_SE3_XYZ":
            # gtsam has no such factor in Python: bearing and range together say the same
            arm, start, end = np.array(words[3:6], float), named(words[1]), named(words[2])
            model = gtsam.noiseModel.Isotropic.Sigma(3, float(words[6]) ** 0.5)
            length = np.linalg.norm(arm)
            made = gtsam.BearingRangeFactor3D(start, end, gtsam.Unit3(arm), length, model)
            factors.add(made)
        else:
            assert kind == "EDGE_RANGE"
            factor = gtsam.RangeFactor3 if words[1][0] == "L" else gtsam.RangeFactorPose3
            model = gtsam.noiseModel.Isotropic.Sigma(1, float(words[4]) ** 0.5)
            factors.add(factor(named(words[1]), named(words[2]), float(words[3]), model))
    return factors, values, kinds


def test_pyfg_is_solved_by_gtsam(view, tmp_path):
    """An exact log agrees with the truth, and pulls an estimate that is shifted back to it."""
    gtsam = pytest.importorskip("gtsam")  # has no wheel for Python 3.10
    shaken = np.random.default_rng(0).normal(0.0, 0.02, (30, 3))
    apart = np.linalg.norm(view.pose[1, :3] - view.pose[0, :3])
    ranges = np.array([[1.0, 0.0, apart, 0.3, 0.0]])
    source = {"source_name": ("radio",), "source_sd": np.array([0.4])}
    log = replace(view.log, ranges=ranges, **source)
    measured = replace(view, read_log=lambda: log)
    export_view(measured, "pyfg", tmp_path / "true", Progress())
    pose = view.pose + np.hstack([shaken, np.zeros((30, 4))])
    export_view(replace(measured, pose=pose), "pyfg", tmp_path / "shaken", Progress())

    factors, values, kinds = _graph(gtsam, tmp_path / "true" / "case.pyfg")
    _, start, _ = _graph(gtsam, tmp_path / "shaken" / "case.pyfg")

    assert kinds[0] == "VERTEX_SE3:QUAT"  # readers take the dimension from the first line
    assert kinds.count("VERTEX_XYZ") == kinds.count("EDGE_SE3_XYZ") == 90
    assert kinds.count("VERTEX_SE3:QUAT:PRIOR") == 30
    assert kinds.count("EDGE_RANGE") == len(view.log.contacts) + 1
    last = (tmp_path / "true" / "case.pyfg").read_text().split()[-1]
    assert float(last) == pytest.approx(0.3**2 + 0.4**2)  # the format has no shared errors
    priors = 30.0 * 3.0 * (50.0 / 1e6) ** 2  # towers are lower than 50 R; position priors give way
    assert factors.error(values) < priors + 1e-6
    assert factors.error(start) > 1e3
    solved = gtsam.LevenbergMarquardtOptimizer(factors, start).optimize()
    assert factors.error(solved) < 1e-2
