"""Mutations of the shipped scenarios are read, or refused in one line that names the place."""

import re

import pytest
import yaml

from tests.robustness.mutations import damaged, mutated
from tests.runs import REPOSITORY
from tiswarm.base.errors import InputError
from tiswarm.scenario.expansion import load_scenario
from tiswarm.scenario.yaml_source import read_yaml

pytestmark = pytest.mark.slow

SHIPPED = sorted((REPOSITORY / "scenarios").glob("*.yaml"))


def write_mutant(random, path):
    """Write a scenario with up to three mistakes in its values and keys, or one in its bytes."""
    shipped = random.choice(SHIPPED)
    if random.random() < 0.4:
        path.write_bytes(damaged(random, shipped.read_bytes()))
        return
    data = read_yaml(shipped).data
    for _ in range(random.randint(1, 3)):
        data = mutated(random, data)
    path.write_text(yaml.safe_dump(data, sort_keys=False))


def assert_one_line(message, path):
    """Check that a message is one short printable line that names the file, and the line in it."""
    place, said = message[: len(str(path))], message[len(str(path)) :]
    assert place == str(path)
    assert re.match(r":\d+: |: the file is larger than 256 KiB", said), said
    assert said.isprintable(), said
    assert len(message) <= 1000, said


def test_malformed_scenarios_are_refused_by_the_loader(trial, tmp_path):
    """A mistake is an InputError; nothing else is raised and nothing is written."""
    path = tmp_path / "scenario.yaml"
    for number in trial.numbers(2000):
        write_mutant(trial.random(number), path)
        with trial.attempt(number, path):
            try:
                load_scenario(path)
            except InputError as mistake:
                assert_one_line(str(mistake), path)
                trial.outcomes["refused"] += 1
            else:
                trial.outcomes["read"] += 1
        assert [*tmp_path.iterdir()] == [path]

    assert trial.failures == []
    assert set(trial.outcomes) == {"refused", "read"}


def test_malformed_scenarios_are_refused_by_the_command(trial, tmp_path, tiswarm):
    """The command says on standard error what the loader raises, ends with 2 and writes nothing."""
    path = tmp_path / "scenario.yaml"
    number = 0
    for _ in trial.numbers(50):
        refusal = None
        while refusal is None:  # a valid mutant would be computed
            number += 1
            write_mutant(trial.random(number), path)
            try:
                load_scenario(path)
            except InputError as mistake:
                refusal = str(mistake)
        with trial.attempt(number, path):
            done = tiswarm("run", path, "--out", tmp_path / "out")
            assert done.stderr == f"tiswarm: error: {refusal}\n"
            assert (done.returncode, done.stdout) == (2, "")
            assert [*tmp_path.iterdir()] == [path]
            trial.outcomes["refused"] += 1

    assert trial.failures == []
