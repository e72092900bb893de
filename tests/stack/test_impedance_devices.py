"""Fig. 12 on emulated devices that take a force, each behind its real wire: a socket, or the calls of a C library."""

import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import library_doubles
import machine
import numpy as np
import pytest
from stack_rig import ROOT, Rig

from recording.arrays import columns
from recording.reader import Recording

pytestmark = pytest.mark.endurance

PATIENCE_S = 60.0
HOLD_RATIO, CONTACT_M = 1.050, 7.033e-3
# of the hand at 2 N in the hold of the simulated master, and at the end in contact without a force
HELD_M = 7.797e-3
# the hand holds 2 N
HOLD_S = (3.6, 4.4)
FIELDS = ("session_s", "position_m.2", "reference_m.2", "operator_force_n.2", "mode", "device")


class HaplyEmulator:
    """`telenano device simulate haply` as a process of its own; a line on its input puts a fault in."""

    def __init__(self, port: int = 0) -> None:
        command = [sys.executable, "-m", "telenano", "device", "simulate", "haply", "--port", str(port)]
        self.process = subprocess.Popen(command, cwd=ROOT, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
        assert self.process.stdout is not None
        self.address = re.findall(r"ws://\S+:\d+", self.process.stdout.readline())[0]

    @property
    def port(self) -> int:
        return int(self.address.rsplit(":", 1)[1])

    def do(self, line: str) -> None:
        assert self.process.stdin is not None
        self.process.stdin.write(line + "\n")
        self.process.stdin.flush()

    def kill(self) -> None:
        self.process.send_signal(signal.SIGKILL)
        self.process.wait()
        for pipe in (self.process.stdin, self.process.stdout):
            if pipe is not None:
                pipe.close()


@pytest.fixture
def emulators() -> Iterator[list[HaplyEmulator]]:
    started: list[HaplyEmulator] = []
    yield started
    for emulator in started:
        if emulator.process.returncode is None:
            emulator.kill()


def options_of(kind: str, rate_hz: int, emulators: list[HaplyEmulator]) -> list[str]:
    settings: dict[str, Any] = {"device": kind, f"{kind}.rate_hz": rate_hz}
    if kind == "haply":
        emulators.append(HaplyEmulator())
        settings["haply.service"] = emulators[-1].address
    else:
        settings[f"{kind}.library"] = library_doubles.build(kind)
    return [word for key, value in settings.items() for word in ("--set", f"haptic_node.{key}={value}")]


def coupling_of(recording: Recording) -> float:
    """Return K, which the first event of the device names [N/m]."""
    texts = [message.decode().text for message in recording.messages(["session/event"])]
    return float(next(found[1] for text in texts if (found := re.search(r"coupling K = ([0-9.e+]+) N/m", text))))


@library_doubles.needs_cc
@pytest.mark.parametrize(("kind", "rate_hz"), [("haply", 1000), ("dhd", 1000), ("dhd", 4000), ("hd", 1000)])
def test_fig12_is_that_of_theory(kind: str, rate_hz: int, rig: Rig, emulators: list[HaplyEmulator]) -> None:
    rig.start(*options_of(kind, rate_hz, emulators), "--headless")
    code, summary, err = rig.finish()
    assert code == 0, err + rig.logs()
    recording = Recording(rig.out / "session.mcap")
    hand = columns(recording, "haptic/state", FIELDS)
    held = (hand["session_s"] > HOLD_S[0]) & (hand["session_s"] < HOLD_S[1])
    force_n, place_m, reference_m = (
        -float(np.mean(hand[name][held])) for name in ("operator_force_n.2", "position_m.2", "reference_m.2")
    )
    stiffness = coupling_of(recording)
    let_go = int((hand["mode"][hand["session_s"] > 0.0] != "position").sum())
    text = (
        f"fig12 on {kind} at {rate_hz} Hz: hold {summary['hold_ratio']:.4f}, reference {reference_m * 100:.4f} cm, "
        f"hand {place_m * 100:.4f} cm, force {force_n:.4f} N, K {stiffness:.4g} N/m, let go for {let_go} samples, "
        f"contact {summary['contact_x_cm']:.4f} cm, loop {summary['loop_age_ms']['p50']:.2f} ms"
    )
    if let_go:
        # A simulated hand pushes on whatever the device does, so that a session in which it was let go says nothing.
        events = [message.decode().text for message in recording.messages(["session/event"])]
        machine.note(f"{text}: held up, and not judged: {events}")
        return
    machine.note(text)
    assert summary["hold_ratio"] == pytest.approx(HOLD_RATIO, rel=5e-3, abs=0.0)
    assert reference_m == pytest.approx(HELD_M, rel=0.01, abs=0.0)
    assert place_m == pytest.approx(HELD_M + force_n / stiffness, rel=0.01, abs=0.0)
    assert 1e-2 * summary["contact_x_cm"] == pytest.approx(CONTACT_M, rel=0.01, abs=0.0)


def test_faults_of_a_running_rig_and_back(rig: Rig, emulators: list[HaplyEmulator]) -> None:
    """Device pulled, service late, reading frozen, no number, service killed: no force, one event each, and back."""
    options = options_of("haply", 1000, emulators)
    rig.start(*options, "--duration", "600", "--headless")
    rig.wait_until(rig.running, "the session")

    def states() -> list[Any]:
        return [message.decode() for message in rig.recording().messages("haptic/state")]

    def follows() -> bool:
        return states()[-1].mode == "position" and states()[-1].device == "ok"

    def rests() -> bool:
        return states()[-1].mode == "off" and states()[-1].motor_force_n == (0.0, 0.0, 0.0)

    rig.wait_until(follows, "the hand")
    emulator = emulators[0]
    for begin, end in (
        ("pull", "plug"),
        ("late 0.1", "late 0"),
        ("lose-home", "home"),
        ("nan", "number"),
        ("jump 0.01", ""),
    ):
        emulator.do(begin)
        rig.wait_until(rests, begin)
        emulator.do(end or "jump -0.01")
        time.sleep(0.2)
        if begin in ("nan", "jump 0.01"):
            assert rig.telenano("session", "arm").returncode == 0
        rig.wait_until(follows, f"the hand after {begin}")
    port = emulator.port
    emulator.kill()
    rig.wait_until(rests, "the hand without a service")
    emulators.append(HaplyEmulator(port))
    rig.wait_until(follows, "the hand after the service was killed")
    (servo,) = servos(rig)
    os.kill(servo, signal.SIGKILL)

    def is_told() -> bool:
        return any(
            "ended with code -9" in message.decode().text for message in rig.recording().messages("session/event")
        )

    # The node starts it again at once, so that the state without it may be over before anybody looks.
    rig.wait_until(is_told, "the servo that was killed")
    rig.wait_until(follows, "the hand after the servo was killed")
    code, _, err = rig.stop()
    assert code == 0, err + rig.logs()
    texts = [message.decode().text for message in Recording(rig.out / "session.mcap").messages(["session/event"])]
    for text in (
        "is gone: plug it in",
        # The node may find the age of the samples before the servo's own word is there.
        "it has sent no sample within the deadline|is silent: the device counts as lost",
        "is not calibrated: put its handle",
        "was not a finite number",
        "its position jumped",
        "the service has closed the connection",
        "the process of the servo has ended with code -9",
    ):
        assert any(part in found for found in texts for part in text.split("|")), (text, texts)
    assert servos(rig) == []


def servos(rig: Rig) -> list[int]:
    """Return the processes of servos that belong to a rig."""
    found = []
    for folder in Path("/proc").iterdir():
        if folder.name.isdigit():
            try:
                words, variables = ((folder / name).read_bytes() for name in ("cmdline", "environ"))
            except OSError:
                continue
            if b"services.haptic_node.devices.servo_process" in words and str(rig.sockets).encode() in variables:
                found.append(int(folder.name))
    return found
