"""Fig. 12 on emulated devices that take a force, each behind its real wire: a socket, or the calls of a C library."""

import re
from pathlib import Path

import machine
import numpy as np
import pytest
from stack_rig import Rig
from telenano_devices.doubles import libraries
from telenano_devices.doubles.live_devices import LiveDevice

from telenano.recording.reader import Recording

pytestmark = pytest.mark.endurance

HOLD_RATIO, CONTACT_M = 1.050, 7.033e-3
# of the hand at 2 N in the hold of the simulated master, and at the end in contact without a force
HELD_M = 7.797e-3
# the hand holds 2 N
HOLD_S = (3.6, 4.4)
FIELDS = ("session_s", "position_m.2", "reference_m.2", "operator_force_n.2", "mode", "device")


def coupling_of(recording: Recording) -> float:
    """Return K, which the first event of the device names [N/m]."""
    texts = [message.decode().text for message in recording.messages(["session/event"])]
    return float(next(found[1] for text in texts if (found := re.search(r"coupling K = ([0-9.e+]+) N/m", text))))


@pytest.mark.skipif(**libraries.WITHOUT_CC)
@pytest.mark.parametrize(("kind", "rate_hz"), [("haply", 1000), ("dhd", 1000), ("dhd", 4000), ("hd", 1000)])
def test_fig12_is_that_of_theory(kind: str, rate_hz: int, rig: Rig, tmp_path: Path) -> None:
    with LiveDevice(kind, tmp_path) as device:
        rig.start(*device.options, "--set", f"haptic_node.{kind}.rate_hz={rate_hz}", "--headless", rate=())
        code, summary, err = rig.finish()
    assert code == 0, err + rig.logs()
    recording = Recording(rig.out / "session.mcap")
    hand = recording.columns("haptic/state", FIELDS)
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


def servos(rig: Rig) -> list[int]:
    """Return the processes of servos that belong to a rig."""
    found = []
    for folder in Path("/proc").iterdir():
        if folder.name.isdigit():
            try:
                words, variables = ((folder / name).read_bytes() for name in ("cmdline", "environ"))
            except OSError:
                continue
            if b"telenano_devices.impedance.servo_process" in words and str(rig.sockets).encode() in variables:
                found.append(int(folder.name))
    return found
