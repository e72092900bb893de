"""Fig. 12 on an emulated handle and the model of a T7: processes of their own, on a pseudo-terminal and a socket."""

import os
import signal
import socket
import struct
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import machine
import pytest
from stack_rig import ROOT, Rig

from recording.reader import Recording
from services.afm_node.modbus_frames import Conversation

pytestmark = pytest.mark.endurance

FIG12 = ROOT / "presets" / "scenarios" / "fig12.yaml"
PATIENCE_S = 60.0
DAC0, TRIPS = 1000, 46010
# of the converters of a T7 with 80 nm for a volt, at the hand: the tip's base moves in steps of 0.1 nm
STEP_CM = 0.0061
STEP_N = 0.16


class Devices:
    """Both emulated devices, and the options with which a rig uses them."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.link, self.handle_file, self.stage_file = folder / "handle", folder / "handle.yaml", folder / "stage.yaml"
        with socket.socket() as free:
            free.bind(("127.0.0.1", 0))
            self.port = free.getsockname()[1]
        self.handle = self._start("handle", "--link", str(self.link), "--calibration", str(self.handle_file))
        self.t7 = self._start("t7", "--port", str(self.port), "--calibration", str(self.stage_file))
        self._conversation = Conversation(1)
        self._line: socket.socket | None = None
        wait_until(lambda: self.link.is_symlink() and self._serves(), "both devices")

    def _start(self, *arguments: str) -> "subprocess.Popen[bytes]":
        command = [sys.executable, "-m", "telenano", "device", "simulate", *arguments, "--scenario", str(FIG12)]
        return subprocess.Popen(command, cwd=ROOT, stdout=subprocess.DEVNULL)

    def _serves(self) -> bool:
        with socket.socket() as probe:
            return probe.connect_ex(("127.0.0.1", self.port)) == 0

    @property
    def options(self) -> list[str]:
        settings = {
            "haptic_node.driver": "serial",
            "haptic_node.serial.port": self.link,
            "haptic_node.serial.calibration": self.handle_file,
            "afm_node.driver": "modbus",
            "afm_node.modbus.calibration": self.stage_file,
        }
        return [word for key, value in settings.items() for word in ("--set", f"{key}={value}")]

    def hold_up_handle(self, duration_s: float) -> None:
        self.handle.send_signal(signal.SIGSTOP)
        time.sleep(duration_s)
        self.handle.send_signal(signal.SIGCONT)

    def read(self, address: int) -> float:
        """Read a float of the T7, beside the rig."""
        if self._line is None:
            self._line = socket.create_connection(("127.0.0.1", self.port), timeout=PATIENCE_S)
        self._line.sendall(self._conversation.read(address, 2))
        while (answer := self._conversation.answer(self._line.recv(4096))) is None:
            continue
        return float(struct.unpack(">f", struct.pack(">2H", *answer.words))[0])

    def close(self) -> None:
        if self._line is not None:
            self._line.close()
        for process in (self.handle, self.t7):
            process.kill()
            process.wait()


def wait_until(condition: Callable[[], bool], what: str) -> None:
    end = time.monotonic() + PATIENCE_S
    while not condition():
        assert time.monotonic() < end, f"waited in vain for {what}"
        time.sleep(0.02)


@pytest.fixture
def devices(tmp_path: Path) -> Iterator[Devices]:
    found = Devices(tmp_path)
    yield found
    found.close()


def states(recording: Recording, topic: str) -> list[Any]:
    return [message.decode() for message in recording.messages([topic])]


def test_interrupted_samples_leave_hand_and_tip_together(rig: Rig, devices: Devices) -> None:
    rig.start(*devices.options)
    rig.wait_until(rig.running, "the session")
    # through the ramps of the hand, 0.8 to 2.9 s
    for _ in range(14):
        devices.hold_up_handle(0.009)
        time.sleep(0.15)
    code, summary, err = rig.finish()
    assert code == 0, err + rig.logs()
    recording = Recording(rig.out / "session.mcap")
    hand = states(recording, "haptic/state")
    running = [state for state in hand if state.session_s >= 0.0]
    stale = sum(state.device == "stale" for state in running)
    assert stale > 0
    health = [message for message in states(recording, "node/health") if message.device_latency_s is not None]
    assert {message.src: message.device_latency_s for message in health} == {
        "haptic_node@master": pytest.approx(2.5e-3),
        "afm_node@slave": pytest.approx(2.5e-3),
    }
    text = (
        f"fig12 on devices: hold {summary['hold_ratio']:.3f}, contact {summary['contact_x_cm']:.3f} cm, {stale} stale"
    )
    if any(state.device == "lost" for state in running) or any(s.mode == "off" for s in running[5:]):
        machine.note(f"{text}, and the handle was lost, held up for longer than its watchdog: not judged")
        return
    machine.note(text)
    assert summary["contact_x_cm"] == pytest.approx(0.703, abs=0.010)
    assert summary["hold_ratio"] == pytest.approx(1.050, abs=0.5 * STEP_N / 2.0)


def test_killed_node_is_retracted_by_the_script_on_the_device(rig: Rig, devices: Devices) -> None:
    rig.start(*devices.options)
    rig.wait_until(lambda: rig.running() and devices.read(DAC0) > 1.5, "an approach")
    assert devices.read(TRIPS) == 0.0
    killed_ns = time.monotonic_ns()
    rig.kill("afm_node@slave")
    while devices.read(DAC0) > 2e-3:
        assert time.monotonic_ns() - killed_ns < PATIENCE_S * 1e9
    waited_s = (time.monotonic_ns() - killed_ns) * 1e-9
    # nobody but the script counts there, and a new node begins at 0 again
    assert devices.read(TRIPS) == 1.0
    machine.note(f"kill -9 of the AFM node: the T7's script had retracted after {waited_s * 1e3:.0f} ms")
    os.kill(rig.process.pid, signal.SIGINT) if rig.process is not None else None
    rig.finish()
