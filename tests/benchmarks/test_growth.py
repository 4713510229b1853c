"""The benchmark of growth finds the functions that it times."""

import pytest

from benchmarks.growth import PARTS
from tests.benchmarks.commands import call

SMALL_STUDY = ["--set", "sweep={robots: [12]}", "--set", "conditions={paper: {}}"]


@pytest.mark.parametrize("part", PARTS)
def test_every_part_exists(part):
    """A part names a function of its owner."""
    owner, name = PARTS[part]

    assert callable(getattr(owner, name))


@pytest.mark.trial
@pytest.mark.parametrize(
    ("name", "arguments", "row"),
    [
        ("growth", ["--quick"], "| 100 robots, 25 structures"),
        ("growth", ["--robots", "100"], "100 robots, minimum-degree: loads differ by "),
        ("million", ["--towers", "1", "--robots", "12"], "joint"),
        ("kernels", [*SMALL_STUDY, "--set", "seeds=1"], "| grow | climb |"),
    ],
)
def test_the_command_prints_its_table(name, arguments, row):
    """Both name the machine first, without which times say little."""
    done = call(name, *arguments)

    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith("machine: {")
    assert row in done.stdout
