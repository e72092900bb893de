"""`telenano device accept` at the emulated device of each driver, live, with a simulated person."""

import json
import subprocess
import sys
import threading
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import machine
import pytest
from stack_rig import ROOT
from telenano_devices.acceptance.haptic_device.person import person, reach_of
from telenano_devices.acceptance.haptic_device.take import steps_of
from telenano_devices.doubles import libraries
from telenano_devices.doubles.live_devices import LiveDevice, write_hand
from telenano_devices.impedance.servo_process import ProcessLink

pytestmark = [pytest.mark.endurance, pytest.mark.skipif(**libraries.WITHOUT_CC)]

MASS_KG = 0.05
DEADMAN = {"haply": "deadman=a", "dhd": "deadman_button=0", "hd": "deadman_button=0"}
# A machine that holds the servo up fails these, whatever the device is.
TIMING = ("rate", "jitter", "age of samples", "gaps")


class Put(NamedTuple):
    """A fault that is put in: in which step, and how long after its beginning it comes and goes [s], as an order."""

    step: str
    begins_s: float
    ends_s: float
    what: str
    value: float
    after: float


# By the check that has to find each. In the step *hold* the device pushes along x at 0.4 s and along z at 4.4 s, for
# 1.4 s.
FAULTS = {
    "finite positions": Put("slow", 2.0, 2.1, "not_a_number", 1.0, 0.0),
    "no jumps": Put("slow", 6.0, 7.0, "offset_m", 0.01, 0.0),
    "gaps": Put("fast", 3.0, 3.5, "latency_s", 0.1, 0.0),
    "sign of forces": Put("hold", 0.2, 2.2, "sign", -1.0, 1.0),
    "no frozen readings": Put("hold", 4.2, 6.2, "frozen", 1.0, 0.0),
}


def accepted(device: LiveDevice, folder: Path, faults: Mapping[str, Put]) -> tuple[int, dict[str, Any]]:
    """Run the command as a person would, put faults in, and return its exit code and document."""
    settings = [f"{name}={value}" for name, value in device.settings.items()]
    command = [sys.executable, "-u", "-m", "telenano", "device", "accept", "--device", device.kind]
    command += ["--mass", str(MASS_KG), "--independent-stop", "foot switch", "--out", str(folder / "accept")]
    command += [f"--set=haptic_node.{device.kind}.{pair}" for pair in (*settings, DEADMAN[device.kind])]
    timers: list[threading.Timer] = []
    with subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None and process.stderr is not None
        for line in process.stdout:
            for fault in (fault for fault in faults.values() if f" s  {fault.step}: " in line):
                timers.append(threading.Timer(fault.begins_s, device.do, (fault.what, fault.value)))
                timers.append(threading.Timer(fault.ends_s, device.do, (fault.what, fault.after)))
                for timer in timers[-2:]:
                    timer.start()
        for timer in timers:
            timer.join()
        errors = process.stderr.read()
    assert process.returncode in (0, 1), errors
    assert all((folder / "accept" / name).is_file() for name in ("take.npz", "accept.html", "accept.json"))
    document: dict[str, Any] = json.loads((folder / "accept" / "accept.json").read_text())
    return process.returncode, document


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
        code, document = accepted(device, tmp_path, {})
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


@pytest.mark.parametrize("kind", ["haply", "dhd", "hd"])
def test_each_fault_that_is_put_in_live_is_found(kind: str, tmp_path: Path) -> None:
    with with_person(kind, tmp_path) as device:
        code, document = accepted(device, tmp_path, FAULTS)
    results = {check["check"]: (check["result"], check["found"]) for check in document["checks"]}
    others = {name: found for name in FAULTS if (found := results[name])[0] != "fail"}
    if others and "fail" in (results["rate"][0], results["jitter"][0]):
        # A servo that was held up is not driven, which is asked for once more and is no verdict.
        machine.note(f"faults of {document['device']}: the machine held the servo up, not judged: {others}")
        return
    assert others == {}, results
    assert (code, document["result"]) == (1, "fail")
