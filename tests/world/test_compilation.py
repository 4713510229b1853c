"""Kernels that compile in less time compute the same bits."""

import contextlib
import dataclasses

import numpy as np
import pytest

from tiswarm.base.robot import RobotGeometry
from tiswarm.compute import backend
from tiswarm.world import mechanics
from tiswarm.world.growth import grow
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

    for one, same in zip(by_llvm, by_library, strict=True):
        assert one.sensed.tobytes() == same.sensed.tobytes()
        assert one.position.tobytes() == same.position.tobytes()
        loads = [
            np.array([*map(dataclasses.astuple, history.loads)]).tobytes()
            for history in (one, same)
        ]
        assert loads[0] == loads[1]
