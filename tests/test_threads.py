"""Threads change no bit: the same work on one thread and on two, kernels as users run them.

A start on another number of threads traces all kernels anew, so one fixture does all of the work on
two threads, and then on one. The end of the first program stores its kernels, so that other workers
of pytest and processes that tests start need not compile them again.
"""

import dataclasses
from collections.abc import Callable
from functools import cache
from importlib.util import find_spec
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest
import trimesh

from tests.engine.test_relax import GAINS, ROBOT, swarm
from tests.engine.test_user_forces import Atom, crystal, langevin, lennard_jones, level
from tests.localization.distributed.test_distributed import QUICK as DISTRIBUTED
from tests.localization.online.test_online import QUICK as ONLINE
from tests.localization.test_branch_sums import annealer
from tests.localization.test_joint_estimates import BIASED
from tests.localization.test_joint_estimates import SHORT as JOINT
from tests.localization.test_together import SHORT as TOGETHER
from tests.localization.test_virtual_force import CUES
from tests.runs import LOCALIZERS, REPOSITORY, repeated_files
from tests.sensing.suites.test_sight import cloud, views
from tests.structures import NOISY, silent
from tests.world.test_growth import FIREANT, KINDS
from tiswarm import relax, study
from tiswarm.base.progress import Progress
from tiswarm.compute import backend
from tiswarm.localization.chains.card_kernels import STEPS_A_LAUNCH
from tiswarm.localization.methods import localize_many
from tiswarm.localization.peers.settings import HopByHopParams, LeastSquaresParams
from tiswarm.localization.settings import Cues, Together
from tiswarm.records.sensing_log import SensingLog
from tiswarm.scenario.expansion import load_scenario
from tiswarm.sensing import SensingParams, observe
from tiswarm.sensing.sight import in_sight
from tiswarm.world.ground.bodies import PlaneParams, SphereParams
from tiswarm.world.ground.grids import grid_of_mesh
from tiswarm.world.growth import grow
from tiswarm.world.mechanics import MechanicsParams
from tiswarm.world.params import TowerParams


class Scale(NamedTuple):
    """How much of the work is done."""

    structures: int
    """Structures side by side."""

    robots: int
    """Robots of each."""

    swarm: int
    """Robots that move all at once."""


SMALL = Scale(structures=1, robots=12, swarm=10_000)
FULL = Scale(structures=3, robots=30, swarm=100_000)

Work = Callable[[Scale, Path], object]
"""Computes something; what it writes goes into the folder."""


def _bits(value: object) -> object:
    """Return a value with its arrays as bytes, so that `==` compares all of their bits."""
    if isinstance(value, np.ndarray):
        return value.dtype.str, value.shape, value.tobytes()
    if dataclasses.is_dataclass(value):
        return {f.name: _bits(getattr(value, f.name)) for f in dataclasses.fields(value)}
    if isinstance(value, dict):
        return {key: _bits(each) for key, each in value.items()}
    if isinstance(value, list | tuple):
        return [_bits(each) for each in value]
    return value if isinstance(value, bytes) else repr(value)


# --- work ------------------------------------------------------------------------------------


def _logs(scale: Scale, noise: SensingParams = NOISY) -> list[SensingLog]:
    """Logs of noisy towers."""
    seeds = range(scale.structures)
    towers = grow(TowerParams(), robots=scale.robots, seeds=seeds, robot=FIREANT)
    return [observe(tower, noise) for tower in towers]


_swarm = cache(swarm)
"""Structures of the engine; two numbers of threads move the same one."""


def _growth(kind: str, movers: int) -> Work:
    params = dataclasses.replace(KINDS[kind], movers=movers)
    return lambda *_: grow(params, robots=25, seeds=[1, 3, 4], robot=FIREANT)


def _growth_by_dissection(scale: Scale, _: Path) -> object:
    """Grow towers whose mechanics METIS orders."""
    params = TowerParams(movers=2, mechanics=MechanicsParams(order="nested-dissection"))
    seeds = range(scale.structures)
    return grow(params, robots=2 * scale.robots, seeds=seeds, robot=FIREANT)


def _growth_on_ground(*_: object) -> object:
    """Grow towers on a hill, and make the grid of a boulder."""
    hill = (PlaneParams(), SphereParams(position=(0.0, 0.0, -40.0), radius=60.0))
    towers = grow(TowerParams(terrain=hill, movers=3), robots=12, seeds=[1, 3], robot=FIREANT)
    boulder = trimesh.creation.icosphere(subdivisions=2, radius=4.0)
    vertex, face = np.array(boulder.vertices), np.array(boulder.faces)
    return towers, grid_of_mesh(vertex, face, 0.5).value


def _sight(*_: object) -> object:
    history = cloud(1, 60, 30.0)
    return in_sight(history, views(1, history, 2000, [30.0, 30.0, 30.0]))


def _method(*params: object) -> Work:
    """Localize all logs by each of some settings, all at once."""

    def localize(scale: Scale, _: Path) -> object:
        logs = _logs(scale)
        every = [each for each in params for _ in logs]
        return localize_many(logs * len(params), every)

    return localize


def _joint(scale: Scale, _: Path) -> object:
    logs = [*_logs(scale), *_logs(scale, BIASED)]
    apart = dataclasses.replace(JOINT, cues=Cues(height=False, walk_contacts=False))
    return localize_many(logs * 2, [JOINT] * len(logs) + [apart] * len(logs))


