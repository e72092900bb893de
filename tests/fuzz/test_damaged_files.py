"""Files from strangers end in a sentence that names them, whatever is in them, within bounds of memory and time."""

import json
import os
import struct
import subprocess
import sys
import zlib
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import damaged_files as files
import numpy as np
import pytest

from telenano.testing import damaged, run_apart

Content = bytes | Callable[[Path], Any]
ROOT = Path(__file__).parents[2]
# a reader that hangs, on a machine that is at work with something else
_HANGS_S = 240.0
# this process has 60 MB of libraries and the child of a reader 40; what was reported took from 1 to 12.7 GB
_PEAK_MB, _PEAK_TIMES = 200, 10


def read_each(kind: str, paths: list[Path]) -> list[str]:
    """Return what came of reading each file in a process of its own, which stays within its bounds."""
    return read_within(kind, paths)[0]


def read_within(kind: str, paths: list[Path]) -> tuple[list[str], list[float]]:
    """Return what came of reading each file in a process within its bounds, and the processor time of each [s]."""
    done = subprocess.run(
        [sys.executable, files.__file__, kind, *map(str, paths)],
        env={**os.environ, "PYTHONPATH": str(ROOT)}, capture_output=True, text=True, timeout=_HANGS_S, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout)
    # pipes and devices have no size
    largest_mb = max(path.stat().st_size for path in paths) / 1e6
    assert max(found["peak_mb"]) < _PEAK_MB + _PEAK_TIMES * largest_mb, found["peak_mb"]
    return found["outcomes"], found["spent_s"]


def sentences_for(tmp_path: Path, given: Sequence[tuple[str, Content]]) -> list[str]:
    """Return the sentences with which files of one kind, by name and content, are refused, without their paths."""
    paths = []
    for number, (name, content) in enumerate(given):
        path = tmp_path / str(number) / name
        path.parent.mkdir()
        if callable(content):
            content(path)
        else:
            path.write_bytes(content)
        paths.append(path)
    said = []
    for path, outcome in zip(paths, read_each(given[0][0].partition(".")[0], paths), strict=True):
        assert outcome.startswith(f"{path}: ") and "\n" not in outcome, outcome
        said.append(outcome.removeprefix(f"{path}: "))
    return said


def with_number(content: bytes, place: int, number: int) -> bytes:
    changed = bytearray(content)
    struct.pack_into("<i", changed, place, number)
    return bytes(changed)


def write_unwritten(path: Path) -> None:
    """Write a column of a milliard points of which not one was ever written: 3 kB."""
    h5py = pytest.importorskip("h5py")
    files.write_hdf5(path)
    with h5py.File(path, "a") as file:
        group = file["0"]
        for name in ("force", "height (measured)", "segment"):
            del group[name]
            group.create_dataset(name, shape=(1_500_000_000,), dtype="f8", chunks=(1 << 20,))


