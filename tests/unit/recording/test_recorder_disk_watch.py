"""Free space against the rate of a recording, in virtual time."""

import errno
import os
from pathlib import Path
from types import SimpleNamespace

import pytest

from telenano.recording import disk_watch
from telenano.recording.disk_watch import LOW_BYTES, LOW_S, DiskWatch, free_bytes

SECOND_NS = 1_000_000_000
MEGABYTE = 1_000_000


class Disk:
    """A disk that a recording fills at a rate; `watch` looks at it every fifth of a second."""

    def __init__(self, free: int, bytes_per_s: int) -> None:
        self.free = free
        self.bytes_per_s = bytes_per_s
        self.looks = 0
        self.watch = DiskWatch(Path("/rec"), self._free)

    def _free(self, directory: Path) -> int:
        self.looks += 1
        assert directory == Path("/rec")
        return self.free

    def first_warning_s(self, length_s: int) -> float | None:
        total = self.free
        for tick in range(length_s * 5):
            written = tick * self.bytes_per_s // 5
            self.free = max(0, total - written)
            self.watch.check(tick * SECOND_NS // 5, written)
            if self.watch.text:
                return tick / 5
        return None


def test_it_looks_once_a_second_and_is_silent_where_there_is_room() -> None:
    disk = Disk(10_000 * MEGABYTE, MEGABYTE)
    assert disk.first_warning_s(60) is None
    assert disk.looks == 60


def test_it_warns_in_time_by_the_rate_of_this_recording() -> None:
    disk = Disk(500 * MEGABYTE, MEGABYTE)
    warned_s = disk.first_warning_s(1000)
    assert warned_s is not None
    assert 500 - LOW_S - 2 < warned_s <= 500 - LOW_S + 2
    assert disk.watch.text.startswith("the disk of /rec has 1")
    assert disk.watch.text.endswith(" s at 1.00 MB/s")


def test_almost_nothing_left_is_warned_of_at_once() -> None:
    disk = Disk(LOW_BYTES - 1, 0)
    assert disk.first_warning_s(1) == 0.0
    assert disk.watch.text == "the disk of /rec has 16.0 MB left"
    disk.free = LOW_BYTES
    disk.watch.check(10 * SECOND_NS, 0)
    assert disk.watch.text == ""


def test_the_space_of_a_folder_that_is_not_there_yet_is_that_of_its_parent(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[Path] = []

    def usage(path: Path) -> SimpleNamespace:
        asked.append(path)
        if not path.exists():
            raise FileNotFoundError(errno.ENOENT, os.strerror(errno.ENOENT))
        return SimpleNamespace(free=7)

    monkeypatch.setattr(disk_watch.shutil, "disk_usage", usage)
    assert free_bytes(tmp_path / "a" / "b") == 7
    assert asked[-1] == tmp_path


def test_a_disk_that_cannot_be_asked_is_no_reason_to_warn(monkeypatch: pytest.MonkeyPatch) -> None:
    def usage(path: Path) -> None:
        raise PermissionError(errno.EACCES, os.strerror(errno.EACCES))

    monkeypatch.setattr(disk_watch.shutil, "disk_usage", usage)
    watch = DiskWatch(Path("/rec"))
    watch.check(0, 0)
    assert watch.text == ""