def _joint_on_a_card(scale: Scale, _: Path) -> object:
    """Let the processor sum forces on branches as a card does: many threads, one sum."""
    running = dataclasses.replace(backend.current(), arch="vulkan")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(backend, "current", lambda: running)
        card = annealer(_logs(scale))
        card.advance(2 * STEPS_A_LAUNCH + 1)
        return card.by_robot(card.swarm.position)


def _messages(scheme: object, channel: str) -> Work:
    params = dataclasses.replace(scheme, channel=channel, loss=0.3, delay=1)
    return lambda scale, _: localize_many(_logs(scale)[:1], [params])


def _together(scale: Scale, _: Path) -> object:
    center, orientation, contacts = _swarm(scale.swarm, 5)
    is_first = (contacts[:, 0] < contacts[:, 2])[:, None]
    log = silent(
        center,
        orientation_wxyz=orientation,
        contacts=np.where(is_first, contacts, contacts[:, [2, 3, 0, 1]]),
        flip_height=center[:, 2],
    )
    return localize_many([log], [dataclasses.replace(TOGETHER, together=Together(steps=6))])


def _relax(sides: tuple[int, int, int]) -> Work:
    """Move robots in shuffled order; races have shown at this size and hidden at 20,000."""

    def move(*_: object) -> object:
        place = _swarm(100_000, 5, sides)
        done = relax(
            *place, robot=ROBOT, ramp=0.5, steps=5, threads=backend.current().threads,
            **GAINS | {"max_step": 0.5},
        )  # fmt: skip
        assert done.list_builds > 1
        further = done.resume(steps=3)
        further.swarm.step(3, ramp=0.5, **GAINS | {"max_step": 0.5})
        return [done.position, further.position, further.swarm.position]

    return move


def _fluid(scale: Scale, _: Path) -> object:
    """Move atoms in shuffled order by a force and an integrator of a user, with noise."""
    position = np.random.default_rng(6).permutation(crystal(scale.swarm, 6))
    done = relax(
        position, level(scale.swarm), [], robot=Atom, steps=6,
        force=lennard_jones, integrator=langevin, cutoff=2.5, seed=3, max_step=0.3,
        parameters={"epsilon": 1.0, "friction": 1.0, "temperature": 90.0, "dt": 0.02},
        threads=backend.current().threads,
    )  # fmt: skip
    assert done.list_builds > 1
    return done.position


def _run(*sets: str) -> Work:
    """Run a scenario and read all files that must repeat."""

    def run(_: Scale, folder: Path) -> object:
        scenario = load_scenario(REPOSITORY / "tests" / "tower.yaml", sets)
        threads = backend.current().threads
        done = study.run(scenario, folder, threads=threads, progress=Progress())
        return repeated_files(done.folder)

    return run


WORKS: dict[str, Work] = {
    **{f"growth of a {kind}": _growth(kind, 1) for kind in ("cantilever", "bridge", "chain")},
    **{f"growth of a {kind} by three": _growth(kind, 3) for kind in ("tower", "cantilever")},
    **({"growth by nested dissection": _growth_by_dissection} if find_spec("pymetis") else {}),
    "growth on ground of bodies": _growth_on_ground,
    "sight": _sight,
    "joint": _joint,
    "joint on a card": _joint_on_a_card,
    "virtual-force": _method(*CUES),
    "virtual-force together": _together,
    "least-squares": _method(LeastSquaresParams()),
    "hop-by-hop": _method(HopByHopParams()),
    "online": _method(ONLINE),
    "distributed by touch": _messages(DISTRIBUTED, "touch"),
    "distributed by radio": _messages(DISTRIBUTED, "radio"),
    "relax, dense": _relax((1, 1, 1)),
    "relax, tall": _relax((1, 1, 400)),
    "relax, a fluid": _fluid,
    "run": _run("robots=12", "seeds=2"),
    "closed loop": _run(
        "robots=8",
        "seeds=1",
        "sensing.tilt_noise_deg=1",
        "sweep={structure.navigate_by: [truth, estimate]}",
        "conditions={once: {}, back: {localization.back_propagation: {every: 5}}}",
    ),
}


@pytest.fixture(
    scope="module",
    params=[SMALL, pytest.param(FULL, marks=pytest.mark.trial)],
    ids=["small", "full"],
)
def found(request, tmp_path_factory) -> dict[str, list[object]]:
    """By work, what came of it on two threads and on one; an exception if it failed."""
    found: dict[str, list[object]] = {name: [] for name in WORKS}
    for threads in (2, 1):
        backend.start(threads=threads)
        for name, work in WORKS.items():
            try:
                value = _bits(work(request.param, tmp_path_factory.mktemp("work")))
            except Exception as error:  # noqa: BLE001 - the test of this work raises it
                value = error
            found[name].append(value)
            assert backend.current().threads == threads
    return found


# --- claims ----------------------------------------------------------------------------------


@pytest.mark.parametrize("name", WORKS)
def test_threads_change_no_bit(found, name):
    """The same scenario, seed and version give the same bytes at any number of threads."""
    two, one = found[name]

    for value in (two, one):
        if isinstance(value, Exception):
            raise value
    assert len(repr(two)) > 1000
    assert two == one


@pytest.mark.parametrize("method", LOCALIZERS)
def test_every_method_is_among_them(method):
    """A new method brings a work of its own."""
    assert any(f"{name} ".startswith(f"{method} ") for name in WORKS)