MAPS: list[tuple[str, Content, str]] = [
    # 8.9 GB and 16 s
    ("map.ibw", with_number(files.map_wave(), 132, 1 << 28), "not a complete Igor binary wave: 268435456 x 8 x 1"),
    ("map.ibw", with_number(files.map_wave(), 76, 1 << 30), "it is not a complete Igor binary wave"),
    ("map.ibw", with_number(files.map_wave(), 12, 1 << 30), "its note, units and labels go beyond its"),
    # MemoryError, BadZipFile
    ("map.npy", files.npy_head((100_000, 100_000)), "has 0 bytes of heights; the shape (100000, 100000) with"),
    ("map.npy", files.npy_head((100_000, 100_000), "<f4") + b"1", "has 1 bytes of heights"),
    ("map.npy", files.npy_head((-1, -64)) + bytes(512), "has 512 bytes of heights"),
    ("map.npy", b"PK\x03\x04" + bytes(100), "magic string is not correct"),
    ("map.npy", files.npy_head((2, 2), "|O") + bytes(32), "holds no array of numbers"),
    # KeyError 'data', KeyError 'unitstr', ValueError, MemoryError, a loop without an end
    ("map.gwy", files.gwy(data=None), "is not a complete Gwyddion file: KeyError: 'data'"),
    ("map.gwy", files.gwy(si_unit_z=files.gwy_part("si_unit_z", "o", files.gwy_object("GwySIUnit"))),
     "the unit of the heights of channel Height is none"),
    ("map.gwy", files.gwy(xreal=files.gwy_part("xreal", "s", b"long\0")), "not a complete Gwyddion file: ValueError"),
    ("map.gwy", files.gwy(xres=files.gwy_part("xres", "i", struct.pack("<i", 1 << 30))), "(8,1073741824)"),
    ("map.gwy", files.gwy(data=files.gwy_part("data", "D", struct.pack("<I", 0xFFFFFFFF))), "complete Gwyddion file"),
    ("map.gwy", files.gwy()[:-1], "it must be one container of the length that it states"),
    ("map.gsf", files.gsf().replace(b"XRes = 8", b"XRes = 9"), "has 256 bytes of heights; 9 x 8 values of 4 bytes"),
    ("map.gsf", b"Gwyddion Simple Field 1.0\n" + b"a=b\n" * 100_000, "its header has no end"),
]  # fmt: skip
CURVES: list[tuple[str, Content, str]] = [
    ("curve.ibw", with_number(files.curve_wave(), 132, 1 << 28), "it is not a complete Igor binary wave"),
    # 12.7 GB and 40 s
    ("curve.h5", write_unwritten, "it cannot be read with 1536 MB of memory"),
]  # fmt: skip
SCENARIOS: list[tuple[str, Content, str]] = [
    # YAML: above 25 s, a traceback, a traceback
    ("scenario.yaml", b"a: &a [1,1,1,1,1,1,1,1,1]\n" + b"".join(
        b"%c: &%c [%s]\n" % (97 + n, 97 + n, b",".join([b"*%c" % (96 + n)] * 9)) for n in range(1, 9)),
     "it has more than 100000 values, each alias (*NAME) written out"),
    ("scenario.yaml", b"a: &a {x: 1, y: 1}\n" + b"".join(
        b"%c: &%c {<<: [*%c, *%c, *%c, *%c]}\n" % (97 + n, 97 + n, *([96 + n] * 4)) for n in range(1, 20)),
     "it has more than 100000 values, each alias (*NAME) written out"),
    ("scenario.yaml", b"a: " + b"9" * 5000, "the number in line 1 has 5000 characters, at most 100 are read"),
    ("scenario.yaml", b"a: 1" + b":1" * 5000, "is not a number of base 10"),
    ("scenario.yaml", b"a: 2026-02-45\n", "a value in it cannot be read: day is out of range"),
    ("scenario.yaml", b"a: !!int x\n", "a value in it cannot be read: invalid literal"),
    ("scenario.yaml", b"a: !!bool maybe\n", "a value in it cannot be read"),
    ("scenario.yaml", b"# " + b"x" * (1 << 19), "it has 524290 bytes, and at most 262144 are read"),
    ("scenario.yaml", b"a: &a {b: *a}\n", "the value in line 1 is part of itself"),
]  # fmt: skip


@pytest.mark.check("takes 2.1 s")
@pytest.mark.parametrize("cases", [MAPS, CURVES, SCENARIOS], ids=["maps", "curves", "scenarios"])
def test_a_file_that_asks_for_more_than_it_has_is_refused_in_a_sentence(
    tmp_path: Path, cases: list[tuple[str, Content, str]]
) -> None:
    if cases is CURVES:
        pytest.importorskip("h5py")
    found = sentences_for(tmp_path, [(name, content) for name, content, _ in cases])
    for (_, _, expected), said in zip(cases, found, strict=True):
        assert expected in said


def lz4_bomb() -> bytes:
    lz4 = pytest.importorskip("lz4.frame")
    size = 512 << 20
    return files.mcap(files.mcap_chunk("lz4", lz4.compress(bytes(size)), size))


@pytest.mark.check("takes 1.3 s")
def test_a_chunk_of_half_a_gigabyte_is_not_unpacked(tmp_path: Path) -> None:
    """28 s and 1.1 GB for `bag info`, more than 40 s for each of the others."""
    path = tmp_path / "session.mcap"
    path.write_bytes(lz4_bomb())
    assert read_each("session", [path]) == ["read"]
    done = run_apart("bag", "verify", str(path))
    assert done.returncode == 1
    assert "it unpacks to 536870912 bytes, at most 83886080 are read" in done.stdout


