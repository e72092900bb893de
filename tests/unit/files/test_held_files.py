"""Files that are held for a process: whatever becomes of them, it reads what they were."""

import os
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from telenano.files.held_files import HeldFiles
from telenano.files.regular_files import open_regular
from telenano.signals import children

# Reads a file by each of the ways there are, and says what it found.
READER = """
import sys
from pathlib import Path
from telenano.files.held_files import is_held, listed, receive, standing
from telenano.files.regular_files import read_regular
receive(int(sys.argv[1]))
path = Path(sys.argv[2])
try:
    found = [read_regular(path, 1000), standing(path).read_bytes(), str(standing(path).name).encode()]
except OSError as error:
    found = [type(error).__name__.encode()]
found += [str(is_held(path)).encode(), ",".join(each.name for each in listed(path.parent, ".yaml")).encode()]
sys.stdout.buffer.write(b"|".join(found))
"""


def removed(path: Path) -> None:
    path.unlink()


def removed_with_its_folder(path: Path) -> None:
    shutil.rmtree(path.parent)


def written_anew(path: Path) -> None:
    path.unlink()
    path.write_bytes(b"another one")


def a_folder_now(path: Path) -> None:
    path.unlink()
    path.mkdir()


def a_pipe_now(path: Path) -> None:
    path.unlink()
    os.mkfifo(path)


def moved(path: Path) -> None:
    path.rename(path.with_suffix(".old"))


def left(path: Path) -> None:
    """Leave it as it is."""


CHANGES = (left, removed, removed_with_its_folder, moved, written_anew, a_folder_now, a_pipe_now)
GONE = (removed, removed_with_its_folder, moved)


def read_by_another(held: HeldFiles, path: Path) -> list[bytes]:
    command = [sys.executable, "-c", READER, str(held.table), str(path)]
    done = children.run(command, stdout=subprocess.PIPE, pass_fds=held.descriptors, check=True, timeout=60.0)
    return bytes(done.stdout).split(b"|")


@pytest.mark.parametrize("change", CHANGES)
def test_what_is_held_is_read_in_place_of_the_file_whatever_becomes_of_it(
    tmp_path: Path, change: Callable[[Path], None]
) -> None:
    path = tmp_path / "folder" / "site.yaml"
    path.parent.mkdir()
    path.write_bytes(b"as it was")
    held = HeldFiles()
    held.keep(path, b"as it was checked")
    change(path)
    assert read_by_another(held, path)[:4] == [b"as it was checked", b"as it was checked", b"site.yaml", b"True"]
    held.close()


@pytest.mark.parametrize("in_memory", [False, True])
@pytest.mark.parametrize("change", CHANGES)
def test_a_spare_is_read_where_the_file_is_gone_and_nowhere_else(
    tmp_path: Path, change: Callable[[Path], None], in_memory: bool
) -> None:
    path = tmp_path / "folder" / "dots.yaml"
    path.parent.mkdir()
    path.write_bytes(b"as it was")
    held = HeldFiles()
    if in_memory:
        held.keep(path, b"old", is_spare=True)
        # What is held may be renewed, as a list of keys is.
        held.keep(path, b"as it was", is_spare=True)
    else:
        with open_regular(path) as file:
            held.keep_spare(path, file)
    change(path)
    found = read_by_another(held, path)
    if change in GONE or change is left:
        expected = [b"as it was", b"as it was", b"dots.yaml", str(change in GONE).encode(), b"dots.yaml"]
    elif change is written_anew:
        expected = [b"another one", b"another one", b"dots.yaml", b"False", b"dots.yaml"]
    else:
        error = b"IsADirectoryError" if change is a_folder_now else b"NotRegularError"
        expected = [error, b"False", b"dots.yaml"]
    assert found == expected
    held.close()


def test_a_process_that_was_given_nothing_reads_the_files_and_what_is_let_go_is_closed(tmp_path: Path) -> None:
    path = tmp_path / "a.yaml"
    path.write_bytes(b"as it is")
    held = HeldFiles()
    held.keep(path, b"held for others")
    with open_regular(path) as file:
        assert file.read() == b"as it is"
    before = len(held.descriptors)
    held.keep(path, b"again")
    assert len(held.descriptors) == before
    descriptors = held.descriptors
    held.close()
    for descriptor in descriptors:
        with pytest.raises(OSError):
            os.fstat(descriptor)
