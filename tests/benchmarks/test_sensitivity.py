"""Tables of sensitivities say what was tried, and stand on a page."""

import pandas as pd

from benchmarks.sensitivity import BEGIN, END, Number, rows_of, write_page


def test_a_number_without_a_double_is_not_tried():
    """Zero has no half and no double; its row says nothing of bytes."""
    zero = Number(group="A", name="zero", value=0.0, call=lambda value, use: use(value))
    one = Number(group="A", name="one", value=1.0, call=lambda value, use: use(value))

    rows = list(rows_of([zero, one], lambda value: {"bytes": "other", "tried": value}))

    assert [row["bytes"] for row in rows] == ["", "", "other", "other"]
    assert [row["tried"] for row in rows] == [0.0, 0.0, 0.5, 2.0]


def test_a_page_has_the_tables_and_keeps_its_text(tmp_path):
    """What a number changes, or why it changes nothing, stands at half and at twice its value."""
    common = {"group": "A", "name": "one", "value": 1.0, "rmse_percent": 2.0, "sd_percent": -3.0}
    rows = [
        {**common, "factor": 0.5, "bytes": "other"},
        {**common, "factor": 2.0, "bytes": "same"},
    ]
    pd.DataFrame(rows).to_csv(tmp_path / "sensitivity-joint.csv", index=False)
    page = tmp_path / "page.md"
    page.write_text(f"Before.\n{BEGIN}\nold\n{END}\nAfter.\n")

    write_page(page, tmp_path)

    text = page.read_text()
    assert "| `A.one` | 1 | +2.0, -3.0 | same bytes |" in text
    assert "old" not in text
    assert text.startswith("Before.")
    assert text.endswith("After.\n")
