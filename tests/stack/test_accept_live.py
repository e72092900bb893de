"""`telenano device accept` at the emulated device of each driver, live, with a simulated person."""

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import library_doubles
import machine
import pytest
from live_devices import LiveDevice, write_hand
from stack_rig import ROOT

from services.haptic_node.acceptance.simulated_person import person, reach_of
from services.haptic_node.acceptance.take import steps_of
from services.haptic_node.devices.servo_process import ProcessLink

pytestmark = [pytest.mark.endurance, library_doubles.needs_cc]

MASS_KG = 0.05
DEADMAN = {"haply": "deadman=a", "dhd": "deadman_button=0", "hd": "deadman_button=0"}
# A machine that holds the servo up fails these, whatever the device is.
TIMING = ("rate", "jitter", "age of samples", "gaps")


def accepted(device: LiveDevice, folder: Path) -> tuple[int, dict[str, Any]]:
    """Run the command as a person would, and return its exit code and document."""
    settings = [f"{name}={value}" for name, value in device.settings.items()]
    command = [sys.executable, "-m", "telenano", "device", "accept", "--device", device.kind, "--mass", str(MASS_KG)]
    command += ["--independent-stop", "foot switch", "--out", str(folder / "accept"), "--json"]
    command += [f"--set=haptic_node.{device.kind}.{pair}" for pair in (*settings, DEADMAN[device.kind])]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=300)
    assert done.returncode in (0, 1), done.stderr
    assert all((folder / "accept" / name).is_file() for name in ("take.npz", "accept.html", "accept.json"))
    document: dict[str, Any] = json.loads(done.stdout)
    return done.returncode, document


def with_person(kind: str, folder: Path) -> LiveDevice:
    """Return an emulated device with a person who goes through the motion."""
    if kind == "haply":
        return LiveDevice(kind, folder, "--person", "--mass", str(MASS_KG))
    device = LiveDevice(kind, folder)
    link = ProcessLink(kind, device.settings)
    link.open()
    able = link.capabilities
    link.close()
    steps = steps_of(MASS_KG)
    hand = person(reach_of(able), len(able.buttons), 1, steps, MASS_KG)
    write_hand(folder / "hand", kind, hand, sum(step.seconds for step in steps) + 10.0)
    device.tell("TELENANO_DOUBLE_HAND", folder / "hand")
    return device


@pytest.mark.parametrize("kind", ["haply", "dhd", "hd"])
def test_good_device_is_accepted(kind: str, tmp_path: Path) -> None:
    with with_person(kind, tmp_path) as device:
        code, document = accepted(device, tmp_path)
    results = {check["check"]: check for check in document["checks"]}
    assert len(results) == 25
    wrong = {name: check for name, check in results.items() if check["result"] not in ("pass", "cannot say")}
    unsaid = {name for name, check in results.items() if check["result"] == "cannot say"}
    assert unsaid == ({"orientation"} if kind == "dhd" else set())
    if wrong.keys() & set(TIMING):
        # A servo that was held up in the step *hold* is also no measure of the stiffness.
        machine.note(f"acceptance of {document['device']}: the machine held the servo up, not judged: {wrong}")
        return
    assert wrong == {} and (code, document["result"]) == (0, "pass")
