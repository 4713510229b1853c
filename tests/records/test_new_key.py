"""A stranger adds a key, a cue and its switch, each in one place; all else follows."""

import json
import shutil
import subprocess
import sys

import pytest

from tests.runs import REPOSITORY

FIELD = '''    echoes: Reals = _listed("robot", "distance", "sd", version=2, meaning="By sound.")
    """Distances by sound, rows of (robot or stance, other robot, distance, sd), shape (E, 4)."""


@dataclass(frozen=True, kw_only=True)
class Stances(Sensed):'''
CUE = """    Cue(
        name="echoes", rows=_echoes, key="echoes", item="echo of robot {other}",
        has_switch=True, words="distances by sound", said=13,
    ),
]  # fmt: skip
"""
SWITCH = """    echoes: Annotated[bool, Field(description="Distances by sound count.")] = True


@dataclass(frozen=True, kw_only=True, config=STRICT)
class CuesOfNamedDocks(Cues):"""
ROWS = """def _echoes(log, odometry, precision):
    stance, rows = _of_all_stances("echoes", log, odometry)
    other, center = odometry.final[rows[:, 0].astype(int)], np.full_like(stance, CENTER)
    length, sd = rows[:, 1:3].T / log.dock_radius
    return Distances.of(stance, center, other, center, length=length, sd=sd)


@dataclass(frozen=True, kw_only=True)
class Cue:"""
USE = """
import json, sys
from dataclasses import replace
from pathlib import Path
import numpy as np
from tiswarm.base.errors import InputError
from tiswarm.base.robot import RobotGeometry
from tiswarm.localization.methods import localize
from tiswarm.localization.settings import Cues, JointParams
from tiswarm.measurements.units import slips
from tiswarm.records.sensing_file import read_sensing_log, write_sensing_log
from tiswarm.records.sensing_format import line_schema
from tiswarm.report.series import measured_words
from tiswarm.sensing import SensingParams, observe
from tiswarm.world.growth import grow
from tiswarm.world.params import TowerParams

[history] = grow(TowerParams(), robots=8, seeds=[0], robot=RobotGeometry())
apart = np.linalg.norm(history.position[:, None] - history.position, axis=2)
rows = np.array([[j, i, apart[j, i], 0.05] for j in range(8) for i in range(j)])
path = Path("log.jsonl")
log = replace(observe(history, SensingParams(tilt_noise_deg=1.0)), echoes=rows)
write_sensing_log(log, path)
quick = JointParams(chains=2, steps=60, hold_steps=20)
params = [replace(quick, cues=Cues(echoes=on)) for on in (True, False)]
header, *robots = path.read_text().splitlines()
wrong = Path("wrong.jsonl")
wrong.write_text("\\n".join([header, robots[0], robots[1].replace(f"{apart[1, 0]}", "-1.0")]))
try:
    read_sensing_log(wrong)
except InputError as error:
    refused = str(error)
print(json.dumps({
    "same": bool((read_sensing_log(path).echoes == rows).all()),
    "version": json.loads(header)["version"],
    "schema": "By sound." in json.dumps(line_schema()),
    "refused": refused,
    "used": ["echoes" in localize(log, each).observability.cues for each in params],
    "slips": [slip.key for slip in slips(replace(log, echoes=rows * [1, 1, 1000, 1]))],
    "words": measured_words("echoes, contacts"),
}))
"""


def _changed(path, old, new):
    text = path.read_text()
    assert text.count(old) == 1
    path.write_text(text.replace(old, new))


@pytest.mark.trial
def test_a_key_a_cue_and_its_switch_are_an_edit_each(tmp_path):
    """Reader, writer, refusals, schema, settings, estimates, units and words take them."""
    shutil.copytree(REPOSITORY / "tiswarm", tmp_path / "tiswarm")
    log = tmp_path / "tiswarm/records/sensing_log.py"
    cues = tmp_path / "tiswarm/measurements/cues.py"
    settings = tmp_path / "tiswarm/localization/settings.py"
    head = "@dataclass(frozen=True, kw_only=True)\nclass "
    _changed(log, f"{head}Stances(Sensed):", FIELD)
    _changed(cues, f"{head}Cue:", ROWS)
    _changed(cues, "]  # fmt: skip\n", CUE)
    strict = "@dataclass(frozen=True, kw_only=True, config=STRICT)\nclass "
    _changed(settings, f"{strict}CuesOfNamedDocks(Cues):", SWITCH)

    done = subprocess.run(
        [sys.executable, "-c", USE], cwd=tmp_path, check=True, capture_output=True, text=True
    )

    assert json.loads(done.stdout.splitlines()[-1]) == {
        "same": True,
        "version": 2,
        "schema": True,
        "refused": "wrong.jsonl:3: echoes[0]: the distance -1 should be positive; correct it",
        "used": [True, False],
        "slips": ["echoes"],
        "words": "final contacts and distances by sound",
    }
