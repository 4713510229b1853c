"""Other code of a process: its kernels, forks, threads and interrupts neither suffer nor harm."""

import json

import pytest

from tests.devices import LIBRARIES, run_child
from tests.robustness.other_code import CALLS, SITUATIONS
from tests.runs import REPOSITORY
from tiswarm.records.sensing_file import write_sensing_log
from tiswarm.sensing import SensingParams, observe

QUICK = (
    "fields_before_the_first_call", "init_between_calls", "reset_between_calls",
    "fork_after_a_call", "first_calls_in_threads",
)  # fmt: skip

_EXPECT = """
import json, sys
from tests.robustness.other_code import CALLS, compute
print(json.dumps({name: compute(name, sys.argv[1]) for name in CALLS}))
"""
_ATTEMPT = "import sys; from tests.robustness.other_code import attempt; attempt(*sys.argv[1:])"


@pytest.fixture(scope="module")
def log(towers, tmp_path_factory):
    """Log of 30 robots."""
    path = tmp_path_factory.mktemp("log") / "sensing.jsonl"
    write_sensing_log(observe(towers[0], SensingParams()), path)
    return str(path)


@pytest.fixture(scope="module")
def expected(log):
    """Digests of what calls give where nothing else happens, by library and call."""
    return {name: json.loads(run_child(_EXPECT, log, TISWARM_BACKEND=name)) for name in LIBRARIES}


def _attempt(library, situation, call, log, expected, seed=0):
    digest = expected[library][call]
    said = run_child(_ATTEMPT, situation, call, log, digest, str(seed), TISWARM_BACKEND=library)
    return said.splitlines()[-1]  # libraries print, too


@pytest.mark.trial
@pytest.mark.parametrize("situation", QUICK)
def test_a_call_beside_other_code_is_right_or_refused(situation, log, expected):
    """It says in one line what to do, and ends no program of the user's."""
    _attempt(LIBRARIES[0], situation, "virtual-force", log, expected)


@pytest.mark.slow
def test_the_example_of_the_page_runs():
    """Processes that share the work, each with one thread."""
    page = (REPOSITORY / "docs" / "promises.md").read_text()
    code = page.partition("```python\n")[2].partition("```")[0]

    said = run_child(code + "\n    print(len(estimates), estimates[0].position.shape[1])")

    assert said == "2 3\n"


@pytest.mark.slow
def test_calls_beside_other_code(trial, log, expected):
    """Every situation with calls at random, on each library that is installed."""
    names = list(SITUATIONS)
    for number in trial.numbers(45):
        random = trial.random(number)
        situation, call = names[number % len(names)], random.choice(CALLS)
        library = random.choice(LIBRARIES)
        with trial.attempt(number, what=f"{situation}, {call}, {library}"):
            outcome = _attempt(library, situation, call, log, expected, seed=number)
            trial.outcomes[outcome] += 1

    assert trial.failures == []
