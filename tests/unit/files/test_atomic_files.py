"""Results under their name only when they are whole."""

import errno
import os
import platform
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from telenano.files.atomic_files import atomic_file, new_folder, whole_folder, whole_results


class _Stop(BaseException):
    pass


def names(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


def ended_process() -> int:
    process = subprocess.Popen([sys.executable, "-c", ""])
    process.wait()
    return process.pid


def test_a_file_has_its_name_when_it_is_whole_and_keeps_the_one_before_until_then(tmp_path: Path) -> None:
    path = tmp_path / "result.h5"
    with atomic_file(path, replace=False) as part:
        part.write_text("one")
        assert not path.exists()
        assert part.parent == tmp_path
        assert part.name.startswith(".result.h5.")
    assert path.read_text() == "one"
    with pytest.raises(_Stop), atomic_file(path) as part:
        part.write_text("two")
        raise _Stop
    assert (path.read_text(), names(tmp_path)) == ("one", ["result.h5"])
    with atomic_file(path) as part:
        part.write_text("three")
    assert (path.read_text(), names(tmp_path)) == ("three", ["result.h5"])


def test_what_exists_is_not_replaced_also_when_it_came_meanwhile(tmp_path: Path) -> None:
    path = tmp_path / "result"
    with pytest.raises(FileExistsError), atomic_file(path, replace=False) as part:
        part.write_text("mine")
        path.write_text("theirs")
    assert (path.read_text(), names(tmp_path)) == ("theirs", ["result"])
    with pytest.raises(FileExistsError), atomic_file(path, replace=False):
        pytest.fail("it is known before anything is written")
    with pytest.raises(FileExistsError), whole_folder(path):
        pytest.fail("it is known before anything is written")
    assert path.read_text() == "theirs"


def test_a_folder_has_its_name_when_all_of_it_is_there(tmp_path: Path) -> None:
    path = tmp_path / "deep" / "tables"
    with pytest.raises(_Stop), whole_folder(path) as part:
        (part / "a.csv").write_text("1")
        raise _Stop
    assert names(tmp_path / "deep") == []
    with whole_folder(path) as part:
        (part / "a.csv").write_text("1")
        assert not path.exists()
    assert names(tmp_path / "deep") == ["tables"]
    assert names(path) == ["a.csv"]


def test_results_replace_those_of_their_names_together_and_leave_all_else(tmp_path: Path) -> None:
    path = tmp_path / "out"
    with pytest.raises(_Stop), whole_results(path) as part:
        (part / "a").write_text("1")
        raise _Stop
    assert names(tmp_path) == []
    path.mkdir()
    (path / "a").write_text("0")
    (path / "journal.jsonl").write_text("kept")
    with pytest.raises(_Stop), whole_results(path) as part:
        (part / "a").write_text("1")
        raise _Stop
    assert ((path / "a").read_text(), names(path)) == ("0", ["a", "journal.jsonl"])
    with pytest.raises(FileExistsError), whole_results(path, replace=False) as part:
        (part / "0").write_text("1")
        (part / "a").write_text("1")
    assert names(path) == ["a", "journal.jsonl"]
    with whole_results(path) as part:
        (part / "a").write_text("1")
        (part / "b").write_text("2")
    assert ((path / "a").read_text(), names(path)) == ("1", ["a", "b", "journal.jsonl"])


def test_what_a_process_that_is_no_more_left_goes_and_what_others_write_stays(tmp_path: Path) -> None:
    machine = "".join(letter if letter.isalnum() or letter in "_-" else "_" for letter in platform.node())
    (tmp_path / f".result.{machine}.{ended_process()}.part").write_text("half")
    folder = tmp_path / f".result.{machine}.{ended_process()}.part"
    if folder.exists():
        folder.unlink()
    folder.mkdir()
    (folder / "half").write_text("half")
    others = [f".result.{machine}.{os.getppid()}.part", f".result.elsewhere.{ended_process()}.part", ".result.x.part"]
    for other in others:
        (tmp_path / other).write_text("theirs")
    with atomic_file(tmp_path / "result") as part:
        part.write_text("mine")
    assert names(tmp_path) == sorted([*others, "result"])


def test_an_error_names_the_result_and_not_its_temporary_name(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError) as found, whole_results(tmp_path / "out") as part:
        (part / "deep" / "a").write_text("1")
    assert found.value.filename == str(tmp_path / "out" / "deep" / "a")
    with pytest.raises(NotADirectoryError) as other, atomic_file(tmp_path / "b") as part:
        part.write_text("")
        (part / "c").write_text("")
    assert other.value.filename == str(tmp_path / "b" / "c")
    assert names(tmp_path) == []


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no /dev/full here")
@pytest.mark.parametrize("writing", [atomic_file, whole_folder, whole_results])
def test_a_write_that_has_no_room_names_the_result(writing: Any, tmp_path: Path) -> None:
    """The system names what cannot be opened, and not what cannot be written."""
    full = os.open("/dev/full", os.O_WRONLY)
    with pytest.raises(OSError, match="No space left") as refused, writing(tmp_path / "result"):
        os.write(full, b"x")
    assert refused.value.filename == str(tmp_path / "result")
    with pytest.raises(OSError, match="refused") as refused, writing(tmp_path / "result"):
        raise ConnectionRefusedError(errno.ECONNREFUSED, "refused")
    os.close(full)
    assert refused.value.filename is None


def test_a_device_is_written_to_and_not_replaced_and_a_link_is_followed(tmp_path: Path) -> None:
    with atomic_file(Path(os.devnull)) as part:
        part.write_text("gone")
    assert not Path(os.devnull).is_file()
    (tmp_path / "link").symlink_to(tmp_path / "target")
    (tmp_path / "target").write_text("0")
    with atomic_file(tmp_path / "link") as part:
        part.write_text("1")
    assert (tmp_path / "link").is_symlink()
    assert (tmp_path / "target").read_text() == "1"


def test_a_long_name_has_a_temporary_name_too(tmp_path: Path) -> None:
    path = tmp_path / ("ä" * 120 + ".h5")
    with atomic_file(path) as part:
        part.write_text("1")
    assert path.read_text() == "1"


def test_a_new_folder_goes_if_nothing_came_to_be_in_it(tmp_path: Path) -> None:
    with new_folder(tmp_path / "a"):
        assert (tmp_path / "a").is_dir()
    with new_folder(tmp_path / "b"):
        (tmp_path / "b" / "c").write_text("")
    (tmp_path / "d").mkdir()
    with new_folder(tmp_path / "d"):
        pass
    assert names(tmp_path) == ["b", "d"]
