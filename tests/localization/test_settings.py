"""Constants of `joint` are frozen, and each states its unit."""

import ast
import dataclasses
import inspect
import itertools
import re

import pytest

from tiswarm.localization import mixture
from tiswarm.localization.chains.views import AnnealSchedule

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
