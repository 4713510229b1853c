"""Errors are one short printable line, whatever the names and values in them."""

import pickle
from pathlib import Path

from tiswarm.base.errors import EnvironmentTroubleError, InputError


def test_what_a_terminal_obeys_is_escaped():
    """Neither a path nor a value starts a second line, or moves the cursor."""
    mistake = InputError("is \x1b[2J; mend it", path=Path("two\nlines.yaml"), line=3, key="a\tb")
    trouble = EnvironmentTroubleError("two\nlines: cannot be written")

    assert str(mistake) == r"two\nlines.yaml:3: a\tb: is \x1b[2J; mend it"
    assert str(trouble) == r"two\nlines: cannot be written"


def test_a_long_message_keeps_its_beginning_and_its_end():
    """The end says what to do."""
    problem = f"'{'x' * 5000}' is no number; write it like 7"
    mistake = InputError(problem, path=Path("a.yaml"), line=3, key="key")

    assert len(str(mistake)) == 1000
    assert str(mistake).startswith("a.yaml:3: key: 'xxx")
    assert str(mistake).endswith("x' is no number; write it like 7")


def test_an_error_comes_from_another_process_as_it_was():
    """Workers send their errors."""
    mistake = InputError("is bad; mend it", path=Path("two\nlines.yaml"), line=3, key="k" * 5000)

    copy = pickle.loads(pickle.dumps(mistake))  # noqa: S301 - our own bytes

    assert str(copy) == str(mistake)
    assert vars(copy) == vars(mistake)


def test_commands_name_options_where_functions_have_arguments():
    """Overrides are given by `--set`."""
    wrong = InputError("is unknown; use cpu", argument="arch")
    setting = InputError("is no number; write 7", argument="overrides", key="robots=x")
    line = InputError("is no number; write 7", path=Path("a.yaml"), line=3, key="robots")

    assert str(wrong) == "arch: is unknown; use cpu"
    assert str(wrong.as_option()) == "--arch: is unknown; use cpu"
    assert str(setting) == "overrides: robots=x: is no number; write 7"
    assert str(setting.as_option()) == "--set robots=x: is no number; write 7"
    assert str(line.as_option()) == str(line)