@pytest.mark.parametrize("compression", ["zstd", "lz4"])
@pytest.mark.parametrize("lie", [-1, 1, 1 << 40])
def test_a_chunk_that_states_another_size_is_damaged(tmp_path: Path, compression: str, lie: int) -> None:
    content = files.mcap_channel(1, "a") * 100
    if compression == "lz4":
        stored = pytest.importorskip("lz4.frame").compress(content)
    else:
        stored = pytest.importorskip("zstandard").ZstdCompressor(write_content_size=False).compress(content)
    from telenano.recording.reader import Recording

    path = tmp_path / "session.mcap"
    path.write_bytes(files.mcap(files.mcap_chunk(compression, stored, max(len(content) + lie, 0))))
    (damage,) = Recording(path).info().damage
    assert "the chunk cannot be decompressed" in damage or "inconsistent" in damage
    path.write_bytes(files.mcap(files.mcap_chunk(compression, stored, len(content))))
    assert Recording(path).info().damage == ()


def test_a_chunk_that_packs_to_nearly_nothing_is_not_unpacked(tmp_path: Path) -> None:
    from telenano.recording.reader import Recording

    size = 20 << 20
    stored = pytest.importorskip("zstandard").ZstdCompressor().compress(bytes(size))
    path = tmp_path / "session.mcap"
    path.write_bytes(files.mcap(files.mcap_chunk("zstd", stored, size)))
    (damage,) = Recording(path).info().damage
    assert f"{len(stored)} bytes unpack to {size}, at most 1000 times as many are read" in damage


def test_a_chunk_of_zeros_is_not_called_sound(tmp_path: Path) -> None:
    from telenano.recording.verify import verify

    path = tmp_path / "session.mcap"
    path.write_bytes(files.mcap(files.mcap_chunk("", bytes(900), 900)))
    found = verify([path])
    assert not found.sound
    assert any("ends with 900 bytes that are no records" in finding.text for finding in found.findings)


@pytest.mark.check("takes 2.4 s")
def test_three_hundred_thousand_channels_are_refused(tmp_path: Path) -> None:
    many = b"".join(files.mcap_channel(number, f"t{number}") for number in range(300_000))
    chunk = files.mcap_chunk("", many, len(many), zlib.crc32(many))
    given = [("session.mcap", found) for found in (files.mcap(many), files.mcap(chunk), files.mcap(summary=many))]
    said = "has more than 4096 channels and schemas, which no recording has"
    assert sentences_for(tmp_path, given) == 3 * [said]


@pytest.mark.check("takes 0.8 s")
def test_a_channel_that_is_repeated_counts_once(tmp_path: Path) -> None:
    from telenano.recording.reader import Recording

    path = tmp_path / "session.mcap"
    message = files.mcap_record(5, struct.pack("<HIQQ", 1, 0, 1, 1))
    path.write_bytes(files.mcap((files.mcap_channel(1, "a") + message) * 5000))
    assert Recording(path).info().messages == 5000


# --- what is no file ---


@pytest.mark.check("takes 1.3 s")
@pytest.mark.parametrize("kind", sorted(files.READ))
def test_a_pipe_and_a_device_are_refused_and_not_waited_for(tmp_path: Path, kind: str) -> None:
    paths = []
    for name in (name for name in files.WRITE if name.startswith(kind)):
        pipe, device = tmp_path / name, tmp_path / f"device{Path(name).suffix}"
        os.mkfifo(pipe)
        device.symlink_to("/dev/zero")
        paths += [pipe, device]
    said = "cannot be read: it is a pipe, socket or device, and must be a regular file"
    assert read_each(kind, paths) == [f"{path}: {said}" for path in paths]


@pytest.mark.check("takes 1.5 s")
@pytest.mark.parametrize(
    "command",
    [
        ("up", "--scenario"), ("up", "--scenario", "fig12", "--site-file"), ("status", "--site-file"),
        ("estop", "--site-file"), ("bag", "info"),
        ("compare", "{recording}", "--out", "{out}", "--published"),
    ],
)  # fmt: skip
def test_a_command_does_not_wait_for_a_pipe(
    tmp_path: Path, recording_of: Callable[[str], Path], command: tuple[str, ...]
) -> None:
    pipe = tmp_path / "file.yaml"
    os.mkfifo(pipe)
    recording = recording_of("wave") if "{recording}" in command else None
    words = [word.format(out=tmp_path / "out", recording=recording) for word in command]
    done = run_apart(*words, str(pipe), TELENANO_RUNTIME_DIR=str(tmp_path / "run"))
    assert done.returncode in (1, 2)
    assert done.stderr.startswith(f"telenano: {pipe}: cannot be read: it is a pipe"), done.stderr
    assert done.stderr.count("\n") == 1


