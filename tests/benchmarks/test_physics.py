"""What the comparison of loads states of two sets of numbers."""

import numpy as np
import pytest

pytest.importorskip("mujoco", reason="the developers' tools have it from Python 3.11 on")

from benchmarks import physics


def test_differences_are_relative_and_by_robot():
    """Numbers by hand: every robot bears 10 % more, one bears twice as much."""
    other = np.linspace(1.0, 20.0, 20)
    one = 1.1 * other
    one[3] = 2.0 * other[3]

    found = physics.agreement(one, other)

    assert found.median == pytest.approx(0.1)
    # Between the second largest of 20 differences and the largest one.
    assert 0.1 <= found.most < 1.0
    assert 0.99 < found.correlation < 1.0


@pytest.mark.trial
def test_the_comparison_runs(capsys, tmp_path, monkeypatch):
    """A table of seven pairs for a tower and a cantilever, and two pictures."""
    monkeypatch.setattr("sys.argv", ["physics", "--quick", "--out", str(tmp_path)])
    monkeypatch.setattr(physics, "draw_worlds", lambda _: physics.Image.new("RGB", (8, 8)))

    physics.main()

    rows = [line.split(" | ") for line in capsys.readouterr().out.splitlines()[4:]]
    assert len(rows) == 14
    for row in rows:
        if "MuJoCo, springs" in row[1] or "without loops" in row[1] or "PyNite" in row[1]:
            assert row[2] == row[5] == "1.000"
    assert (tmp_path / "physics-loads.png").stat().st_size > 10_000


@pytest.mark.trial
def test_docks_that_rest_are_compared(capsys, monkeypatch):
    """Towers on three anchors stand in MuJoCo where the mechanics says so, or not much else."""
    monkeypatch.setattr(physics, "RESTING", {"tower": (physics.TowerParams(anchors=3), 12)})
    monkeypatch.setattr(physics, "FRICTIONS", (0.5,))
    monkeypatch.setattr(physics, "_SEEDS", range(7000, 7003))

    physics.compare_resting()

    (row,) = (line.strip("| ").split(" | ") for line in capsys.readouterr().out.splitlines()[4:])
    assert row[0] == "tower, 12"
    assert sum(map(int, row[2:5])) == 3
    assert row[5] in {"2 of 3", "3 of 3"}
