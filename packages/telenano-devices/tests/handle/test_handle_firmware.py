"""The firmware's core under the address and undefined-behaviour sanitizers."""

import shutil
import subprocess
from pathlib import Path

import pytest
from telenano_devices.handle.firmware import SOURCES, FirmwareError, build_library


@pytest.mark.skipif(shutil.which("cc") is None, reason="needs a C compiler: apt install gcc libc6-dev")
def test_a_million_random_bytes_break_neither_memory_nor_limits(tmp_path: Path) -> None:
    program = tmp_path / "fuzz"
    sanitizers = ["-fsanitize=address,undefined", "-fno-sanitize-recover=all"]
    warnings = ["-std=c99", "-Wall", "-Wextra", "-Wconversion", "-Werror", "-O1", "-g"]
    files = [str(SOURCES / name) for name in ("core/frame.c", "core/handle.c", "tests/fuzz.c")]
    subprocess.run(["cc", *warnings, *sanitizers, *files, "-o", str(program)], check=True)
    done = subprocess.run([str(program), "1000000"], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    words = done.stdout.split()
    counts = dict(zip(words[::2], map(int, words[1::2]), strict=True))
    assert counts["bytes"] >= 1_000_000
    assert counts["understood"] == counts["sent"] > 1000
    assert counts["driven"] > 100


def test_missing_compiler_and_missing_source_are_sentences(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("CC", "no-such-compiler")
    with pytest.raises(FirmwareError, match="apt install gcc"):
        build_library(folder=tmp_path)
    with pytest.raises(FirmwareError, match="the source of the firmware is missing"):
        build_library(tmp_path)


@pytest.mark.skipif(shutil.which("avr-gcc") is None, reason="needs the AVR compiler: apt install gcc-avr avr-libc")
def test_committed_image_is_what_the_sources_give(tmp_path: Path) -> None:
    copied = tmp_path / "handle"
    shutil.copytree(SOURCES, copied)
    image = copied / "boards/avr328p/handle.hex"
    image.unlink()
    subprocess.run(["make", "-C", str(copied)], check=True, capture_output=True)
    assert image.read_bytes() == (SOURCES / "boards/avr328p/handle.hex").read_bytes()