# --- a corpus of damage ---

# A damaged file costs at most this multiple of what the sound one costs, over all that were read.
_MOST_TIMES = 3.0
_SOUND_EVERY = 6
OF_PACKAGES = {
    "trial": ("telenano_devices.acceptance",),
    "plan": ("telenano_lab.experiments",),
    "key": ("telenano.testing.conformance",),
}
OF_LIBRARIES = ("map.gwy", "map.h5-jpk", "map.ibw", "grid.dat")


def outcomes_of_damage(tmp_path: Path, name: str, seed: int, count: int) -> list[str]:
    for package in {"curve.tab": ("afmformats", "h5py"), "curve.jpk-force": ("afmformats",), "curve.h5": ("h5py",)}.get(
        name, {"map.gwy": ("gwyfile",)}.get(name, ("igor2",) if name.endswith("ibw") else ())
    ):
        pytest.importorskip(package)
    for package in OF_PACKAGES.get(name.partition(".")[0], ()):
        pytest.importorskip(package)
    whole = tmp_path / name
    files.WRITE[name](whole)
    paths = []
    for number, content in enumerate(damaged(whole.read_bytes(), seed, count)):
        path = tmp_path / f"{number}{whole.suffix}"
        path.write_bytes(content)
        # the sound one is read in between, by the same process, and begins and ends
        paths += [whole, path] if number % _SOUND_EVERY == 0 else [path]
    paths += [whole]
    outcomes, spent_s = read_within(name.partition(".")[0], paths)
    is_sound = [path == whole for path in paths]
    if name not in ("curve.jpk-force", "scenario.yaml"):
        assert {outcome for outcome, sound in zip(outcomes, is_sound, strict=True) if sound} == {"read"}
    # the first one waits for its reader to be imported
    sound_s = [took for took, sound in zip(spent_s, is_sound, strict=True) if sound][1:]
    damaged_s = [took for took, sound in zip(spent_s, is_sound, strict=True) if not sound]
    assert sum(damaged_s) <= _MOST_TIMES * len(damaged_s) * sum(sound_s) / len(sound_s)
    for path, outcome in zip(paths, outcomes, strict=True):
        # a scenario may have a sentence for each key, and a plan for each condition
        known = (f"{path}: ", f"{path} (")
        assert outcome == "read" or all(line.startswith(known) for line in outcome.splitlines()), outcome
    return [outcome for outcome, sound in zip(outcomes, is_sound, strict=True) if not sound]


@pytest.mark.check("takes 5.1 s")
@pytest.mark.drawn(0.35)
@pytest.mark.parametrize("name", sorted(files.WRITE))
def test_no_damage_leads_to_a_traceback_or_takes_the_machine(tmp_path: Path, name: str) -> None:
    # a child for each file of these
    count = 4 if name.startswith("curve") or name in OF_LIBRARIES else 120
    outcomes = outcomes_of_damage(tmp_path, name, 25, count)
    assert set(outcomes) != {"read"}


@pytest.mark.endurance
@pytest.mark.parametrize("name", sorted(files.WRITE))
@pytest.mark.parametrize("seed", range(4))
def test_much_damage_leads_to_no_traceback(tmp_path: Path, name: str, seed: int) -> None:
    outcomes_of_damage(tmp_path, name, seed, 60 if name.startswith("curve") or name in OF_LIBRARIES else 2000)


def test_the_files_are_whole_before_they_are_damaged(tmp_path: Path) -> None:
    from telenano.sections.surface_files import read_surface

    for name in ("map.gwy", "map.gsf", "map.ibw"):
        if name.endswith("ibw"):
            pytest.importorskip("igor2")
        files.WRITE[name](tmp_path / name)
        heights = read_surface(tmp_path / name).height_m
        expected = files.HEIGHTS.T if name.endswith("ibw") else files.HEIGHTS[::-1]
        assert np.array_equal(heights, expected), name
