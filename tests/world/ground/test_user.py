"""Ground by functions of users, in a file of their own."""

import numpy as np
import pytest

from tiswarm.base import plugins
from tiswarm.base.errors import InputError
from tiswarm.base.robot import RobotGeometry
from tiswarm.scenario.expansion import load_scenario
from tiswarm.world.growth import grow
from tiswarm.world.params import structure_ground

WAVES = '''
import tiswarm
from tiswarm import ti


@tiswarm.terrain("waves")
@ti.func
def waves(point):
    return (point[2] - ti.sin(0.5 * point[0])) / 1.12


@tiswarm.terrain("cone")
class Cone:
    height: float = 10.0
    """Height [R]."""

    def distance(self):
        height = self.height

        @ti.func
        def cone(point):
            around = ti.sqrt(point[0] ** 2 + point[1] ** 2)
            return (around + point[2] - height) / 2**0.5

        return cone
'''


@pytest.fixture(autouse=True)
def _forget():
    """Forget the plug-ins of each test."""
    yield
    plugins.forget()


@pytest.fixture
def load(tmp_path):
    """Load a file of a user, and return the settings of a structure on some ground."""

    def loaded(source, terrain):
        file = tmp_path / "own.py"
        file.write_text(source)
        plugins.load_plugins([file])
        section = {"kind": "tower", "terrain": terrain}
        given = {"name": "ground", "structure": section, "localization": {"method": "joint"}}
        return load_scenario(given).structure

    return loaded


def test_robots_grow_on_a_function_of_a_user(load):
    """Its bodies have places and settings as all others, and unite with them."""
    params = load(WAVES, [{"kind": "waves"}, {"kind": "cone", "position": [3.0, 0.0, -4.0]}])

    [history] = grow(params, robots=6, seeds=[0], robot=RobotGeometry())

    ground = structure_ground(params)
    place = np.array([[3.0, 0.0, 8.0], [20.0, 5.0, 4.0]])
    expected = [(8.0 + 4.0 - 10.0) / 2**0.5, (4.0 - np.sin(10.0)) / 1.12]
    np.testing.assert_allclose(ground.distance(place), expected, atol=1e-12)
    assert ground.body_at(place).tolist() == [1, 0]
    assert len(history.edge_docks)


def test_a_setting_of_a_user_is_checked_as_any_other(load):
    """A key that the class lacks is a mistake."""
    with pytest.raises(InputError, match=r"terrain\[0\].hight: unknown key; did you mean height"):
        load(WAVES, {"kind": "cone", "hight": 3.0})


def test_a_class_of_a_user_checks_its_settings(load):
    """The ValueError of `__post_init__` is a line at the body."""
    check = """
    def __post_init__(self):
        if self.height <= 0.0:
            raise ValueError(f"height should be above 0, not {self.height:g}")

    def distance"""
    source = WAVES.replace("\n    def distance", check)

    with pytest.raises(InputError, match=r"terrain\[1\]: height should be above 0, not -1$"):
        load(source, [{"kind": "waves"}, {"kind": "cone", "height": -1.0}])

    assert load(source, {"kind": "cone", "height": 1.0}).terrain[0].height == 1.0


def test_a_distance_may_use_what_its_class_has(load):
    """Its methods, constants, and what `__post_init__` derives."""
    derived = """
    STEEPNESS = 2.0

    def __post_init__(self):
        object.__setattr__(self, "tip", 0.5 * self.height)

    def doubled(self):
        return self.STEEPNESS * self.tip

    def distance"""
    source = WAVES.replace("\n    def distance", derived)
    source = source.replace("height = self.height", "height = self.doubled()")

    ground = structure_ground(load(source, {"kind": "cone", "height": 4.0}))

    place = np.array([[3.0, 4.0, 6.0]])
    np.testing.assert_allclose(ground.distance(place), 7.0 / 2**0.5, atol=1e-12)


def test_a_function_that_does_not_compile_is_a_line_with_its_place(load):
    """The file and the line of the function."""
    source = WAVES.replace("ti.sin(0.5 * point[0])", "no_such_name")

    with pytest.raises(InputError) as caught:
        load(source, {"kind": "waves"})

    assert caught.value.path.name == "own.py"
    assert caught.value.line == 9


def test_a_function_of_python_is_no_ground(load):
    """Kernels could not call it."""
    source = WAVES.replace('@tiswarm.terrain("waves")\n@ti.func\n', '@tiswarm.terrain("waves")\n')

    with pytest.raises(InputError, match=r"waves is no function that ti.func decorates"):
        load(source, {"kind": "waves"})


def test_a_class_needs_a_distance(load):
    """It says what the ground is."""
    source = WAVES.replace("def distance", "def depth")

    with pytest.raises(InputError, match=r"cone lacks distance; define it"):
        load(source, {"kind": "cone"})


def test_a_distance_that_grows_by_less_than_the_way_is_refused(load):
    """A Lipschitz constant below 1 belongs to no ground."""
    source = WAVES.replace('terrain("waves")', 'terrain("waves", lipschitz=0.5)')

    with pytest.raises(InputError, match=r"lipschitz of 0.5 for waves; give 1 or more"):
        load(source, {"kind": "waves"})


FAULTY = {
    "steep": ("3.0 * (point[2] - ti.sin(0.5 * point[0]))", "more than its lipschitz=1; divide it"),
    "no number": ("ti.sqrt(point[2])", "is no number at .*; return one for all points"),
    "inside": ("point[2] - 1e4", "waves is negative at all points near .* positive outside"),
    "outside": ("point[2] + 3e4", "there is no ground at"),
}


@pytest.mark.parametrize("name", FAULTY)
def test_a_function_that_is_no_distance_is_refused(load, name):
    """Where robots start, as a scenario is read."""
    formula, problem = FAULTY[name]
    source = WAVES.replace("(point[2] - ti.sin(0.5 * point[0])) / 1.12", formula)

    with pytest.raises(InputError, match=problem) as caught:
        load(source, [{"kind": "waves"}])

    assert caught.value.key == "structure.terrain"


def test_a_function_may_change_as_fast_as_it_states(load):
    """Three times as fast as a distance, where it says so."""
    steep = WAVES.replace("/ 1.12", "* 3.0").replace('"waves")', '"waves", lipschitz=3.4)')

    params = load(steep, [{"kind": "waves"}])

    assert structure_ground(params).lipschitz == 3.4
