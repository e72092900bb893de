"""The emulated Inverse Service over its real wire, and what the driver says of one that is not as it should be."""

import asyncio
import json
import os
import sys
import threading
import time
import tomllib
import urllib.request
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest
from telenano_devices.doubles.served import ServedPort
from telenano_devices.doubles.servo_bench import MemoryConversation, ServoBench, VirtualTime
from telenano_devices.haply.haply import ARM, HaplyWire
from telenano_devices.haply.haply_device import HaplyConfig
from telenano_devices.haply.haply_service import HaplyService, obey, serve_haply
from telenano_devices.impedance.emulated_arm import EmulatedArm, hand_of
from telenano_devices.impedance.emulated_service import whole_lines
from telenano_devices.impedance.servo import DeviceSample

from telenano.extend.hands import DeviceError, Gate

# The coupling takes so much for silence.
SILENCE_S = 0.05


@pytest.fixture
def served() -> Iterator[ServedPort]:
    found = ServedPort()
    yield found
    found.close()


def turns(count: int, seen: list[DeviceSample], push: float = 0.0) -> Callable[[DeviceSample], Any]:
    def turn(sample: DeviceSample) -> Any:
        seen.append(sample)
        return None if len(seen) >= count else (0.0, 0.0, push)

    return turn


def test_the_driver_finds_the_device_and_drives_it_over_the_real_wire(served: ServedPort) -> None:
    wire, seen = HaplyWire(HaplyConfig(service=served.address)), list[DeviceSample]()
    found = wire.open()
    assert found.identity == "Haply inverse3 049D, firmware 3.5, emulated"
    assert (found.axes, found.kind, found.buttons) == (3, "impedance", ("a", "b", "c"))
    assert (served.service.gate, served.service.damping) == (0.0, 0.0)
    wire.session(True)
    wire.run(turns(60, seen, push=0.5))
    assert served.service.spellings == {"vector": 59 + 1, "values": 0} or served.service.spellings["values"] == 0
    assert served.service.arm.session_s is not None
    assert seen[-1].position_m[2] > seen[0].position_m[2]
    assert all(sample.taken_ns > before.taken_ns for before, sample in pairwise(seen))
    wire.close()


@contextmanager
def clocked(answers: Callable[[int], tuple[int, float]]) -> Iterator[tuple[list[tuple[float, float]], HaplyWire]]:
    """Serve places that are times; yield (age that is told, true age) of each reading, and the open driver.

    Args:
        answers: For the number of a message, how many answers it gets, and how old their place is [s].
    """
    from websockets.sync.server import ServerConnection, serve

    def states(place_s: float) -> str:
        place = {"x": place_s, "y": 0.0, "z": 0.0}
        return json.dumps({"inverse3": [{"device_id": "049D", "state": {"cursor_position": place}}]})

    def converse(connection: ServerConnection) -> None:
        connection.send(states(time.monotonic()))
        for number, _ in enumerate(connection):
            count, old_s = answers(number)
            for _ in range(count):
                connection.send(states(time.monotonic() - old_s))

    server = serve(converse, "127.0.0.1", 0, compression=None)
    threading.Thread(target=server.serve_forever, daemon=True).start()
    wire = HaplyWire(HaplyConfig(service=f"ws://127.0.0.1:{server.socket.getsockname()[1]}"))
    wire.open()
    try:
        yield [], wire
    finally:
        wire.close()
        server.shutdown()


def ages(ages_s: list[tuple[float, float]], count: int) -> Callable[[DeviceSample], Any]:
    def turn(sample: DeviceSample) -> Any:
        now_s = time.monotonic()
        ages_s.append((now_s - sample.taken_ns * 1e-9, now_s - sample.position_m[0]))
        return None if len(ages_s) >= count else (0.0, 0.0, 0.0)

    return turn


def test_messages_that_nobody_asked_for_make_no_place_older_than_it_is_told() -> None:
    """Fifty of them at once made each place of the rest of the session 48 ms older."""
    with clocked(lambda number: (51 if number == 20 else 1, 0.0)) as (found, wire):
        wire.run(ages(found, 200))
        assert 50 <= wire.unasked <= 51
        assert all(true_s <= told_s + SILENCE_S for told_s, true_s in found)


def test_service_that_answers_twice_is_lost_before_its_places_are_old() -> None:
    lost = r"has sent \d+ messages that were not requested, and continues: end other"
    with clocked(lambda number: (2, 0.0)) as (found, wire):
        with pytest.raises(DeviceError, match=lost):
            wire.run(ages(found, 5000))
        assert len(found) < 500
        assert all(true_s <= told_s + SILENCE_S for told_s, true_s in found)


