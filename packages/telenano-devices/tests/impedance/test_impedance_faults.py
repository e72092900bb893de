"""Each fault of a device of impedance type, at its servo: no force at the hand, one sentence, and how it goes on."""

import shutil
import threading
from collections.abc import Callable, Mapping
from itertools import pairwise
from pathlib import Path
from types import MappingProxyType, SimpleNamespace
from typing import Any, NamedTuple

import pytest

if shutil.which("cc") is None:
    pytest.skip("the doubles of vendors' libraries need a C compiler: apt install gcc", allow_module_level=True)

from telenano_devices.doubles.servo_bench import (
    DEVICES,
    MS,
    STIFFNESS_N_PER_M,
    EmulatedDevice,
    ServoBench,
    VirtualTime,
)

from telenano.extend.hands import DeviceError, Gate

HAND_N = 1.0
# The hand pushes, something breaks, the hand holds the arm, it is mended, and the hand pushes again.
PUSHES_S, BREAKS_S, MENDS_S, ARMS_S, AGAIN_S, ENDS_S = 0.3, 0.6, 0.95, 1.0, 1.8, 2.2
# What a fault may take to be found, beside the 50 ms of silence: the servo's own period, and a few of its steps.
AFTER_S = 0.06


class Fault(NamedTuple):
    """A row of the table.

    begin, end: how it comes and goes; text: of the error, or gate: of the coupling, that it ends in; after_s: from when
    on there is no force; armed: whether a person has to arm.
    """

    begin: Callable[[ServoBench], None]
    end: Callable[[ServoBench], None]
    text: str = ""
    gate: int = Gate.ACTIVE
    after_s: float = AFTER_S
    armed: bool = False
    devices: tuple[str, ...] = DEVICES
    settings: Mapping[str, Any] = MappingProxyType({})


def do(what: str, value: Any = True) -> Callable[[ServoBench], None]:
    return lambda bench: bench.device.do(what, value)


def moves(what: str) -> Callable[[ServoBench], None]:
    """Freeze the place, and move the law's reference: the force changes and the place does not."""

    def begin(bench: ServoBench) -> None:
        bench.device.do(what)
        bench.moves_m_per_s = -0.06

    return begin


def falls_silent(silent: bool) -> Callable[[ServoBench], None]:
    return lambda bench: setattr(bench, "silent", silent)


def mended(what: str, value: Any = False) -> Callable[[ServoBench], None]:
    def end(bench: ServoBench) -> None:
        bench.device.do(what, value)
        bench.moves_m_per_s = 0.0

    return end


def held(bench: ServoBench, is_held: bool) -> None:
    if bench.device.kind == "haply":
        bench.device.service.buttons["a"] = is_held
    else:
        bench.device.double.set("buttons", float(is_held))


BUTTON = {"haply": {"deadman": "a"}, "dhd": {"deadman_button": 0}, "hd": {"deadman_button": 0}}


FAULTS: dict[str, Fault] = {
    "killed service": Fault(do("killed"), do("killed", False), "the service has closed", devices=("haply",)),
    "pulled device": Fault(do("plugged", False), do("plugged"), "plug it in|ommunication error"),
    "lost calibration": Fault(do("calibrated", False), do("calibrated"), "is not calibrated: put its"),
    "frozen reading": Fault(moves("frozen"), mended("frozen"), gate=Gate.FROZEN, after_s=0.2, armed=True),
    "no number": Fault(do("not_a_number"), mended("not_a_number"), gate=Gate.NOT_A_NUMBER, armed=True),
    "jump of 10 mm": Fault(do("offset_m", 0.010), mended("offset_m", 0.0), gate=Gate.JUMP, armed=True),
    "wrong sign": Fault(do("sign", -1.0), mended("sign", 1.0), gate=Gate.RUNAWAY, after_s=0.2, armed=True),
    "late by 100 ms": Fault(do("latency_s", 0.1), do("latency_s", 0.0), gate=Gate.DEVICE_SILENT, after_s=0.15),
    "silent scheduler": Fault(
        do("stopped"),
        do("stopped", False),
        "its scheduler has stopped (no call for 0.05 s)",
        after_s=0.07,
        devices=("hd",),
    ),
    "silent node": Fault(falls_silent(True), falls_silent(False), gate=Gate.SILENT),
    "grip asleep": Fault(
        do("grip_awake", False), do("grip_awake"), gate=Gate.DEADMAN, devices=("haply",), settings=BUTTON
    ),
    "dead-man button": Fault(
        lambda bench: held(bench, False), lambda bench: held(bench, True), gate=Gate.DEADMAN, settings=BUTTON
    ),
}
# A reading of the service that is frozen has no other sign.
KEPT = ("frozen reading", "haply")
# What the coupling finds is the same step for all three; `make endurance` tries it on the other two as well.
OF_THE_COUPLING = ("frozen reading", "no number", "jump of 10 mm", "wrong sign", "silent node", "dead-man button")
CASES = [
    pytest.param(
        name,
        kind,
        id=f"{name}-{kind}",
        marks=[pytest.mark.endurance] if name in OF_THE_COUPLING and kind != "dhd" and (name, kind) != KEPT else [],
    )
    for name, fault in FAULTS.items()
    for kind in fault.devices
]


