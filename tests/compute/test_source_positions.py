"""Positions in source files are written once, in the words of the kernel library."""

import ast
from types import SimpleNamespace

import numpy as np
import pytest

from tiswarm.compute import backend, source_positions
from tiswarm.compute.lang import Ints1, ti


@ti.func
def _missing(number):
    return number.no_such_part  # the line that the error shows


@ti.kernel
def _faulty(number_out: Ints1):
    number_out[0] = _missing(number_out[0])


def test_an_error_shows_the_line_of_a_kernel_that_has_it():
    """The second reading, which remembers the first, says the same."""
    backend.processor()
    said = []

    for _ in range(2):
        with pytest.raises(Exception, match="no_such_part") as raised:
            _faulty(np.zeros(1, np.int32))
        said.append(str(raised.value))

    assert "return number.no_such_part  # the line that the error shows" in said[0]
    assert said[0] == said[1]


def test_the_position_of_a_node_is_written_once_for_each_function():
    """A function that is read for each of its calls costs its texts once."""
    written = []

    def write(context, node):
        written.append((context.func.func, node.lineno))
        return f"line {node.lineno}"

    remembering = source_positions._remembering(write)  # noqa: SLF001 - what it wraps is the library's
    first, second = (SimpleNamespace(func=SimpleNamespace(func=name)) for name in ("f", "g"))

    for context in (first, first, second):
        (statement,) = ast.parse("\nx = 1").body  # a new tree at each reading
        assert remembering(context, statement) == "line 2"

    assert written == [("f", 2), ("g", 2)]


def test_kernels_of_classes_are_still_recognized():
    """Programs beside tiswarm declare kernels in classes."""

    @ti.data_oriented
    class Counter:
        @ti.kernel
        def count(self, number_out: Ints1):
            number_out[0] += 1

    backend.processor()
    number = np.zeros(1, np.int32)

    Counter().count(number)

    assert number[0] == 1


def test_a_library_that_is_arranged_otherwise_is_left_as_it_is():
    """Only time is lost where a new version has other names."""
    source_positions.remember_positions("json")
