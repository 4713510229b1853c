"""`tiswarm.run` gives a notebook what the command writes."""

import re
import subprocess
import sys

import numpy as np
import pandas as pd
import pytest

import tiswarm as library
from tests.runs import assert_same_results
from tiswarm.errors import InputError

SMALL = {"robots": 6, "seeds": 2, "localization.iterations": 40}


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """Two towers under three conditions, run from Python."""
    out = tmp_path_factory.mktemp("reports")
    return library.run("scenarios/tower.yaml", SMALL, out=out, quiet=True)


def test_tables_are_data_frames(run):
    """Results by condition, by case and of one case are those of the files."""
    assert list(run.summary["status"]) == ["done"] * 6
    assert run.table["rmse_R_mean"].notna().all()
    assert len(run.frame("estimate", case=run.summary["case"][0])) == 6
    pd.testing.assert_frame_equal(run.table, pd.read_csv(run.folder / "table.csv"))
    with pytest.raises(InputError, match="nothing"):
        run.frame("nothing")


def test_figures_show_themselves(run):
    """A notebook asks for the bytes of a picture."""
    assert {"convergence", "accuracy"} <= set(run.figures)
    assert run.figures["convergence"]._repr_png_().startswith(b"\x89PNG")


def test_the_command_writes_the_same(run, tiswarm, tmp_path):
    """Same scenario, same folder, same bytes."""
    settings = [f"--set={key}={value}" for key, value in SMALL.items()]

    done = tiswarm("run", "scenarios/tower.yaml", *settings, "--out", tmp_path)

    assert done.returncode == 0, done.stderr
    assert_same_results(run.folder, tmp_path / run.folder.name)


def test_numbers_of_numpy_are_plain_numbers(run):
    """A scenario changed by them is the same scenario; a finished run is found."""
    overrides = {
        "robots": np.int64(6),
        "seeds": np.uint8(2),
        "localization.iterations": np.int32(40),
    }

    again = library.run("scenarios/tower.yaml", overrides, out=run.folder.parent, quiet=True)

    assert again.folder == run.folder


def test_settings_of_numpy_are_plain_numbers(run):
    """A log is localized by the same settings; anything that is no plain data is refused."""
    log = run.folder / "cases" / "0-baseline" / "sensing.jsonl"

    found = library.localize(
        log, "virtual-force", iterations=np.int64(5), height_gain=np.float32(1)
    )

    expected = library.localize(log, "virtual-force", iterations=5, height_gain=1.0)
    np.testing.assert_array_equal(found.position, expected.position)
    with pytest.raises(InputError, match="iterations: is of type object"):
        library.localize(log, "virtual-force", iterations=object())


def test_joint_is_the_default_method(run):
    """Of the methods it is the most accurate."""
    log = run.folder / "cases" / "0-baseline" / "sensing.jsonl"
    quick = {"chains": 1, "steps": 1000}

    found = library.localize(log, **quick)

    expected = library.localize(log, "joint", **quick)
    np.testing.assert_array_equal(found.position, expected.position)


def test_failed_cases_are_warned_of(tmp_path):
    """What is done is kept; nobody overlooks what is not."""
    far = {"spawn_min": 300, "spawn_max": 310, "climb.max_flips": 2, "climb.max_spawns": 2}
    impossible = SMALL | {f"structure.{key}": value for key, value in far.items()}

    with pytest.warns(UserWarning, match="6 cases failed, the first: 0-"):
        run = library.run("scenarios/tower.yaml", impossible, out=tmp_path, quiet=True)

    assert set(run.summary["status"]) == {"failed"}


def test_a_log_is_localized_without_the_simulator(run):
    """Neither world nor sensing is imported for the log of another simulator."""
    log = run.folder / "cases" / "0-baseline" / "sensing.jsonl"
    code = (
        "import sys, tiswarm; tiswarm.localize(sys.argv[1], 'virtual-force', iterations=5);"
        "print(sorted(name for name in sys.modules if name.startswith('tiswarm.')))"
    )

    done = subprocess.run(
        [sys.executable, "-c", code, log], capture_output=True, text=True, check=True
    )

    assert "tiswarm.localization.registry" in done.stdout
    assert not re.search(r"tiswarm\.(world|sensing|study|report)", done.stdout)
