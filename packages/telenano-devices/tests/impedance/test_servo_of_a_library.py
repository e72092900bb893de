"""The servo as a process of its own: its start, its end, and the death of either side; where libraries are found."""

import os
import shutil
import signal
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from telenano_devices.device_checks import check_devices
from telenano_devices.doubles import libraries
from telenano_devices.force_dimension import dhd
from telenano_devices.force_dimension.dhd import DhdWire
from telenano_devices.force_dimension.dhd_device import DhdConfig
from telenano_devices.impedance.coupling import ZERO, CouplingSettings
from telenano_devices.impedance.servo import ServoCommand, ServoSample
from telenano_devices.impedance.servo_process import ProcessLink
from telenano_devices.impedance.vendor_library import find
from telenano_devices.touch import hd
from telenano_devices.touch.hd import HdWire
from telenano_devices.touch.hd_device import HdConfig

from telenano.extend.hands import DeviceError

SETTINGS = CouplingSettings((0.0, 0.0, 300.0), (0.5, 0.5, 2.0), 3.0, 1000.0)


def command(counter: int = 1) -> ServoCommand:
    return ServoCommand(counter, time.monotonic_ns(), ZERO, ZERO, ZERO, False, 0, False, SETTINGS)


def waits(condition: Callable[[], bool]) -> None:
    end_s = time.monotonic() + 60.0
    while not condition():
        assert time.monotonic() < end_s
        time.sleep(0.01)


@pytest.mark.skipif(**libraries.WITHOUT_CC)
@pytest.mark.parametrize("kind", ["dhd", pytest.param("hd", marks=pytest.mark.endurance)])
def test_servo_runs_beside_the_node_is_started_again_when_killed_and_ends_with_it(kind: str) -> None:
    link = ProcessLink(kind, {"library": str(libraries.build(kind))})
    link.open()
    try:
        assert link.capabilities.identity.endswith(", emulated")
        first = link.pid
        assert first not in (0, os.getpid())
        link.send(command())
        waits(lambda: (link.newest(-1.0, 1e-3) or ServoSample()).answered == 1)
        os.kill(first, signal.SIGKILL)
        errors: list[str] = []

        def is_back() -> bool:
            sample = link.newest(-1.0, 1e-3)
            link.send(command(2))
            errors.append("" if sample is None else sample.error)
            return link.pid not in (0, first) and sample is not None and sample.answered == 2 and not sample.error

        waits(is_back)
        assert any("the process of the servo has ended with code -9; it is started again" in text for text in errors)
        second = link.pid
    finally:
        link.close()
    with pytest.raises(ProcessLookupError):
        os.kill(second, 0)
    link.close()


def test_device_that_is_not_there_is_the_sentence_of_its_driver_and_leaves_no_process(tmp_path: Path) -> None:
    link = ProcessLink("dhd", {"library": str(tmp_path / "none.so")})
    with pytest.raises(DeviceError, match=r"none.so cannot be loaded .*: get the SDK at forcedimension.com"):
        link.open()
    assert link.pid == 0


def test_a_library_that_is_another_one_is_refused(tmp_path: Path) -> None:
    if shutil.which("cc") is None:
        pytest.skip("needs a C compiler: apt install gcc")
    link = ProcessLink("dhd", {"library": str(libraries.build("hd"))})
    with pytest.raises(DeviceError, match="the library has no dhdGetAvailableCount: it is another library, or too old"):
        link.open()


def test_library_is_found_in_the_folder_of_the_sdk(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = tmp_path / dhd.LIBRARY.folders[0].removeprefix("$FDSDK/")
    folder.mkdir(parents=True)
    (folder / "libdhd.so.3").touch()
    monkeypatch.setenv("FDSDK", str(tmp_path))
    assert find(dhd.LIBRARY) == str(folder / "libdhd.so.3")


def test_doctor_says_what_is_missing_and_where_to_get_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("ctypes.util.find_library", lambda name: None)
    found = {finding.name: finding for finding in check_devices("ws://127.0.0.1:1", [tmp_path])}
    assert {finding.level for finding in found.values()} == {"ok"}
    assert "no Inverse Service answers" in found["haply"].found
    assert "forcedimension.com" in found["dhd"].advice
    assert "3dsystems.com" in found["hd"].advice
    (tmp_path / "libHD.so").touch()
    found = {finding.name: finding for finding in check_devices("ws://127.0.0.1:1", [tmp_path])}
    assert found["hd"].found.endswith(str(tmp_path / "libHD.so"))
    assert not found["hd"].advice


@pytest.mark.parametrize(
    ("library", "made", "settings"), [(dhd.LIBRARY, DhdWire, DhdConfig), (hd.LIBRARY, HdWire, HdConfig)]
)
def test_a_library_that_a_scenario_names_is_code_and_refused(
    library: Any, made: Any, settings: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A scenario is data (SECURITY.md); the doubles of these tests are allowed where they are built."""
    monkeypatch.delenv("TELENANO_ALLOW_CODE")
    heard: list[str] = []
    monkeypatch.setattr("ctypes.CDLL", heard.append)
    with pytest.raises(DeviceError, match=f"{library.setting} .*evil.so: it is code.*--allow-code"):
        made(settings(library=str(tmp_path / "evil.so"))).open()
    assert not heard
