"""The faults that every driver of a controller has to live through, and the rig that follows while they come and go."""

from collections.abc import Callable
from operator import methodcaller
from typing import Any, NamedTuple

import pytest
from telenano_devices.doubles.controller_line import PARAMS, ControllerLine

from telenano.testing import InstrumentRig, afm_node
from telenano.wire import ConfigError

NEAR_M = -70e-9
RETRACTED_M = PARAMS.safety.retract_position_m


def kill(line: ControllerLine) -> None:
    line.reachable = False


def stop(line: ControllerLine) -> None:
    line.running = False


def interrupt(line: ControllerLine) -> None:
    line.close()


def swallow(line: ControllerLine) -> None:
    line.close()
    line.accepting = False


def answer_twice(line: ControllerLine) -> None:
    line.to_host = lambda sent: sent + sent


class ControllerRig(InstrumentRig):
    def arm_and_follow_to(self, x_s_m: float) -> list[float]:
        """Arm, and follow to a place; give where the base was after each tick, towards the sample [m]."""
        self.control("arm", place="hand")
        bases = [self.line.base_m]
        while abs(bases[-1] - x_s_m) > 1e-12:
            self.tick(1, x_s_m)
            bases.append(self.line.base_m)
            assert len(bases) < 1500, bases[-3:]
        return bases


class Fault(NamedTuple):
    """A row of a table of faults.

    begin, end: how it comes and goes; text: of the event; status: of driver and bus; at_ms: by when the base is
    retracted at the latest, None where it cannot be while the fault lasts; retracts: whether and why the guard does;
    moves: the base goes elsewhere.
    """

    begin: Callable[[Any], None]
    text: str = ""
    status: str = "lost"
    duration_ms: int = 90
    at_ms: int | None = 5
    retracts: str = "device_lost"
    end: Callable[[Any], None] = methodcaller("mend")
    moves: bool = False


def walk(rig: ControllerRig, fault: Fault, place: tuple[float, float] = (0.0, 0.0)) -> None:
    """Have a fault come and go while a rig follows near the sample, and see that the tip is retracted after it."""
    line = rig.line
    events: list[str] = []
    retracted_ms = None

    def tick() -> Any:
        rig.tick(1, NEAR_M, place)
        events.extend(event.text for event in rig.bench.take("session/event"))
        return rig.bench.take("afm/state")[-1]

    rig.bench.take("session/event")
    fault.begin(line)
    states, bases = [], []
    for count in range(fault.duration_ms):
        states.append(tick())
        bases.append(line.base_m)
        if retracted_ms is None and line.is_retracted:
            retracted_ms = count + 1
    # driver and bus
    assert fault.status in {state.device for state in states} or line.driver.report.status == fault.status
    assert sum(fault.text in text for text in events) == 1 or not fault.text, events
    if fault.retracts:
        assert any(f"the AFM is in mode retracting: {fault.retracts}" in text for text in events)
        assert states[-1].mode in ("retracting", "retracted")
    else:
        assert {state.mode for state in states} == {"follow"}
    # device: the tip, whatever its host knows of it
    if fault.at_ms is not None:
        assert retracted_ms is not None
        assert retracted_ms <= fault.at_ms
    elif fault.retracts == "force_invalid":
        assert line.base_m <= RETRACTED_M + 1e-15
    elif not fault.moves:
        assert bases == [pytest.approx(NEAR_M, abs=1e-12)] * len(bases)
    # and on it goes: with the tip retracted, until armed
    fault.end(line)
    states = []
    while not states or states[-1].device != "ok":
        states.append(tick())
        assert len(states) < 1500, events[-3:]
    if not fault.retracts:
        assert {state.mode for state in states} == {"follow"}
        return
    states += [tick() for _ in range(80)]
    assert line.base_m <= RETRACTED_M + 1e-12
    assert (states[-1].mode, states[-1].device) == ("retracted", "ok")


def refuses_to_start(bench: Any, line: Any, begin: Callable[[Any], None], text: str) -> None:
    """Have a node begin with what is wrong from the start, and see that it says so and publishes nothing."""
    begin(line)
    with pytest.raises(ConfigError, match=text):
        afm_node(bench, line.driver)
    assert bench.sent == []
