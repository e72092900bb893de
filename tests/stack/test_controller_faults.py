"""Faults of AFM controllers in a live rig: emulator and guard in processes of their own, broken while the tip is near.

Each fault leaves the tip retracted, is one event in words, and is got over: the controller is found again, armed, and
the tip goes back.
"""

import os
import signal
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

import machine
import pytest
from emulated_controllers import PATIENCE_S, Emulated, Gwyscope, Nanonis
from stack_rig import Rig

pytestmark = [pytest.mark.stack, pytest.mark.endurance]
KINDS = {"gwyscope": Gwyscope, "nanonis": Nanonis}
LAWS = {"gwyscope": (), "nanonis": ("--set", "controller.law=model_mediated")}
NODE = "afm_node@slave"


@pytest.fixture
def controller(tmp_path: Path, request: Any) -> Iterator[Emulated]:
    found = KINDS[request.param](tmp_path, "fig12")
    yield found
    found.close()


def near(controller: Emulated) -> bool:
    """Return whether the tip is where a hand begins to feel the sample."""
    return controller.z_m > 1.95e-6 if controller.name == "gwyscope" else controller.z_m < 5e-8


def kill(rig: Rig, controller: Any) -> None:
    controller.server.kill()
    controller.restart()


def freeze(rig: Rig, controller: Emulated) -> None:
    controller.freeze()
    rig.wait_until(lambda: rig.log_has(NODE, "has been silent for"), "the event")
    controller.thaw()


def freeze_node(rig: Rig, controller: Emulated) -> None:
    process_id = rig.process_of(NODE)
    assert process_id is not None
    os.kill(process_id, signal.SIGSTOP)
    try:
        rig.wait_until(lambda: controller.retracted, "the guard")
    finally:
        os.kill(process_id, signal.SIGCONT)


def again_and_again(act: Callable[[Any], None], text: str) -> Callable[[Rig, Any], None]:
    """Return what does something at the controller until the rig has noticed: its next z may be quicker."""

    def begin(rig: Rig, controller: Any) -> None:
        def noticed() -> bool:
            act(controller)
            return rig.log_has(NODE, text)

        rig.wait_until(noticed, "the event")

    return begin


class Fault(NamedTuple):
    """What is done, and the words of the event for each controller."""

    begin: Callable[[Rig, Any], None]
    gwyscope: str
    nanonis: str


MOVED, REFUSED = "somebody else has moved the tip", "The Z-Controller must be off"
FAULTS = {
    "killed": Fault(kill, "the connection is gone", "the connection is gone"),
    "frozen": Fault(freeze, "has been silent for 50 ms", "has been silent for 250 ms"),
    "frozen node": Fault(freeze_node, "the connection is gone", "the connection is gone"),
    "refuses": Fault(lambda rig, controller: refuse(rig, controller), MOVED, REFUSED),
    "moved from outside": Fault(again_and_again(lambda one: one.move_from_outside(), MOVED), MOVED, MOVED),
}


def refuse(rig: Rig, controller: Any) -> None:
    text = FAULTS["refuses"].gwyscope if controller.name == "gwyscope" else REFUSED
    again_and_again(lambda one: one.refuse(), text)(rig, controller)


@pytest.mark.parametrize("controller", KINDS, indirect=True)
@pytest.mark.parametrize("name", FAULTS)
def test_live_fault(rig: Rig, controller: Any, name: str) -> None:
    fault = FAULTS[name]
    text = getattr(fault, controller.name)
    rig.start(*controller.options, *LAWS[controller.name], "--duration", "600")
    rig.wait_until(lambda: rig.running() and near(controller), "an approach")
    begun_ns = time.monotonic_ns()
    fault.begin(rig, controller)
    rig.wait_until(lambda: rig.log_has(NODE, text), "the event")
    rig.wait_until(lambda: rig.log_has(NODE, "is ready and retracted", 2), "the recovery")
    assert not near(controller)
    waited_s = (time.monotonic_ns() - begun_ns) * 1e-9
    machine.note(f"{name}, {controller.name}: found again, with the tip retracted, after {waited_s:.1f} s")
    # one event of the loss
    log = (rig.out / "logs" / f"{NODE}.log").read_text()
    assert log.count(text) == 1, log[-3000:]
    # a node that stood still counts that time as silence, and any other loses the device
    assert any(f"the AFM is in mode retract{end}: " in log for end in ("ing", "ed"))
    armed = rig.telenano("session", "arm")
    assert armed.returncode == 0, armed.stdout + armed.stderr + log[-2000:]
    rig.wait_until(lambda: near(controller), "the tip", PATIENCE_S)
    assert rig.process is not None
    os.kill(rig.process.pid, signal.SIGINT)
    rig.finish()