def pushed(kind: str, folder: Path, **settings: Any) -> ServoBench:
    """Return a bench whose hand holds 1 N when something breaks."""
    bench = ServoBench(kind, folder, **settings)
    bench.at(PUSHES_S, lambda: bench.device.hand(HAND_N))
    if settings:
        held(bench, True)
    return bench


@pytest.mark.parametrize(("name", "kind"), CASES)
def test_fault(name: str, kind: str, tmp_path: Path) -> None:
    fault = FAULTS[name]
    bench = pushed(kind, tmp_path, **fault.settings.get(kind, {}))
    before: list[float] = []
    bench.at(BREAKS_S - 0.01, lambda: before.append(bench.device.force_n))
    bench.at(BREAKS_S, lambda: fault.begin(bench))
    found: list[Any] = []
    bench.at(MENDS_S - 0.001, lambda: found.append(bench.newest))
    # The hand holds an arm that has no force, and pushes on where the fault shows by that alone.
    bench.at(BREAKS_S + (fault.after_s if fault.armed else AFTER_S), lambda: bench.device.hand(held=True))
    bench.at(MENDS_S, lambda: fault.end(bench))
    if fault.armed:
        bench.at(MENDS_S, bench.device.centre)
        bench.at(ARMS_S, lambda: setattr(bench, "arm_count", 1))
    bench.at(AGAIN_S, lambda: bench.device.hand(HAND_N))
    bench.run(ENDS_S)
    # before: the hand is held
    assert before[0] == pytest.approx(HAND_N, rel=0.15, abs=0.0)
    # meanwhile: no force at the motors, and the reason
    assert bench.greatest_n(BREAKS_S + fault.after_s, MENDS_S) == 0.0
    if fault.text:
        assert any(part in error for error in bench.errors for part in fault.text.split("|")), bench.errors
        assert all(len(error) < 240 for error in bench.errors)
    else:
        assert Gate(found[0].gate).text == Gate(fault.gate).text
    # and on it goes, where the hand is
    assert bench.newest.gate == Gate.ACTIVE
    assert not bench.newest.error
    assert bench.newest.force_n[2] == pytest.approx(HAND_N, rel=0.15, abs=0.0)


@pytest.mark.parametrize("kind", ["dhd"])
def test_refused_device_stays_refused_until_a_person_arms(kind: str, tmp_path: Path) -> None:
    bench = pushed(kind, tmp_path)
    bench.at(BREAKS_S, lambda: bench.device.do("offset_m", 0.010))
    bench.run(ENDS_S)
    assert bench.newest.gate == Gate.JUMP
    assert bench.greatest_n(BREAKS_S + 0.01, ENDS_S) == 0.0


@pytest.mark.parametrize("kind", DEVICES)
def test_there_is_no_force_before_the_hand_has_been_at_rest_and_it_begins_within_the_slew(
    kind: str, tmp_path: Path
) -> None:
    bench = pushed(kind, tmp_path)
    bench.run(0.7)
    assert bench.greatest_n(0.0, bench.coupling.rest_s) == 0.0
    assert bench.newest.force_n[2] == pytest.approx(HAND_N, rel=0.15, abs=0.0)
    # The end of the servo takes the force away at once.
    forces = [force for at_s, force in bench.forces if at_s < 0.69]
    steps = [abs(after - before) for before, after in pairwise(forces)]
    assert max(steps) <= 1.01 * bench.coupling.max_slew_n_per_s / bench.found.rate_hz


