"""Constants of `joint` are frozen, each with its unit; cues in settings are those of the table."""

import ast
import dataclasses
import inspect
import itertools
import re

import pytest

from tiswarm.localization import mixture
from tiswarm.localization.chains.views import AnnealSchedule
from tiswarm.localization.settings import Cues, CuesOfNamedDocks
from tiswarm.measurements.cues import CUES

CLASSES = [AnnealSchedule, *filter(inspect.isclass, vars(mixture).values())]


@pytest.mark.parametrize("kind", CLASSES)
def test_settings_are_frozen_and_state_units(kind):
    """A reader can judge a constant by its docstring, and no code changes it."""
    body = ast.parse(inspect.getsource(kind)).body[0].body
    texts = {
        field.target.id: after.value.value
        for field, after in itertools.pairwise(body)
        if isinstance(field, ast.AnnAssign) and isinstance(after, ast.Expr)
    }

    with pytest.raises(dataclasses.FrozenInstanceError):
        setattr(kind(), next(iter(texts)), 0.0)
    assert [*texts] == [field.name for field in dataclasses.fields(kind)]
    assert [name for name, text in texts.items() if not re.search(r"\[[^\]]+\]", text)] == []
    assert re.search("[Cc]hosen|[Ff]itted", kind.__doc__)


def test_settings_have_a_switch_for_each_cue_that_has_one():
    """The fields are those cues of the table, all on; methods that find no docks lack the rest."""
    switches = dataclasses.asdict(Cues())
    of_named_docks = dataclasses.asdict(CuesOfNamedDocks())

    assert {*switches} == {cue.name for cue in CUES if cue.has_switch}
    assert {*switches.values()} == {True}
    assert [*of_named_docks] == [*switches]
    off = {name for name, is_on in of_named_docks.items() if not is_on}
    assert off == {cue.name for cue in CUES if not cue.names_docks}
