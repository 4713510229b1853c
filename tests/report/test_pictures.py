"""A picture always comes, and whoever failed to draw it is named."""

import sys
from dataclasses import replace

import numpy as np
import pytest
from PIL import Image

from tiswarm.errors import EnvironmentTroubleError, InputError
from tiswarm.progress import Progress
from tiswarm.report.folder import read_cases
from tiswarm.report.render import packages, pictures
from tiswarm.report.render.packages import missing_packages
from tiswarm.report.render.pictures import (
    RENDERERS,
    RendererError,
    draw_in_child,
    is_blank,
    render_run,
)
from tiswarm.report.render.probe import probe_renderers
from tiswarm.report.render.subjects import build_pictures

BROKEN_CHILDREN = {
    "import os; os.abort()": "killed by SIGABRT",
    "import time; time.sleep(60)": "no picture within",
    "raise ImportError('libodd.so.1: not found')": "ImportError: libodd.so.1: not found",
    "pass": "it wrote no picture",
    "open(sys.argv[2], 'w').write('half')": "it wrote no picture",
    "Image.new('RGB', size, 'white').save(sys.argv[2])": "its picture is blank",
    "Image.new('RGB', (8, 8), 'red').save(sys.argv[2])": "wrong size, 8 x 8",
}
PREAMBLE = """
import pickle, sys
from PIL import Image
with open(sys.argv[1], "rb") as file:
    camera = pickle.load(file).camera
size = camera.width, camera.height
"""


def child_that_does(code):
    """Make the command of a child that runs some code instead of drawing."""
    return (sys.executable, "-c", PREAMBLE + code)


@pytest.fixture
def scene(run_folder):
    """Twelve robots, to be drawn small."""
    scene = build_pictures(read_cases(run_folder)[0])["structure"].scene
    camera = scene.camera
    small = replace(camera, width=camera.width // 4, height=camera.height // 4)
    return replace(scene, camera=small)


@pytest.mark.parametrize(("code", "reason"), BROKEN_CHILDREN.items())
def test_a_broken_child_is_noticed(scene, monkeypatch, code, reason):
    """However a renderer fails, the parent lives and knows why."""
    monkeypatch.setattr(pictures, "CHILD", child_that_does(code))
    monkeypatch.setattr(pictures, "TIME_LIMIT", 1.5)

    with pytest.raises(RendererError, match=reason):
        draw_in_child([scene], "open3d")


def test_the_next_renderer_steps_in(run_folder, monkeypatch):
    """Where open3d dies, the pictures are ours, and say why and what to install."""
    monkeypatch.setattr(pictures, "CHILD", child_that_does("import os; os.abort()"))
    monkeypatch.setattr(packages, "missing_packages", lambda: ["libodd1"])

    drawn = render_run(run_folder, progress=Progress())

    assert [picture.path.name for picture in drawn] == [
        "structure.png",
        "sensed-force.png",
        "truth-and-estimate.png",
        "error.png",
        "contact-graph.png",
    ]
    for picture in drawn:
        assert picture.renderer == "taichi"
        assert picture.reason == (
            "open3d: killed by SIGABRT; open3d-raycast: killed by SIGABRT; apt-get install libodd1"
        )
        with Image.open(picture.path) as image:
            assert not is_blank(np.asarray(image))


def test_the_renderer_asked_for_is_not_replaced(run_folder, monkeypatch):
    """It fails with advice, and nothing is drawn."""
    monkeypatch.setattr(pictures, "CHILD", child_that_does("raise ImportError('libodd.so.1')"))
    monkeypatch.setattr(packages, "missing_packages", lambda: ["libodd1"])

    with pytest.raises(EnvironmentTroubleError, match=r"libodd\.so\.1; apt-get install libodd1"):
        render_run(run_folder, progress=Progress(), renderer="open3d-raycast")

    assert not [*run_folder.glob("renders/*")]


@pytest.mark.parametrize(
    ("choice", "problem"),
    [
        ({"renderer": "povray"}, "choose one of open3d, open3d-raycast, taichi"),
        ({"case": "1-no-z"}, "choose one of 0-baseline, 1-baseline, 0-no-z"),
    ],
)
def test_an_unknown_choice_is_refused(run_folder, choice, problem):
    """The message lists what there is; a failed case is not among it."""
    with pytest.raises(InputError, match=problem):
        render_run(run_folder, progress=Progress(), **choice)


def test_pictures_of_a_chosen_case_carry_its_name(run_folder):
    """They do not replace those of the run."""
    drawn = render_run(run_folder, progress=Progress(), renderer="taichi", case="0-no-z")

    assert all(picture.path.name.endswith("-0-no-z.png") for picture in drawn)


@pytest.mark.parametrize("renderer", RENDERERS)
def test_all_renderers_show_the_same_picture(scene, renderer):
    """Same camera, same colors; only outlines differ by a pixel's share."""
    reference = draw_in_child([scene], "taichi")[0].astype(float)
    try:
        picture = draw_in_child([scene], renderer)[0]
    except RendererError as error:
        pytest.skip(f"{renderer} does not work here: {error}")

    difference = np.abs(picture - reference).mean(axis=2)
    assert difference.mean() < 2.0
    assert (difference > 60.0).mean() < 0.01


@pytest.mark.parametrize("noise", [0, 5])
def test_a_picture_of_nothing_is_blank(noise):
    """Neither noise nor a stray dot makes a picture."""
    picture = np.random.default_rng(0).integers(240, 241 + noise, (100, 100, 3)).astype(np.uint8)
    picture[50, 50] = 0

    assert is_blank(picture)


def test_a_thin_structure_is_a_picture():
    """A line of robots one pixel wide is not nothing."""
    picture = np.full((100, 100, 3), 255, np.uint8)
    picture[:, 50] = (0, 114, 178)

    assert not is_blank(picture)


def test_probe_says_of_every_renderer_whether_it_works():
    """Our own always does; the others do, or say why not."""
    status = {status.name: status for status in probe_renderers()}

    assert tuple(status) == RENDERERS
    assert status["taichi"].works
    assert all(each.detail for each in status.values())


def test_missing_libraries_are_told_as_packages(monkeypatch):
    """On a bare Debian, with open3d 0.20 and 0.19."""
    monkeypatch.setattr(packages.sys, "platform", "linux")
    monkeypatch.setattr(packages.importlib.util, "find_spec", lambda _name: None)
    monkeypatch.setattr(packages, "_loads", lambda _library: False)
    monkeypatch.setattr(packages, "_has_vulkan_driver", lambda: False)

    monkeypatch.setattr(packages, "_open3d_version", lambda: (0, 20))
    vulkan = "libx11-6 libgl1 libegl1 libusb-1.0-0 libvulkan1 mesa-vulkan-drivers"
    assert missing_packages() == vulkan.split()

    monkeypatch.setattr(packages, "_open3d_version", lambda: (0, 19))
    assert missing_packages() == ["libx11-6", "libgl1", "libegl1", "libgomp1"]


def test_no_packages_are_named_off_linux(monkeypatch):
    """Wheels for other systems bring what they need."""
    monkeypatch.setattr(packages.sys, "platform", "darwin")

    assert missing_packages() == []
