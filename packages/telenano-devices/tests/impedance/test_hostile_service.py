"""The Inverse3 behind each hostile service: no place is old and called fresh."""

import json
import math
from typing import Any

import pytest
from telenano_devices.doubles.servo_bench import VirtualTime
from telenano_devices.haply import haply
from telenano_devices.haply.haply_device import HaplyConfig
from telenano_devices.impedance.vendor_service import Conversation

from telenano.extend.hands import DeviceError
from telenano.testing import HOSTILITIES, HostileService, TakenReading, unseen

MS = 1_000_000
BEGINS_MS, ENDS_MS = 300, 1200


class HostileConversation(Conversation[haply.Answer]):
    """A conversation with a service whose place is the time, without a socket."""

    def __init__(self, kind: str, time: VirtualTime) -> None:
        self._service, self._messages, self._time = "ws://hostile", list[bytes](), time
        self._about, self._decode = haply.INVERSE_SERVICE, haply.DECODE
        self._hostile = HostileService(kind, 10**9 + BEGINS_MS * MS)
        self._answer()

    def _answer(self) -> None:
        place = {"x": self._time.s, "y": 0.0, "z": 0.0}
        states = {"inverse3": [{"device_id": "049D", "state": {"cursor_position": place}}]}
        self._hostile.put(json.dumps(states).encode(), self._time.ns)

    def send(self, message: bytes) -> None:
        self._answer()

    def _come(self) -> None:
        self._messages += self._hostile.take(self._time.ns)

    def wait(self, patience_s: float = 0.5) -> None:
        until_s = self._time.s + patience_s
        self._come()
        while not self._messages:
            if self._time.s > until_s:
                raise DeviceError(f"the service has been silent for {patience_s:g} s")
            self._time.sleep(1e-4)
            self._come()

    def drop(self, keep: int = 0) -> int:
        self._come()
        dropped = max(0, len(self._messages) - keep)
        del self._messages[:dropped]
        return dropped

    def close(self) -> None:
        self._hostile.forget()


def inverse3(kind: str) -> list[TakenReading]:
    time, readings = VirtualTime(), list[TakenReading]()
    device = haply.HaplyWire(
        HaplyConfig(),
        connect=lambda address: HostileConversation(kind, time),
        now_ns=time.now_ns,
        sleep=time.sleep,
    )

    def turn(sample: Any) -> Any:
        readings.append(
            TakenReading((time.ns - sample.taken_ns) * 1e-9, time.s - sample.position_m[0], not sample.error)
        )
        return (0.0, 0.0, 0.0) if time.s < 1.0 + ENDS_MS * 1e-3 else None

    while time.s < 1.0 + ENDS_MS * 1e-3:
        try:
            device.open()
            device.run(turn)
        except DeviceError as error:
            readings.append(TakenReading(math.inf, math.inf, False))
            assert str(error)
            time.sleep(0.5)
        finally:
            device.close()
    return readings


def test_a_service_that_falls_silent_holds_the_last_force_no_longer_than_the_coupling_bears() -> None:
    time, asked_s = VirtualTime(), list[float]()
    device = haply.HaplyWire(
        HaplyConfig(),
        connect=lambda address: HostileConversation("never", time),
        now_ns=time.now_ns,
        sleep=time.sleep,
    )
    device.open()
    with pytest.raises(DeviceError, match=r"silent for 0\.05 s"):
        device.run(lambda sample: (asked_s.append(time.s), (0.0, 0.0, 1.0))[1])
    assert time.s - asked_s[-1] <= 0.055


@pytest.mark.parametrize("kind", HOSTILITIES)
def test_no_place_is_old_and_called_fresh(kind: str) -> None:
    readings = inverse3(kind)
    # A state of the service has neither time nor number: one that is repeated is a hand at rest, until the force
    # changes and the place does not, which the coupling looks for.
    assert bool(unseen(readings)) == (kind == "repeated"), unseen(readings)[:3]
    # It had a good time before.
    assert sum(found.is_good for found in readings) >= BEGINS_MS
