"""Names of series: unlike measurements never stand side by side without saying so."""

import pytest

from tests.report.conftest import write_summary
from tiswarm.report.page_tables import statement_of, warnings_of
from tiswarm.report.run_data import load_run
from tiswarm.report.series import series_names

ALL = ("contacts", "ground", "height", "non_overlap", "odometry", "walk_contacts")


@pytest.mark.parametrize(
    ("measured", "names"),
    [
        ([ALL, ALL], ["a", "b"]),
        (
            [["contacts", "walk_contacts"], ["contacts"]],
            ["a / walk contacts", "b / final contacts"],
        ),
        ([["contacts", "height"], ["contacts"]], ["a / heights", "b / without heights"]),
        (
            [["contacts", "height", "walk_contacts"], ["contacts", "height"], ["contacts"]],
            [
                "a / walk contacts and heights",
                "b / heights",
                "c / final contacts / without heights",
            ],
        ),
        (
            [ALL, ALL[1:], ALL[:3], ("contacts", "height")],
            [
                "a / all measurements",
                "b / without final contacts",
                "c / final contacts and ground contacts",
                "d / final contacts",
            ],
        ),
        (
            [ALL, ALL[:1], ALL[1:2]],
            ["a / all measurements", "b / final contacts", "c / ground contacts"],
        ),
        ([ALL, ["ranges"]], ["a / without ranges", "b / ranges"]),
        ([[*ALL, "ranges"], ["ranges"]], ["a / all measurements", "b / fewest measurements"]),
        (
            [["contacts", "walk_contacts"], [], ["contacts"]],
            ["a / walk contacts", "b", "c / final contacts"],
        ),
    ],
)
def test_names_have_the_measurements_that_differ(measured, names):
    """Equal measurements need no words, and a condition that failed has none."""
    conditions = {key: key for key, _ in zip("abcd", measured, strict=False)}

    assert [
        *series_names(conditions, dict(zip(conditions, measured, strict=True))).values()
    ] == names


def test_a_label_that_states_its_measurements_stays():
    """An author's label may have the words already."""
    measured = {"a": ["contacts", "walk_contacts"], "b": ["contacts"]}

    names = series_names({"a": "joint / walk contacts", "b": "joint"}, measured)

    assert [*names.values()] == ["joint / walk contacts", "joint / final contacts"]


@pytest.fixture
def unlike_run(tmp_path):
    """A run of two conditions with unlike measurements."""
    rows = [
        ["0-joint", "joint", "20, joint", "20", "done", "contacts, walk_contacts", 0.9, 0.1, True],
        ["0-a", "a", "20, a", "20", "done", "contacts", 0.2, 0.0, False],
        ["1-a", "a", "20, a", "20", "done", "contacts", 0.2, 0.0, False],
    ]
    header = "case,condition,series,point,status,measurements,sure_1R,sure_off_1R,converged"
    write_summary(tmp_path, f"{header},rmse_R", [[*row, 1.0] for row in rows])
    return load_run(tmp_path)


def test_sentences_cases_and_warnings_have_these_names(unlike_run):
    """The headline study set a method with walk contacts beside one without, and did not say so."""
    assert [*unlike_run.series] == ["20 / joint / walk contacts", "20 / a / final contacts"]
    assert unlike_run.cases[0].title == "20 / joint / walk contacts, seed 0"
    best = "20 / joint / walk contacts, the best of 2 series: 90 %"
    assert statement_of(unlike_run.summary).startswith(best)
    assert "all of a / final contacts" in warnings_of(unlike_run.summary)[0]
