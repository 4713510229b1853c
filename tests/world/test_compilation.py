"""Kernels that compile in less time compute the same bits."""

import contextlib
import dataclasses

import numpy as np
import pytest

from tests.frames import needs_metis
from tiswarm.base.robot import RobotGeometry
from tiswarm.compute import backend
from tiswarm.world import mechanics, panels
from tiswarm.world.growth import grow
from tiswarm.world.history import History
from tiswarm.world.mechanics import MechanicsParams
from tiswarm.world.params import BridgeParams, CantileverParams, GrowthParams, TowerParams

pytestmark = [pytest.mark.trial, pytest.mark.unchecked]


@pytest.mark.parametrize(
    "structure",
    [
        TowerParams(),
        CantileverParams(anchor=3.5, founders=2),
        BridgeParams(),
        TowerParams(movers=4),
    ],
    ids=["tower", "cantilever", "bridge", "movers"],
)
def test_loads_have_the_bits_of_kernels_that_the_library_optimizes(
    monkeypatch, structure: GrowthParams
):
    """The library removes what is computed twice, and LLVM does so, too."""
    by_llvm = grow(structure, robots=60, seeds=range(8), robot=RobotGeometry())

    backend.end()  # a kernel is compiled once in a program
    monkeypatch.setattr(mechanics, "optimized_by_llvm", contextlib.nullcontext)
    by_library = grow(structure, robots=60, seeds=range(8), robot=RobotGeometry())

    _assert_equal_bits(by_llvm, by_library)


@pytest.mark.parametrize("model", ["flexible", "rigid"])
@pytest.mark.parametrize(
    "order", ["minimum-degree", pytest.param("nested-dissection", marks=needs_metis)]
)
def test_loads_have_the_bits_of_kernels_without_vectors(monkeypatch, model, order):
    """Registers of several numbers round each of them as one number is rounded."""
    tower = TowerParams(mechanics=MechanicsParams(model=model, order=order))
    by_vectors = grow(tower, robots=60, seeds=range(3), robot=RobotGeometry())

    backend.end()  # a kernel is compiled once in a program
    for module in (mechanics, panels):
        monkeypatch.setattr(module, "native_vectors", contextlib.nullcontext)
    by_numbers = grow(tower, robots=60, seeds=range(3), robot=RobotGeometry())

    _assert_equal_bits(by_vectors, by_numbers)


def _assert_equal_bits(histories: list[History], expected: list[History]) -> None:
    for one, same in zip(histories, expected, strict=True):
        assert one.sensed.tobytes() == same.sensed.tobytes()
        assert one.position.tobytes() == same.position.tobytes()
        loads = [
            np.array([*map(dataclasses.astuple, history.loads)]).tobytes()
            for history in (one, same)
        ]
        assert loads[0] == loads[1]
