"""Tests of shared files: two processes that change a file at the same time, and a disk with room for some pages."""

import multiprocessing
import os
import subprocess
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import NamedTuple

from telenano.wire.errors import TelenanoError

_DISK_BYTES = 256 << 10
# Time after which two processes that wait for one another are given up [s].
_LONGEST_S = 60.0


@contextmanager
def disk_of(folder: Path, size: str | int) -> Iterator[Path]:
    """Mount a small disk at a folder, and yield it; skip the test if that is not possible."""
    folder.mkdir(exist_ok=True)
    mount = ["mount", "-t", "tmpfs", "-o", f"size={size},mode=700", "tmpfs", str(folder)]
    # Imported here because pytest is no requirement of the wheel.
    import pytest

    if os.geteuid() != 0 or subprocess.run(mount, capture_output=True, check=False).returncode != 0:
        pytest.skip("a disk of its own (tmpfs) cannot be mounted here: it needs root")
    try:
        yield folder
    finally:
        subprocess.run(["umount", "-l", str(folder)], check=True)


class Shared(NamedTuple):
    """A kind of shared file.

    `prepare(folder)` makes the initial file; `change(folder, who, round)` is the change by writer 0 or 1 in a round;
    `lost(folder, done)` returns the missing changes, given the successful rounds of each writer.
    """

    name: str
    prepare: Callable[[Path], object]
    change: Callable[[Path, int, int], object]
    lost: Callable[[Path, list[set[int]]], object]


def race(shared: Shared, folder: Path, rounds: int) -> list[set[int]]:
    """Let two processes change a file at the same time in each round; return the rounds in which each succeeded."""
    context = multiprocessing.get_context("fork")
    barrier, answers = context.Barrier(2), context.SimpleQueue()

    def write(who: int) -> None:
        done = []
        for number in range(rounds):
            barrier.wait(_LONGEST_S)
            try:
                shared.change(folder, who, number)
                done.append(number)
            except TelenanoError:
                pass
        answers.put((who, done))

    writers = [context.Process(target=write, args=(who,), daemon=True) for who in (0, 1)]
    with warnings.catch_warnings():
        # Later Pythons warn of a fork beside threads; these children use none of them.
        warnings.simplefilter("ignore", DeprecationWarning)
        for writer in writers:
            writer.start()
    for writer in writers:
        writer.join(_LONGEST_S)
    assert [writer.exitcode for writer in writers] == [0, 0]
    found = dict(answers.get() for _ in writers)
    return [set(found[0]), set(found[1])]


@contextmanager
def small_disk(folder: Path) -> Iterator[Callable[[int], None]]:
    """Mount a small disk at a folder; yield a function that fills it up to a number of free pages."""
    filler, page = folder / "filler", os.sysconf("SC_PAGE_SIZE")

    def leave(pages: int) -> None:
        filler.unlink(missing_ok=True)
        found = os.statvfs(folder)
        filler.write_bytes(bytes(max(0, found.f_bavail * found.f_frsize - pages * page)))

    with disk_of(folder, _DISK_BYTES):
        yield leave


class SharedFiles:
    """Tests of shared files, for a test class with the parameter `shared`; `rounds`: number of rounds of a race."""

    rounds = 12

    def test_no_change_of_two_processes_is_lost(self, shared: Shared, tmp_path: Path) -> None:
        tmp_path.chmod(0o700)
        shared.prepare(tmp_path)
        done = race(shared, tmp_path, self.rounds)
        assert done[0] | done[1] == set(range(self.rounds))
        assert not shared.lost(tmp_path, done)

    def test_a_full_disk_is_a_sentence_with_the_path_and_leaves_the_file_as_it_was(
        self, shared: Shared, tmp_path: Path
    ) -> None:
        assert fill_at_each_write(shared, tmp_path / "disk") > 0


def fill_at_each_write(shared: Shared, disk: Path) -> int:
    """Change a file while 0, 1, 2 … pages of the disk are free; return the number of refusals.

    Each refusal must be an error of the project that names a path on the disk, and must leave the file unchanged.
    """
    refused = 0
    with small_disk(disk) as leave:
        shared.prepare(disk)
        done: list[set[int]] = [set(), set()]
        for pages in range(6):
            for who in (0, 1):
                leave(pages)
                number = 2 * pages + who
                try:
                    shared.change(disk, who, number)
                    done[who].add(number)
                except TelenanoError as error:
                    assert str(disk) in str(error) and "No space left on device" in str(error), error
                    refused += 1
        assert not shared.lost(disk, done)
        (disk / "filler").unlink()
        shared.change(disk, 0, 100)
        done[0].add(100)
        assert not shared.lost(disk, done)
        left = [path.name for path in disk.rglob("*") if path.name.endswith((".part", ".new"))]
        assert left == []
    return refused