class TwoAtOnce(MemoryConversation):
    """Has, at the tenth question, the answer behind a message of another place that came in the same moment."""

    questions = 0

    def send(self, message: bytes) -> None:
        super().send(message)
        self.questions += 1
        if self.questions == 10:
            answer = json.loads(self._answers[-1])
            answer["inverse3"][0]["state"]["cursor_position"]["x"] += 1.0
            self._answers.insert(-1, json.dumps(answer))


def test_of_two_messages_in_the_same_moment_the_newer_is_the_place_and_the_other_one_is_counted() -> None:
    clock, service, seen = VirtualTime(), HaplyService(EmulatedArm(hand_of(), ARM)), list[DeviceSample]()
    conversation: Any = TwoAtOnce(service, clock)
    wire = HaplyWire(HaplyConfig(), connect=lambda address: conversation, now_ns=clock.now_ns, sleep=clock.sleep)
    wire.open()
    wire.run(turns(20, seen))
    assert wire.unasked == 1
    assert all(abs(sample.position_m[0]) < 0.1 for sample in seen)
    # The answer may be to the question before, a period of 1 ms ago, so that reading counts as that old.
    steps_ns = [later.taken_ns - before.taken_ns for before, later in pairwise(seen)]
    assert min(steps_ns) == 0
    assert steps_ns.count(0) == 1


def test_version_is_told_over_http(served: ServedPort) -> None:
    with urllib.request.urlopen(f"http://127.0.0.1:{served.port}/version", timeout=10) as answer:
        said = json.load(answer)
    assert said["ok"]
    assert said["data"]["project_version"]


