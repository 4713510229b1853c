"""Kernels are read in less time, and mean the same; kernels of others are read as ever."""

import json
import subprocess
import sys

import numpy as np
import pytest

from tests.runs import environment
from tiswarm.compute import backend
from tiswarm.compute.lang import LIBRARY, Reals1, ti
from tiswarm.compute.math_kernels import probe_arithmetic

COUNT = """
import inspect, json, sys
from tiswarm.compute import backend, lang
drawn = {"ours": 0, "all": 0}
utils = lang.ti.lang.ast.ast_transformer_utils
if hasattr(utils, "TextWrapper"):
    whole = utils.TextWrapper
    def counted(*arguments, **more):
        drawn["all"] += 1
        return whole(*arguments, **more)
    utils.TextWrapper = counted
searched = []
asked = inspect.getframeinfo
inspect.getframeinfo = lambda frame, *more: (searched.append(frame.f_code.co_filename),
                                             asked(frame, *more))[1]
import tiswarm.engine.kernels
backend.start("cpu")
print(json.dumps([drawn["all"], [name for name in searched if "frozen" in name]]))
"""


def test_neither_lines_nor_modules_are_searched_for_our_kernels():
    """Importing kernels and starting the backend, which reads one, draws no line of source."""
    done = subprocess.run(
        [sys.executable, "-c", COUNT], env=environment(), capture_output=True, text=True, check=True
    )

    drawn, searched = json.loads(done.stdout)
    assert drawn == 0
    assert searched == []


@ti.kernel
def _of_others(value_out: Reals1):
    for place in range(value_out.shape[0]):
        value_out[place] = value_out[place] + unheard_of  # noqa: F821


def test_errors_in_kernels_show_the_line():
    """With what is wrong below it, as the library draws it."""
    backend.start("cpu")

    with pytest.raises(Exception, match="unheard_of") as refusal:
        _of_others(np.zeros(3))

    assert "value_out[place] + unheard_of" in str(refusal.value)
    assert "^^^^^" in str(refusal.value)


def test_kernels_of_classes_are_still_known():
    """A method takes its object first, which is no array of the kernel."""

    @ti.data_oriented
    class Doubler:
        @ti.kernel
        def double(self, value_out: Reals1):
            for place in range(value_out.shape[0]):
                value_out[place] = 2.0 * value_out[place]

    backend.start("cpu")
    value = np.ones(3)

    Doubler().double(value)

    np.testing.assert_array_equal(value, 2.0)


@pytest.mark.skipif(LIBRARY != "taichi", reason="quadrants draws each line once")
def test_positions_in_our_own_kernels_are_file_and_line(monkeypatch):
    """What they cost is drawing the lines of every expression."""
    context = ti.lang.ast.ast_transformer_utils.ASTTransformerContext
    seen = []
    short = context.get_pos_info
    monkeypatch.setattr(
        context, "get_pos_info", lambda self, node: seen.append(short(self, node)) or seen[-1]
    )
    backend.start("cpu")
    kernel = probe_arithmetic._primal  # noqa: SLF001

    kernel.compiled_kernels.clear()
    kernel(np.ones(16))

    assert seen
    assert all(text.startswith('File "') and text.count("\n") == 1 for text in seen)
