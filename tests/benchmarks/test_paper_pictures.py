"""The table beside the picture of errors along cantilevers separates robots as its words say."""

import numpy as np
import pandas as pd
import pytest

from benchmarks.reactivebuild import pictures


def test_errors_are_split_at_the_first_robot_on_the_anchor():
    """The anchor counts in neither; later first contacts go with larger errors here."""
    rows = [
        {"point": "F 5", "seed": seed, "first": first, "join": join, "hops_from_anchor": join,
         "error_R": 0.0 if join == 0 else 4.0 + seed if join < first else 1.0}
        for seed, first in enumerate((2.0, 3.0, 4.0))
        for join in range(6)
    ]  # fmt: skip

    [found] = pictures.summarize(pd.DataFrame(rows)).to_dict("records")

    early = [4.0] + [5.0] * 2 + [6.0] * 3
    assert found["before_R"] == pytest.approx(np.sqrt(np.mean(np.square(early))))
    assert found["from_R"] == pytest.approx(1.0)
    assert (found["first"], found["correlation"]) == (3.0, pytest.approx(1.0))


def test_each_set_has_a_tower_and_a_cantilever(monkeypatch):
    """Pairs of the sheet are a tower, then a cantilever, of a tenth of the robots here."""
    grow = pictures.grow
    monkeypatch.setattr(
        pictures, "grow", lambda params, **how: grow(params, **{**how, "robots": 10})
    )

    figure = pictures.draw_structures()

    assert len(figure.axes) == 10
    assert [axes.get_title() for axes in figure.axes[:5]] == [
        title for titles in pictures.TITLES.values() for title in titles
    ]
    shown = [axes.collections[-1].get_offsets() for axes in figure.axes]
    assert all(len(docks) == 30 for docks in shown)
    assert all(axes.get_aspect() == 1.0 for axes in figure.axes)