@pytest.mark.parametrize("kind", DEVICES)
def test_the_force_is_clamped_and_the_hand_is_told_of_it(kind: str, tmp_path: Path) -> None:
    bench = pushed(kind, tmp_path)
    bench.coupling = bench.coupling._replace(max_force_n=0.5, runaway_m_per_s=10.0)
    bench.run(0.5)
    assert 0.0 < bench.greatest_n(0.0, 0.5) <= 0.5 + 1e-6
    assert bench.newest.limited


@pytest.mark.parametrize("kind", DEVICES)
def test_the_end_of_the_node_leaves_the_motors_without_force(kind: str, tmp_path: Path) -> None:
    bench = pushed(kind, tmp_path)
    bench.at(BREAKS_S, lambda: setattr(bench, "gone", True))
    bench.run(ENDS_S)
    assert bench.s == pytest.approx(BREAKS_S, abs=0.05, rel=0.0)
    assert bench.device.force_n == 0.0


@pytest.mark.parametrize("kind", DEVICES)
def test_hold_is_the_force_of_the_hand_and_the_place_is_that_of_the_spring(kind: str, tmp_path: Path) -> None:
    """At rest K r = F, so the arm stands F/K beyond the reference, and the estimate is the hand's own force."""
    bench = pushed(kind, tmp_path)
    bench.run(1.5)
    held_n = [sample.force_n[2] for sample in bench.samples[-300:]]
    assert sum(held_n) / len(held_n) == pytest.approx(HAND_N, rel=5e-3, abs=0.0)
    below_m = bench.reference_m - bench.device.height_m
    assert below_m == pytest.approx(HAND_N / STIFFNESS_N_PER_M, rel=0.01, abs=0.06e-3 if kind == "hd" else 1e-5)


@pytest.mark.parametrize("kind", DEVICES)
def test_device_that_is_another_when_it_is_back_is_refused(kind: str, tmp_path: Path) -> None:
    bench = pushed(kind, tmp_path)
    bench.found = bench.found._replace(identity="another one")
    bench.at(0.5, lambda: bench.device.do("plugged", False))
    bench.at(0.6, lambda: bench.device.do("plugged"))
    bench.run(2.5)
    assert any("is connected instead of another one: restart the node" in error for error in bench.errors)
    assert bench.greatest_n(1.0, 2.5) == 0.0


@pytest.mark.parametrize(("rate_hz", "kind"), [(4000.0, "dhd"), (500.0, "hd")])
def test_other_rates_of_the_servo(rate_hz: float, kind: str, tmp_path: Path) -> None:
    bench = ServoBench(kind, tmp_path, rate_hz=rate_hz)
    bench.run(0.3)
    assert bench.found.rate_hz == rate_hz
    if kind != "hd":
        # The scheduler of the double in virtual time calls each millisecond.
        assert bench.newest.counter == pytest.approx(0.3 * rate_hz, rel=0.02, abs=2)
    else:
        assert bench.device.double.get("rate_hz") == rate_hz


DHD_CALLS = ("dhdGetPosition", "dhdGetStatus", "dhdSetForce")
DHD_START = ("dhdOpen", "dhdGetSystemType", "dhdGetSerialNumber", "dhdSetWatchdog", "dhdSetMaxForce", "dhdEnableForce")
HD_CALLS = ("hdBeginFrame", "hdGetDoublev", "hdGetIntegerv", "hdSetDoublev", "hdEndFrame")
HD_START = ("hdInitDevice", "hdSetSchedulerRate", "hdEnable", "hdGetDoublev")
COMMUNICATION = {"dhd": (2, "communication error"), "hd": (0x0302, "Communication error with device (0x0302)")}


@pytest.mark.parametrize(
    ("kind", "call"), [*(("dhd", call) for call in DHD_CALLS), *(("hd", call) for call in HD_CALLS)]
)
def test_error_of_a_call_is_a_loss_in_its_words_and_is_got_over(kind: str, call: str, tmp_path: Path) -> None:
    bench = ServoBench(kind, tmp_path)
    code, text = COMMUNICATION[kind]
    bench.at(0.3, lambda: bench.device.double.fail(call, code))
    bench.at(0.4, lambda: bench.device.double.fail(call, 0))
    bench.run(1.3)
    assert any(text in error and bench.found.identity in error for error in bench.errors), bench.errors
    assert bench.newest.gate == Gate.ACTIVE
    assert not bench.newest.error


