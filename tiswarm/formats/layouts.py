"""How programs name the columns of a pose: one declaration for each, and nothing is guessed.

In a name, {} stands for the name of a robot, or for the path of a message that has the pose, and #
for a robot's number. A point stands for a point or a slash. Capitals do not matter.
"""

import re
from collections.abc import Mapping, Sequence
from functools import cache
from typing import NamedTuple

_QPOS = ("x", "y", "z", "qw", "qx", "qy", "qz")
"""Quantities of a free joint in MuJoCo's `qpos`."""

_MATRICES = {
    **{f"m{place}": f"m{place}" for place in range(9)},
    **{f"r{row}{column}": f"m{row}{column}" for row in range(3) for column in range(3)},
    **{f"r{row}{column}": f"m{row}{column}" for row in range(1, 4) for column in range(1, 4)},
}

_PLAIN = {
    **{name: name for name in (*"xyz", "qw", "qx", "qy", "qz", "roll", "pitch", "yaw")},
    **{name: name for name in ("rx", "ry", "rz", "ax", "ay", "az", "angle")},
    **_MATRICES,
}
"""Quantities by our own names."""


class Layout(NamedTuple):
    """Names of the columns of a pose."""

    program: str
    quantities: Mapping[str, str]  # by the names of their columns

    def read(self, name: str) -> tuple[str, str] | None:
        """Read a column's name: what {} or # stands for, and the quantity; None if it has none."""
        lowered = name.lower().replace("/", ".")
        for pattern, quantity in _patterns(self.program):
            match = pattern.fullmatch(lowered)
            if match is not None:
                body = match.groupdict().get("body", "")
                start = lowered.find(body) if body else 0
                return name[start : start + len(body)], quantity
        return None


def _axes(template: str, letters: str, quantity: str = "") -> dict[str, str]:
    """Quantities of axes, by names that have the letter of the axis at a star."""
    return {template.replace("*", letter): f"{quantity}{letter}" for letter in letters}


TABLES = (
    Layout("tiswarm", _PLAIN),
    Layout("tiswarm, all robots in a row", {f"{{}}.{name}": _PLAIN[name] for name in _PLAIN}),
    Layout("MATLAB", {f"{name}#": _PLAIN[name] for name in _QPOS}),
    Layout("TUM", {**_axes("t*", "xyz"), **_axes("q*", "wxyz", "q")}),
    Layout("EuRoC", {**_axes("p_rs_r_*", "xyz"), **_axes("q_rs_*", "wxyz", "q")}),
    Layout("MuJoCo", {**_axes("xpos_*", "xyz"), **_axes("xquat_*", "wxyz", "q")}),
    Layout("Unity", {**_axes("pos_*", "xyz"), **_axes("rot_*", "wxyz", "r")}),
    Layout(
        "CoppeliaSim",
        {**_axes("{}.p*", "xyz"), **{f"{{}}.{name}": name for name in ("alpha", "beta", "gamma")}},
    ),
    Layout(
        "ROS, Webots",
        {
            **_axes("{}position.*", "xyz"),
            **_axes("{}orientation.*", "wxyz", "q"),
            **_axes("{}translation.*", "xyz"),
            **_axes("{}rotation.*", "wxyz", "r"),
            "{}rotation.angle": "angle",
        },
    ),
)
"""Layouts of tables; the messages of ROS have paths before their fields."""

EXPORTS = {
    "Motive": Layout(
        "Motive", {**_axes("{}.position *", "xyz"), **_axes("{}.rotation *", "wxyz", "r")}
    ),
    "Qualisys": Layout(
        "Qualisys",
        {
            **_axes("{}.*", "xyz"),
            **{f"{{}}.{name}": name for name in ("roll", "pitch", "yaw")},
            **{f"{{}}.rot[{place}]": f"m{place}" for place in range(9)},
        },
    ),
    "Vicon": Layout("Vicon", {**_axes("{}.t*", "xyz"), **_axes("{}.r*", "wxyz", "r")}),
}
"""Layouts of exports of motion capture, once their heads are one line."""


@cache
def _patterns(program: str) -> Sequence[tuple[re.Pattern[str], str]]:
    """Compile the names of a layout."""
    layout = next(layout for layout in (*TABLES, *EXPORTS.values()) if layout.program == program)
    compiled = []
    for name, quantity in layout.quantities.items():
        pattern = re.escape(name).replace(r"\{\}", r"(?P<body>.*)").replace(r"\#", r"(?P<body>\d+)")
        compiled.append((re.compile(pattern), quantity))
    return compiled


def with_joints_named(name: str) -> str:
    """Name a number of MuJoCo's `qpos` by its robot and quantity: free joints follow one another.

    >>> with_joints_named("qpos[8]")
    '1.y'
    """
    match = re.fullmatch(r"(.*)qpos\W{0,2}(\d+)\]?", name, re.IGNORECASE)
    if match is None:
        return name
    robot, place = divmod(int(match[2]), len(_QPOS))
    return f"{match[1]}{robot}.{_QPOS[place]}"
