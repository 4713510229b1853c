"""The benchmark of growth finds the functions that it times."""

import pytest

from benchmarks.growth import PARTS


@pytest.mark.parametrize("part", PARTS)
def test_every_part_exists(part):
    """A part names a function of its owner."""
    owner, name = PARTS[part]

    assert callable(getattr(owner, name))