def test_service_that_is_not_there_and_one_of_another_kind_are_sentences(
    served: ServedPort, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("telenano_devices.haply.haply._OPEN_S", 0.3)
    with pytest.raises(DeviceError, match=r"no Inverse Service answers at ws://127.0.0.1:1 "):
        HaplyWire(HaplyConfig(service="ws://127.0.0.1:1")).open()
    with pytest.raises(DeviceError, match="is not an address such as ws://"):
        HaplyWire(HaplyConfig(service="localhost")).open()
    with pytest.raises(DeviceError, match=r"has no Inverse3 FFFF \(there is 049D\): plug it in"):
        HaplyWire(HaplyConfig(service=served.address, device_id="FFFF")).open()


def test_without_websockets_driver_and_emulator_name_what_they_depend_on(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "websockets.client", None)
    with pytest.raises(DeviceError, match=r"the Haply Inverse3 needs websockets: pip install 'websockets>=15'"):
        HaplyWire(HaplyConfig(service="ws://127.0.0.1:1")).open()
    monkeypatch.setitem(sys.modules, "websockets.asyncio.server", None)
    service = HaplyService(EmulatedArm(hand_of(), ARM))
    with pytest.raises(DeviceError, match=r"Inverse Service needs websockets: pip install 'websockets>=15'"):
        asyncio.run(serve_haply(service, "127.0.0.1", 0, print))
    document = tomllib.loads((Path(__file__).parents[2] / "pyproject.toml").read_text())
    assert "websockets>=15" in document["project"]["dependencies"]


@pytest.mark.parametrize("spelling", ["vector", "values"])
def test_both_spellings_of_the_force_are_taken_and_a_service_that_knows_one_is_found_out(
    spelling: str, tmp_path: Path
) -> None:
    bench = ServoBench("haply", tmp_path, force_field=spelling)
    other = {"vector": "values", "values": "vector"}[spelling]
    bench.at(0.3, lambda: bench.device.hand(1.0))
    bench.run(0.5)
    assert bench.device.service.spellings[spelling] > 400
    assert bench.device.service.spellings[other] == 0
    bench = ServoBench("haply", tmp_path, force_field=spelling)
    bench.device.service.accepts = (other,)
    bench.at(0.3, lambda: bench.device.hand(0.3))
    bench.run(1.2)
    assert any(f"renders no force: give haptic_node.haply.force_field: {other}" in error for error in bench.errors)


def test_filters_of_the_service_are_switches_of_the_driver(tmp_path: Path) -> None:
    own = ServoBench("haply", tmp_path, force_gate=None, damping=None)
    assert own.device.service.gate == 0.3
    bench = ServoBench("haply", tmp_path, force_gate=0.8, damping=2.0)
    assert (bench.device.service.gate, bench.device.service.damping) == (0.8, 2.0)
    bench.at(0.3, lambda: bench.device.hand(1.0))
    bench.run(0.6)
    speeds = bench.device.service.arm.velocity_m_per_s
    sent, found = bench.newest.force_n[2], bench.device.service.rendered_n[2]
    assert found != sent or speeds[2] == 0.0


def test_grip_buttons_come_at_50_hz_and_a_sleeping_grip_is_not_a_loss(tmp_path: Path) -> None:
    bench = ServoBench("haply", tmp_path)
    bench.at(0.30, lambda: bench.device.service.buttons.update(b=True))
    bench.at(0.40, lambda: bench.device.do("grip_awake", False))
    bench.run(0.5)
    pressed = [sample.taken_ns * 1e-9 - 1.0 for sample in bench.samples if sample.buttons == 0b010]
    assert 0.30 <= pressed[0] <= 0.33
    assert bench.newest.gate == Gate.ACTIVE
    assert not bench.errors


def test_lines_of_a_person_break_the_service_and_mend_it() -> None:
    service = HaplyService(EmulatedArm(hand_of(), ARM))
    for line in ("pull", "freeze", "nan", "jump 0.01", "sign", "late 0.1", "sleep", "press a", "lose-home"):
        assert "is not known" not in obey(service, line)
    assert (service.plugged, service.calibrated, service.sign, service.late_s) == (False, False, -1.0, 0.1)
    for line in ("plug", "thaw", "number", "jump -0.01", "sign", "late 0", "wake", "release a", "home"):
        obey(service, line)
    assert (service.plugged, service.calibrated, service.sign, service.late_s) == (True, True, 1.0, 0.0)
    assert (service.frozen, service.not_a_number, service.offset_m) == (None, False, 0.0)
    assert obey(service, "jump x").startswith("'jump x' is not known: pull")


def test_other_hands_and_a_late_drive_are_put_in_by_a_line() -> None:
    service = HaplyService(EmulatedArm(hand_of(), ARM))
    arm = service.arm
    arm.start_session(True)
    assert "5 N" not in obey(service, "push x")
    assert obey(service, "push 2") == "a hand pushes with 2 N towards the sample"
    arm.advance(0.02)
    assert arm.velocity_m_per_s[2] == pytest.approx(-2.0 * 0.02 / ARM.mass_kg, rel=0.05)
    assert "means to be 0.01 m" in obey(service, "arm 0.01")
    for _ in range(40):
        arm.advance(0.05)
    assert arm.position_m[2] == pytest.approx(-0.01, abs=1e-4)
    assert obey(service, "loose") == "no hand holds the handle"
    assert obey(service, "drive-late 0.005") == "forces act 0.005 s late"
    arm.drive((1.0, 0.0, 0.0))
    arm.advance(0.004)
    assert arm.force_n == (0.0, 0.0, 0.0)
    arm.advance(0.002)
    assert arm.force_n == (1.0, 0.0, 0.0)
    # a force that is taken away does not come after all
    arm.drive((2.0, 0.0, 0.0))
    arm.let_go()
    arm.advance(0.02)
    assert arm.force_n == (0.0, 0.0, 0.0)


def test_lines_that_are_typed_or_pasted_at_once_are_all_obeyed() -> None:
    """The second of two lines once waited for a third."""
    reading, writing = os.pipe()
    begun = bytearray()
    try:
        os.write(writing, b"loose\npush 2\nfre")
        assert whole_lines(reading, begun) == ["loose", "push 2"]
        os.write(writing, b"eze\n")
        assert whole_lines(reading, begun) == ["freeze"]
        os.close(writing)
        assert whole_lines(reading, begun) is None
    finally:
        os.close(reading)


def test_service_that_answers_no_more_is_lost() -> None:
    with clocked(lambda number: (number < 20, 0.0)) as (found, wire):
        with pytest.raises(DeviceError, match=r"the service has been silent for 0\.05 s"):
            wire.run(ages(found, 200))
        assert len(found) < 25


def test_hand_of_an_emulated_device_goes_on_with_its_programme_where_the_service_was_lost(served: ServedPort) -> None:
    wire = HaplyWire(HaplyConfig(service=served.address))
    wire.open()
    wire.session(True)
    wire.run(turns(50, []))
    began_s = served.service.arm.session_s
    assert began_s is not None
    assert began_s > 0.0
    # After a silence the connection ends, and the servo opens another one.
    wire.close()
    wire.open()
    wire.run(turns(50, []))
    later_s = served.service.arm.session_s
    assert later_s is not None
    assert later_s > began_s
    wire.session(False)
    wire.run(turns(50, []))
    assert served.service.arm.session_s is None
    wire.close()
