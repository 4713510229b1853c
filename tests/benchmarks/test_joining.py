"""The table of joins has what the note on them names."""

import pandas as pd
import pytest

from tests.benchmarks.commands import call

OPTIONS = ["--kinds", "tower", "--robots", 12, "--seeds", 2, "--at", 8, 12]


@pytest.mark.trial
def test_joins_are_compared_with_joint_on_the_same_robots(tmp_path):
    """A second call measures nothing again, and prints the same table."""
    done = call("joining", *OPTIONS, "--out", tmp_path)

    assert done.returncode == 0, done.stderr
    stored = (tmp_path / "joining.csv").read_bytes()
    table = pd.read_csv(tmp_path / "joining.csv")
    assert table["seed"].tolist() == [0, 1]
    assert table["robots"].tolist() == [12, 12]
    for column in ("at_join_R", "after_R", "final_R", "joint_R", "last_R", "last_joint_R"):
        assert table[column].between(0.0, 5.0).all()
    for column in ("within_at_join", "within_after"):
        assert table[column].between(0.0, 1.0).all()
    assert (table["local_ms"] <= table["worst_ms"]).all()
    assert (table["annealed"] > 0).all()
    again = call("joining", *OPTIONS, "--out", tmp_path)
    assert again.stdout == done.stdout
    assert (tmp_path / "joining.csv").read_bytes() == stored
    ratio = table["final_R"].mean() / table["joint_R"].mean()
    [printed] = [line for line in done.stdout.splitlines() if line.startswith("final_of_joint")]
    assert float(printed.split()[-1]) == pytest.approx(ratio, rel=0.01)


@pytest.mark.trial
def test_what_robots_send_is_shared_out_by_kind(tmp_path):
    """Positions are near the truth, also where all rows lead; shares sum to one."""
    options = ["--messages", "--kinds", "tower", "--robots", 12, "--seeds", 2]
    options += ["--first-seed", 100_010, "--reviews", 2]
    done = call("joining", *options, "--out", tmp_path)

    assert done.returncode == 0, done.stderr
    table = pd.read_csv(tmp_path / "messages.csv")
    assert table["seed"].tolist() == [100_010, 100_011]
    for column in ("joint_R", "reviewed_0_R", "reviewed_1_R", "reviewed_2_R", "nearest_R"):
        assert table[column].between(0.0, 3.0).all(), column
    for before, after in (("sent_0_B", "sent_1_B"), ("sent_1_B", "sent_2_B")):
        assert (table[before] < table[after]).all()
    shares = table.filter(like="_share")
    assert shares.sum(axis=1).to_numpy() == pytest.approx(1.0, abs=1e-3)
    assert {"answer_share", "lines_share", "acknowledgment_share"} <= {*shares}
    assert table["worst_passes_on"].between(0.0, 1.0, inclusive="neither").all()
    again = call("joining", *options, "--out", tmp_path)
    assert again.stdout == done.stdout
