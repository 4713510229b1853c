"""Tables of ranges and beacons become a log, and a page, in one command."""

import numpy as np
import pytest

from tests.foreign import ROOM, apart
from tiswarm.base.errors import InputError
from tiswarm.formats.imports import convert

BEACONS = np.vstack([ROOM, [3.0, 2.5, 2.0]])
TAGS = apart(np.random.default_rng(7), [1.0, 1.0, 0.3], [5.0, 4.0, 1.5], 4)
SD = 0.05


def measured(readings, *, seed=0, late=None):
    """Rows of (tag, beacon, range [m]), the readings of all pairs in turn."""
    rng = np.random.default_rng(seed)
    return [
        (
            f"T{i}",
            f"A{k}",
            np.linalg.norm(tag - beacon) + rng.normal(0.0, SD) + (late or {}).get(k, 0),
        )
        for _ in range(readings)
        for i, tag in enumerate(TAGS)
        for k, beacon in enumerate(BEACONS)
    ]


def tables(
    folder, rows, *, head="tag,beacon,range [m]", beacons="beacon,x [m],y [m],z [m]", more=""
):
    """Write both tables; returns their paths."""
    text = "".join(f"{','.join(map(str, row))}\n" for row in rows)
    (folder / "ranges.csv").write_text(f"{head}\n{text}")
    places = "".join(f"A{k},{x},{y},{z}{more}\n" for k, (x, y, z) in enumerate(BEACONS.tolist()))
    (folder / "beacons.csv").write_text(f"{beacons}\n{places}")
    return folder / "ranges.csv", folder / "beacons.csv"


def bring_in(folder, rows, assumed=None, **layout):
    """Import ranges."""
    path, beacons = tables(folder, rows, **layout)
    return convert(path, {"beacons": beacons, **(assumed or {})})[""]


def test_repeated_readings_state_their_scatter(tmp_path):
    """A pair counts once, by its median; single far readings change nothing."""
    rows = measured(25)
    rows[7] = (*rows[7][:2], 40.0)

    found = bring_in(tmp_path, rows)

    log = found.log
    assert (log.robot_count, len(log.ranges), log.length_unit) == (9, 20, "m")
    # The mean of 20 median deviations of 25 readings errs by 6 %.
    assert np.unique(log.ranges[:, 3]).min() == pytest.approx(SD, rel=0.25)
    true = np.linalg.norm(TAGS[:, None] - BEACONS, axis=2)
    assert np.abs(log.ranges[:, 2].reshape(4, 5) - true).max() < 5.0 * SD * 1.25 / 5.0
    np.testing.assert_array_equal(log.dock_offset_body, [[0.0, 0.0, 0.0]])
    assert found.warnings == []
    assert any("medians" in note or "the median of each pair" in note for note in found.notes)


def test_stated_deviations_keep_all_readings(tmp_path):
    """Each enters as it is; those of an option count where a column has none."""
    rows = [(*row, 0.07) for row in measured(3)]

    by_column = bring_in(tmp_path, rows, head="tag,beacon,range [m],sd").log
    by_option = bring_in(tmp_path, measured(3), {"range_sd": 0.07}).log

    assert len(by_column.ranges) == len(by_option.ranges) == 60
    np.testing.assert_array_equal(by_column.ranges, by_option.ranges)
    assert (by_column.ranges[:, 3] == 0.07).all()


@pytest.mark.parametrize("head", ["time,tag,{}", "time;id;{}", "node;{}"])
def test_ranges_to_all_beacons_in_a_row_are_the_same(tmp_path, head):
    """Columns are named after beacons; empty cells and zeros are no ranges."""
    long = bring_in(tmp_path, measured(5), {"range_sd": 0.05}).log
    separator = ";" if ";" in head else ","
    names = separator.join(f"range_A{k} [m]" for k in range(5))
    lines, readings = [], np.array([row[2] for row in measured(5)]).reshape(-1, 5)
    for number, row in enumerate(readings.tolist()):
        cells = [f"T{number % 4}", *map(repr, row)]
        lines.append(separator.join(["1"] * ("time" in head) + cells))
    lost = separator.join(["1"] * ("time" in head) + ["T1", "", "0", "", "0", "nan"])

    path, beacons = tables(tmp_path, [])
    path.write_text("\n".join([head.format(names), *lines, lost]) + "\n")
    wide = convert(path, {"beacons": beacons, "range_sd": 0.05})[""]

    np.testing.assert_array_equal(wide.log.ranges, long.ranges)
    assert "5 ranges left out: empty, 0, or between two beacons" in wide.notes


def test_biases_of_beacons_are_taken_off_and_shared(tmp_path):
    """What is known is subtracted; what is not known is an error that all its ranges share."""
    rows = measured(2, late={2: 0.3})
    path, beacons = tables(tmp_path, rows)
    lines = beacons.read_text().splitlines()
    lines = [
        f"{line},{0.3 if k == 3 else 0},{0.02 if k == 3 else 0}" for k, line in enumerate(lines)
    ]
    lines[0] = "beacon,x [m],y [m],z [m],bias,bias_sd"
    beacons.write_text("\n".join(lines) + "\n")

    log = convert(path, {"beacons": beacons, "range_sd": SD})[""].log

    plain = bring_in(tmp_path, measured(2), {"range_sd": SD}).log
    assert log.source_name == ("beacon A2",)
    assert log.source_sd.tolist() == [0.02]
    np.testing.assert_allclose(log.ranges[:, :4], plain.ranges[:, :4], atol=1e-12)
    assert {*log.ranges[log.ranges[:, 1] == 2, 4]} == {0.0}
    assert {*log.ranges[log.ranges[:, 1] != 2, 4]} == {-1.0}