@pytest.mark.parametrize(
    ("kind", "call"), [*(("dhd", call) for call in DHD_START), *(("hd", call) for call in HD_START)]
)
def test_error_at_the_start_is_a_sentence_and_leaves_the_device_closed(kind: str, call: str, tmp_path: Path) -> None:
    device = EmulatedDevice(kind, VirtualTime(), tmp_path)
    code, text = COMMUNICATION[kind]
    device.double.fail(call, code)
    with pytest.raises(DeviceError, match=text.split(" (")[0]):
        device.wire.open()
    device.double.fail(call, 0)
    assert device.wire.open().kind == "impedance"


def test_watchdog_of_the_device_takes_the_force_when_the_process_dies(tmp_path: Path) -> None:
    bench = pushed("dhd", tmp_path)
    bench.at(BREAKS_S, lambda: (_ for _ in ()).throw(KeyboardInterrupt()))
    closed = bench.device.wire.close
    bench.device.wire.close = lambda: None  # type: ignore[method-assign]
    with pytest.raises(KeyboardInterrupt):
        bench.run(ENDS_S)
    assert bench.device.force_n == pytest.approx(HAND_N, rel=0.02, abs=0.0)
    assert bench.device.double.get("watchdog_s") == pytest.approx(0.02, rel=1e-9)
    bench.time.ns += 25 * MS
    bench.device.double.set("virtual_s", bench.time.s)
    bench.device.double.set("frozen", 0.0)
    from ctypes import c_byte, c_double

    place = (c_double * 3)()
    bench.device.wire._lib.dhdGetPosition(place, place, place, c_byte(0))  # type: ignore[attr-defined]
    assert bench.device.force_n == 0.0
    closed()


def test_servo_that_stood_still_after_it_had_read_the_device_takes_no_motion_for_a_jump(tmp_path: Path) -> None:
    bench = ServoBench("haply", tmp_path)
    bench.coupling = bench.coupling._replace(stiffness_n_per_m=(0.0, 0.0, 0.0), damping_n_s_per_m=(0.0, 0.0, 0.0))
    bench.at(PUSHES_S, lambda: bench.device.hand(HAND_N))
    # The hand is at 0.4 m/s by then, and 45 ms pass between the reading and its step.
    bench.at(PUSHES_S + 0.08, lambda: setattr(bench.time, "ns", bench.time.ns + 45 * MS))
    bench.run(PUSHES_S + 0.2)
    heights = [sample.position_m[2] for sample in bench.samples]
    assert max(before - after for before, after in pairwise(heights)) > 0.015
    assert {sample.gate for sample in bench.samples} <= {Gate.ACTIVE, Gate.READY, Gate.RELEASED, Gate.REST}


def test_call_of_the_scheduler_that_took_long_and_has_just_ended_is_no_silence(tmp_path: Path) -> None:
    """The scheduler calls in a thread of its own: for nine looks in a call, then a look before the next one."""
    wire = EmulatedDevice("hd", VirtualTime(), tmp_path).wire
    wire.open()
    in_call, ends, ended = threading.Event(), threading.Event(), threading.Event()
    frames: list[Any] = []

    def long_frame(turn: Any) -> bool:
        in_call.set()
        assert ends.wait(10.0)
        return len(frames) < 2

    def call() -> None:
        frames.append(None)
        scheduled[0](None)
        ended.set()

    looks: list[int] = []

    def look(duration_s: float) -> None:
        looks.append(len(frames))
        if len(looks) in (1, 12):
            ended.clear(), ends.clear(), in_call.clear()
            threading.Thread(target=call).start()
            assert in_call.wait(10.0)
        elif len(looks) in (10, 20):
            ends.set()
            assert ended.wait(10.0)

    scheduled: list[Any] = []
    lib = wire._lib  # type: ignore[attr-defined]
    patched: Any = wire
    patched._frame, patched._sleep = long_frame, look
    patched._lib = SimpleNamespace(
        hdScheduleAsynchronous=lambda kept, *rest: scheduled.append(kept) or 1,
        hdGetError=lambda: SimpleNamespace(code=0),
        **dict.fromkeys(("hdStartScheduler", "hdStopScheduler"), lambda: None),
        hdUnschedule=lambda handle: None,
    )
    wire.run(lambda sample: None)
    patched._lib = lib
    wire.close()
    assert len(looks) == 20
