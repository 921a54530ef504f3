"""Files written whole or not at all: modes and links kept, what is protected refused, paths that are none."""

import os
import stat
from pathlib import Path

import pytest

from rotorjax import InputError, read_rig
from rotorjax.data.files import check_writable, write_whole
from rotorjax.data.measurement import Row
from rotorjax.data.recordings import open_recording
from rotorjax.data.table import write_table


@pytest.fixture
def umask():
    before = os.umask(0o027)
    yield
    os.umask(before)


def mode(path: Path) -> int:
    return stat.S_IMODE(path.stat().st_mode)


@pytest.mark.usefixtures("umask")
def test_a_file_keeps_its_mode_and_a_new_one_has_that_of_the_umask(tmp_path):
    private, new = tmp_path / "private.json", tmp_path / "new.json"
    private.write_text("before")
    for wanted in (0o600, 0o664):
        private.chmod(wanted)
        write_whole(private, "after")
        assert (private.read_text(), mode(private)) == ("after", wanted)
    write_whole(new, "after")
    assert mode(new) == 0o640
    assert sorted(tmp_path.iterdir()) == [new, private]


@pytest.mark.parametrize("write", [check_writable, lambda path: write_whole(path, "after")])
def test_what_is_protected_is_not_replaced(tmp_path, write):
    path = tmp_path / "mine.json"
    path.write_text("before")
    path.chmod(0o400)
    with pytest.raises(InputError, match=r"mine\.json: is protected against writing; choose another path"):
        write(path)
    assert (path.read_text(), mode(path)) == ("before", 0o400)


def test_a_link_stays_one(tmp_path):
    file, link = tmp_path / "file.json", tmp_path / "link.json"
    link.symlink_to("file.json")
    for text in ("made", "replaced"):
        write_whole(link, text)
        assert link.is_symlink()
        assert file.read_text() == text


@pytest.mark.parametrize("name", ["n" * 300, "zero\0byte", "circle"])
@pytest.mark.parametrize("use", [check_writable, lambda path: write_whole(path, ""), read_rig, open_recording])
def test_a_path_that_is_none_is_refused(tmp_path, name, use):
    (tmp_path / "circle").symlink_to("circle")
    with pytest.raises(InputError, match=r"; (choose another|give the) path"):
        use(tmp_path / name)


def test_a_name_may_be_as_long_as_the_system_allows(tmp_path):
    check_writable(tmp_path / ("n" * 255))
    write_whole(tmp_path / ("n" * 255), "")


def test_rows_that_would_be_written_alike_are_refused(tmp_path):
    rows = [Row("baseline", speed, "X", 1.0, 1.0, 0.0) for speed in (1000.0, 1000.0000001)]
    with pytest.raises(
        InputError, match=r"s\.csv: run 'baseline', probe 'X' would have two rows of 1000 rpm and order 1"
    ):
        write_table(tmp_path / "s.csv", rows)
    assert not list(tmp_path.iterdir())
