"""Folders and manifest of a run: damage and links are refused in one line."""

import pytest

from tiswarm.base.errors import InputError
from tiswarm.records.run_folder import check_folders, read_manifest


@pytest.mark.parametrize(
    "text",
    [
        '{"tiswarm": "0.1',
        "[]",
        "null",
        '{"stages": 5}',
        '{"machine": [1]}',
        '{"stages": {"grow": {"wall_s": NaN, "cpu_s": 1.0}}}',
        '{"renders": {"structure.png": {}}}',
        "[" * 100_000,
    ],
)
def test_a_damaged_manifest_is_refused(tmp_path, text):
    """The message names the file and the way to restore it."""
    (tmp_path / "manifest.json").write_text(text)

    with pytest.raises(InputError, match=r"manifest\.json: is damaged; run the scenario again"):
        read_manifest(tmp_path)


def test_a_manifest_of_another_version_is_read(tmp_path):
    """Entries may be missing or unknown, and so may be the file."""
    (tmp_path / "manifest.json").write_text('{"python": "3.99", "colour": 1}')

    assert read_manifest(tmp_path).python == "3.99"
    assert not read_manifest(tmp_path / "nowhere").tiswarm


@pytest.mark.parametrize("name", ["cases", "structures", "figures", "renders", "export"])
def test_links_in_place_of_folders_are_refused(tmp_path, name):
    """A link, a dangling link and a file are named; the run folder itself may be a link."""
    run, other = tmp_path / "run", tmp_path / "other"
    (run / name).mkdir(parents=True)
    other.symlink_to(run)
    check_folders(other)
    (run / name).rmdir()

    for target in (tmp_path, tmp_path / "nowhere"):
        (run / name).symlink_to(target)
        with pytest.raises(InputError, match=f"{name}: is a link or a file .* remove it"):
            check_folders(run)
        (run / name).unlink()
    (run / name).touch()
    with pytest.raises(InputError, match=f"{name}: is a link or a file"):
        check_folders(run)