def test_the_anchor_is_the_beacon_that_is_known_best(tmp_path):
    """Others have the stated deviation of their places; tags range to each other, too."""
    rows = [*measured(1), ("T0", "T3", float(np.linalg.norm(TAGS[0] - TAGS[3])))]
    path, beacons = tables(tmp_path, rows, beacons="beacon,x,y,z,sd", more=",0.02")
    beacons.write_text(beacons.read_text().replace("A3,0.0,5.0,2.5,0.02", "A3,0.0,5.0,2.5,0.001"))

    found = convert(path, {"beacons": beacons, "range_sd": SD})[""]

    np.testing.assert_array_equal(found.log.anchor_position, BEACONS[3])
    assert {*found.log.fixes[:, 5]} == {0.02}
    assert len(found.log.ranges) == 21
    assert (
        "robots are numbered: A3 is 4, A0 is 5, A1 is 6, A2 is 7, A4 is 8 and 4 more" in found.notes
    )


def test_readings_of_robots_that_moved_are_named(tmp_path):
    """One pair scatters far more than others."""
    rows = [
        (tag, beacon, value + 0.1 * (number // 20) * ((tag, beacon) == ("T1", "A4")))
        for number, (tag, beacon, value) in enumerate(measured(25))
    ]

    (warning,) = bring_in(tmp_path, rows).warnings

    assert warning.startswith("readings scatter far more than others: T1 to A4; robots moved")


MALFORMED = {
    "no sd": (measured(1), {}, {}, "ranges.csv:1: nothing states how exact ranges are, and no rep"),
    "no beacon": (
        [("T1", 3.0)], {"head": "tag,range"}, {},
        "ranges.csv:1: the columns are tag,range, neither tag,beacon,range nor tag and names of",
    ),
    "units": (
        measured(3), {"head": "tag,beacon,range [mm]"}, {},
        "ranges.csv:1: ranges are in mm, beacons in m; convert them to one unit",
    ),
    "a gap": (
        [*measured(1), ("T1", "A1", "")], {}, {},
        "ranges.csv:22: 1 incomplete row, empty or NaN: line 22; complete them, or drop them with",
    ),
    "itself": ([("T1", "T1", 2.0)], {}, {}, "ranges.csv:2: 'T1' has a range to itself; name"),
    "no tags": ([("A1", "A2", 6.0)], {}, {}, "ranges.csv:2: there are no ranges of tags; add some"),
    "words": ([("T1", "A2", "far")], {}, {}, "ranges.csv:2: range [m]: 'far' is not a"),
    "a negative sd": (
        [("T1", "A2", 2.0, -1.0)], {"head": "tag,beacon,range [m],sd"}, {},
        "ranges.csv:2: sd: -1 is no standard deviation; write a positive one",
    ),
    "axes": (
        measured(1), {"beacons": "beacon,x [m],y [mm],z [m]"}, {},
        "beacons.csv:1: the axes have different units: m, mm; convert them to one",
    ),
    "no places": (
        measured(1), {"beacons": "beacon,a,b,c"}, {},
        "beacons.csv:1: the columns are beacon,a,b,c, not beacon,x,y,z; add x,y,z",
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", MALFORMED)
def test_malformed_ranges_are_refused_in_a_line(tmp_path, name):
    """The line has file, number, and what to do."""
    rows, layout, assumed, problem = MALFORMED[name]

    with pytest.raises(InputError) as refusal:
        bring_in(tmp_path, rows, assumed, **layout)

    assert problem in str(refusal.value)


def test_a_beacon_twice_is_refused(tmp_path):
    """Its places may differ."""
    path, beacons = tables(tmp_path, measured(1))
    beacons.write_text(beacons.read_text() + "A0,1,1,1\n")

    with pytest.raises(InputError, match=r"beacons.csv:7: beacon: beacon A0 has a row already"):
        convert(path, {"beacons": beacons})


def test_one_command_leads_to_a_page(tmp_path, tiswarm):
    """Tags are where they are within what the estimate says; a refusal writes nothing."""
    path, beacons = tables(tmp_path, measured(20))
    out = tmp_path / "room"

    lost = tiswarm("import", path, "--beacons", tmp_path / "none.csv", "--out", out)
    done = tiswarm(
        "import", path, "--beacons", beacons, "--out", out, "--report", out / "view.html"
    )

    assert (lost.returncode, done.returncode) == (2, 0), done.stderr
    assert "none.csv: there is no such file; check the path" in lost.stderr
    assert " of where they are shown (95 %)" in done.stdout
    assert "not converged" not in done.stdout
    assert (out / "view.html").stat().st_size > 10_000
    assert not (out / "truth.csv").exists()
    table = np.genfromtxt(
        out / "estimate.csv", delimiter=",", skip_header=1, usecols=[0, 1, 2, 3, 4]
    )
    tags = table[table[:, 0] < 4]
    off = np.linalg.norm(tags[tags[:, 0].argsort(), 1:4] - TAGS, axis=1)
    assert (off < 4.0 * tags[:, 4]).all()
