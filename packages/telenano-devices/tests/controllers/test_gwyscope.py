"""The Gwyscope driver against the emulator in virtual time: wire, samples, and each row of the table of faults."""

import math
import random
import re
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from controller_faults import (
    NEAR_M,
    RETRACTED_M,
    ControllerRig,
    Fault,
    answer_twice,
    interrupt,
    kill,
    refuses_to_start,
    stop,
    swallow,
    walk,
)
from telenano_devices.controllers.piezo_calibration import ControllerCalibration
from telenano_devices.controllers.request_answer import Incoming, WireError
from telenano_devices.controllers.retract_guard import SilenceJudge
from telenano_devices.doubles.controller_line import PARAMS, Gwyscope
from telenano_devices.gwyscope import gwyscope_model, gwyscope_wire
from telenano_devices.gwyscope.gwyscope_calibration import GwyscopeCalibration
from telenano_devices.gwyscope.gwyscope_model import AssertionOfTheServerError
from telenano_devices.nanonis.nanonis_calibration import NanonisCalibration

from telenano.extend.instruments import DeviceError
from telenano.testing import afm_config, instrument_of, shorten_waits
from telenano.wire import ConfigError, RefusedError

gwyfile: Any = pytest.importorskip("gwyfile", reason="the messages are compared with those of gwyfile")

MS = 1_000_000

# of the base in the three periods of the longest cycle, at the guard's speed
# The base takes what the guard lets it go in the 3 or 4 ms between two samples of the server.
STEP_M = PARAMS.safety.base_speed_m_per_s * 4.003e-3
GOLDEN = {
    "4753000b000000746f646f00737265616400": {"todo": "read"},
    "4753002e000000746f646f00737365745f666565646261636b00666565646261636b0062007a7069657a6f00643fabcc94d6dfd23e": {
        "todo": "set_feedback",
        "feedback": False,
        "zpiezo": 4.5e-6,
    },
}


# --- the wire


@pytest.mark.parametrize("golden", GOLDEN)
def test_messages_are_those_of_gwyfile_byte_for_byte(golden: str) -> None:
    assert gwyscope_wire.encode(GOLDEN[golden]).hex() == golden
    assert gwyscope_wire.decode(bytes.fromhex(golden)) == GOLDEN[golden]
    assert gwyfile.objects.GwyObject("GS", GOLDEN[golden]).serialize().hex() == golden


def test_every_type_goes_there_and_back_and_gwyfile_reads_the_same() -> None:
    data = np.array([1e-9, -2.0, 3e300])
    message = {"todo": "get", "flag": True, "n": -7, "x": 1.5e-9, "D": data}
    frame = gwyscope_wire.encode(message)
    found = gwyscope_wire.decode(frame)
    assert {key: value for key, value in found.items() if key != "D"} == {k: v for k, v in message.items() if k != "D"}
    assert found["D"].tolist() == data.tolist()
    theirs = gwyfile.objects.GwyObject.frombuffer(frame)
    assert (theirs["n"], theirs["x"], theirs["flag"], theirs["D"].tolist()) == (-7, 1.5e-9, True, data.tolist())
    with pytest.raises(TypeError, match="a NoneType has no letter"):
        gwyscope_wire.encode({"x": None})


def test_stream_that_comes_in_any_pieces_is_cut_into_its_messages() -> None:
    source = random.Random(3)
    messages = [gwyscope_wire.encode({"todo": "read", "n": number}) for number in range(40)]
    stream, incoming, found = b"".join(messages), Incoming(gwyscope_wire.cut), []
    while stream:
        size = source.choice([1, 2, 3, 7, 50])
        incoming.add(stream[:size])
        stream = stream[size:]
        while (message := incoming.take()) is not None:
            found.append(message)
    assert found == messages
    assert incoming.pending == 0


@pytest.mark.parametrize("garbage", [b"HTTP/1.1", b"X", b"GS\0\xff\xff\xff\x7f", b"GX\0"])
def test_bytes_that_are_no_message_are_refused(garbage: bytes) -> None:
    incoming = Incoming(gwyscope_wire.cut)
    incoming.add(garbage)
    with pytest.raises(WireError):
        incoming.take()


def test_damaged_messages_are_refused_and_nothing_else_is_raised() -> None:
    source, whole = random.Random(5), gwyscope_wire.encode({"todo": "read", "x": 1.0, "D": np.zeros(4)})
    refused = 0
    for _ in range(2000):
        damaged = bytearray(whole)
        for _ in range(source.choice([1, 2, 5])):
            damaged[source.randrange(len(damaged))] = source.randrange(256)
        try:
            gwyscope_wire.decode(bytes(damaged[: source.choice([len(damaged), source.randrange(len(damaged))])]))
        except WireError:
            refused += 1
    assert refused > 500


# --- the driver


@pytest.fixture
def line() -> Gwyscope:
    found = Gwyscope()
    found.driver.open()
    return found


def test_identifies_measures_the_tick_retracts_and_follows(line: Gwyscope) -> None:
    assert line.driver.report.status == "ok"
    assert "Gwyscope 4.1.19 (telenano's emulator), a sample every 3 ms is ready" in line.driver.report.text
    assert line.model.z_m == 0.0
    line.follow(RETRACTED_M, 600)
    sample = line.follow(0.0, 300)
    assert sample.base_m == pytest.approx(0.0, abs=1e-15)
    assert not sample.distance_valid
    assert line.driver.retract()
    assert line.model.z_m == 0.0


@pytest.mark.parametrize("tick_ms", [1.0, 3.0, 7.0])
def test_the_tick_is_measured_by_the_stamps_of_the_server(tick_ms: float) -> None:
    line = Gwyscope(tick_s=tick_ms * 1e-3)
    line.driver.open()
    assert line.driver.tick_s == pytest.approx(tick_ms * 1e-3, rel=1e-6)
    assert line.driver.latency_s == pytest.approx(2.5e-3 + 0.5e-3 * tick_ms, rel=1e-6)


def test_a_ramp_is_followed_with_the_declared_latency(line: Gwyscope) -> None:
    line.follow(RETRACTED_M, 600)
    speed = 1e-7
    lags = []
    for step in range(600):
        base_m = RETRACTED_M + speed * step * 1e-3
        found = line.follow(base_m, 1)
        if step > 50:
            lags.append((base_m - found.base_m) / speed)
    assert np.mean(lags) == pytest.approx(line.driver.latency_s, abs=0.6e-3)


def test_force_is_that_of_the_simulated_instrument() -> None:
    line = Gwyscope()
    line.driver.open()
    simulated = instrument_of()
    simulated.open()
    line.follow(RETRACTED_M, 600)
    for base_m in (0.0, 8e-9, 14e-9, 20e-9):
        sample = line.follow(base_m, 40)
        same = simulated.exchange(base_m)
        assert sample.force_n == pytest.approx(same.force_n, rel=1e-6, abs=1e-15)
        assert sample.in_contact == (sample.force_n > 1e-9)


def test_age_of_a_sample_is_the_oldest_that_it_can_be(line: Gwyscope) -> None:
    line.follow(RETRACTED_M, 20)
    ages = []
    for _ in range(100):
        line.follow(RETRACTED_M, 1)
        ages.append(line.driver.report.age_s)
    # the tick, a cycle of two periods, and the period until it is looked at
    assert min(ages) > 3e-3
    assert max(ages) <= 3e-3 + 3e-3 + 3e-3 + 1e-9


def test_tip_goes_over_the_sample_while_z_is_the_rigs(line: Gwyscope) -> None:
    line.follow(RETRACTED_M, 600)
    line.follow(NEAR_M, 60)
    stage = line.driver.stage
    assert stage is not None
    heights = []
    for step in range(300):
        stage.move_to(step * 2e-9, -step * 1e-9)
        line.follow(NEAR_M, 1)
        heights.append(line.base_m)
    line.follow(NEAR_M, 30)
    assert line.driver.report.status == "ok"
    assert (line.model.x_m, line.model.y_m) == (
        pytest.approx(gwyscope_model.CENTRE_M + 299 * 2e-9, abs=1e-12),
        pytest.approx(gwyscope_model.CENTRE_M - 299e-9, abs=1e-12),
    )
    assert heights == [pytest.approx(NEAR_M, abs=1e-12)] * len(heights)
    with pytest.raises(ValueError, match="within the reach"):
        stage.move_to(6e-5, 0.0)
    with pytest.raises(ValueError, match="finite"):
        stage.move_to(math.nan, 0.0)


@pytest.mark.endurance
def test_an_image_by_the_node_is_that_of_the_sample_with_a_gain_that_the_latency_permits(bench_of: Any) -> None:
    config = {"sample": {"name": "dots"}, "cantilever": {"stiffness_n_per_m": 1.0}}
    line = Gwyscope(config=instrument_of(config), cantilever={"stiffness_n_per_m": 1.0})
    rig = ControllerRig(bench_of("afm_node@slave"), line, config)
    scan = {"width_m": 60e-9, "depth_m": 10e-9, "pixels": 32, "lines": 1, "dwell_s": 20e-3}
    wanted = {f"scan.{key}": value for key, value in scan.items()}
    rig.tick(8)
    with pytest.raises(RefusedError, match=r"scan.gain_per_s .* makes the feedback unstable .* below 222.222 1/s"):
        rig.control("set", program="scan", **wanted)
    rig.control("set", program="scan", **wanted, **{"scan.gain_per_s": 150.0, "scan.approach_m_per_s": 2e-7})
    lines: list[Any] = []
    for _ in range(6000):
        rig.tick(1)
        lines += rig.bench.take("afm/scanline")
        if len(lines) == 2:
            break
    surface = afm_config(config).to_surface()
    assert surface is not None
    xs = ((np.arange(32) + 0.5) / 32 - 0.5) * 60e-9 + 0.5 * surface.width_m
    truth = surface.height_m[surface.height_m.shape[0] // 2, (xs / surface.step_x_m).astype(int)]
    assert np.ptp(truth) > 3e-9
    for found in lines:
        assert np.corrcoef(found.height_m.to_numpy(), truth)[0, 1] > 0.9


def test_a_driver_that_compares_z_and_notes_none_is_told_what_is_missing(line: Gwyscope) -> None:
    # A driver that is ready has sent the z of the safe state, and noted it.
    line.driver.check_z(line.driver.calibration.z.retract_m, line.now_ns)
    line.driver._history.clear()
    with pytest.raises(DeviceError, match="has none: its talk appends each z to `_history` first"):
        line.driver.check_z(line.driver.calibration.z.retract_m, line.now_ns)


def test_every_item_that_the_driver_sends_has_the_type_that_the_server_asserts(line: Gwyscope) -> None:
    """The model raises on a wrong one, as the server ends; and so it does for a number that is no float."""
    with pytest.raises(AssertionOfTheServerError, match="zpiezo is a int"):
        line.model.respond({"todo": "set_feedback", "feedback": False, "zpiezo": 0}, line.now_ns)
    line.follow(RETRACTED_M, 5)
    stage = line.driver.stage
    assert stage is not None
    stage.move_to(0, 0)
    line.follow(np.float64(NEAR_M), 20)
    assert line.driver.report.status == "ok"


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({"z": {"retract_m": 1e-7}}, r"z.retract_m = 1e-07 m: a server that ends puts z to 0 m and would not retract"),
        ({"z": {"towards_sample": -1}}, r"retract_m = 0.0 m is not further from the sample than rest_m = 2e-06 m"),
        ({"z": {"towards_sample": 0}}, "z.towards_sample"),
        (
            {"z": {"max_m": 2.1e-6}},
            r"safety.base_max_m = 2e-07 m needs z = 2.2e-06 m, the file allows 0.0 m to 2.1e-06",
        ),
        ({"deflection": {"per_m": 0.0}}, "per_m = 0.0 must be"),
        ({"heartbeat_s": 0.001}, "heartbeat_s"),
    ],
)
def test_calibration_that_would_not_keep_the_tip_safe_is_refused(changes: Any, text: str) -> None:
    with pytest.raises(ConfigError, match=text):
        Gwyscope(**changes)


@pytest.mark.parametrize(("controller", "model"), [("gwyscope", GwyscopeCalibration), ("nanonis", NanonisCalibration)])
def test_calibration_of_the_document_is_valid(
    controller: str, model: type[ControllerCalibration], tmp_path: Path
) -> None:
    page = (Path(__file__).parents[2] / "docs" / "afm-controllers.md").read_text()
    (block,) = re.findall(rf"```yaml\n(schema: 1\ncontroller: {controller}\n.*?)```", page, re.DOTALL)
    (tmp_path / "controller.yaml").write_text(block)
    found = model.from_file(tmp_path / "controller.yaml")
    assert found.check(PARAMS.safety) == []


# --- faults


def stand(line: Gwyscope) -> None:
    line.model.stands = True


def garble(line: Gwyscope) -> None:
    line.to_host = lambda sent: b"HTTP/1.1 400 Bad Request\r\n"


def cut(line: Gwyscope) -> None:
    line.to_host = lambda sent: sent[:9]


def refuse(line: Gwyscope) -> None:
    line.respond = lambda request, now_ns: gwyscope_wire.encode({"todo": "unknown"})


def clamp(line: Gwyscope) -> None:
    """Have a controller that takes z and goes elsewhere, as at the end of its own range."""

    def respond(request: bytes, now_ns: int) -> bytes | None:
        message = gwyscope_wire.decode(request)
        if message["todo"] == "set_feedback" and message["zpiezo"] > 0.0:
            message["zpiezo"] -= 1e-7
        return line.served(gwyscope_wire.encode(message), now_ns)

    line.respond = respond


def keep_feedback(line: Gwyscope) -> None:
    """Have a feedback that cannot be switched off."""

    def respond(request: bytes, now_ns: int) -> bytes | None:
        answer = gwyscope_wire.decode(line.served(request, now_ns) or b"")
        if answer["todo"] == "set_feedback" and gwyscope_wire.decode(request)["zpiezo"] > 0.0:
            answer["feedback"] = True
        return gwyscope_wire.encode(answer)

    line.respond = respond


def others(*messages: dict[str, Any]) -> Callable[[Gwyscope], None]:
    """Return what somebody does by another program, without the guard."""

    def begin(line: Gwyscope) -> None:
        for message in messages:
            line.model.respond(message, line.now_ns)
        line.model.pass_time(line.now_ns + 3 * MS)

    return begin


def slow_down(line: Gwyscope) -> None:
    line.latency_ms = 25.0


def saturate(line: Gwyscope) -> None:
    line.model._sample["adc1"] = 11.0
    line.model._measure = lambda: line.model._sample.update(  # type: ignore[method-assign]
        ts=(line.model._ticked_ns - 10**9) / 1e9, z=line.model.z_m, adc1=11.0
    )


def desaturate(line: Gwyscope) -> None:
    del line.model._measure


SEIZED = "another program has moved the tip"
FAULTS = {
    "connection lost": Fault(interrupt, "the connection is gone", duration_ms=20),
    "server killed": Fault(kill, "the connection is gone", at_ms=None),
    "server stopped": Fault(stop, "has been silent for 50 ms", duration_ms=140, at_ms=None),
    "server swallows": Fault(swallow, "does not answer: check address, cable and firewall", duration_ms=300, at_ms=60),
    "loop stands": Fault(stand, "the server answers, but its loop does not run", duration_ms=140, at_ms=110),
    "garbage": Fault(garble, "is not the beginning of a message"),
    "half answers": Fault(cut, "has been silent for 50 ms", duration_ms=140, at_ms=110),
    "two answers": Fault(answer_twice, "has sent more answers than there were requests"),
    "command refused": Fault(refuse, "did not carry out", at_ms=None),
    "z is not taken": Fault(clamp, "did not set z: 1.93e-06 m was sent, and it reports 1.83e-06 m"),
    "feedback latched": Fault(keep_feedback, "cannot be driven: feedback stays on"),
    "z moved from outside": Fault(others({"todo": "set_feedback", "feedback": False, "zpiezo": 1.9e-6}), SEIZED),
    "feedback from outside": Fault(
        others({"todo": "set", "pid_setpoint": 0.01, "pid_i": -1e-3}, {"todo": "set_feedback", "feedback": True}),
        SEIZED,
    ),
    "tip moved over the sample": Fault(
        others({"todo": "set_scan", "speed": 1e-3}, {"todo": "move_to", "xreq": 6e-5, "yreq": 5e-5, "zreq": 1.93e-6}),
        SEIZED,
    ),
    "slow controller": Fault(slow_down, status="stale", duration_ms=200, at_ms=None, retracts=""),
    "input out of range": Fault(saturate, status="ok", at_ms=None, retracts="force_invalid", end=desaturate),
}


@pytest.fixture
def rig(bench_of: Any, monkeypatch: pytest.MonkeyPatch) -> ControllerRig:
    shorten_waits(monkeypatch, retry_ms=100, step_ms=150)
    found = ControllerRig(bench_of("afm_node@slave"), Gwyscope())
    approach(found)
    return found


def approach(rig: ControllerRig) -> None:
    """Arm, and follow to the place near the sample, no faster than the guard lets the base go."""
    rig.tick(8, NEAR_M)
    bases = rig.arm_and_follow_to(NEAR_M)
    assert max(b - a for a, b in pairwise(bases)) <= STEP_M
    # and a place over the sample that it has reached
    rig.tick(40, NEAR_M, (1e-8, 0.0))
    state = rig.bench.take("afm/state")[-1]
    assert (state.mode, state.device) == ("follow", "ok")


@pytest.mark.parametrize("name", FAULTS)
def test_fault(rig: ControllerRig, name: str) -> None:
    walk(rig, FAULTS[name], (1e-8, 0.0))
    if FAULTS[name].retracts:
        approach(rig)


def test_scan_that_somebody_runs_is_not_disturbed(rig: ControllerRig) -> None:
    rig.line.close()
    rig.line.model.values["scanning_line"] = True
    rig.line.model.z_m = 1.0e-6
    rig.line.judge.driven = rig.line.judge.due = False
    rig.tick(150)
    texts = [event.text for event in rig.bench.take("session/event")]
    assert any("is busy (scanning_line): end that in its own software first" in text for text in texts)
    assert rig.line.model.z_m == 1.0e-6


@pytest.mark.parametrize("heartbeat_s", [0.02, 0.05, 0.2])
def test_process_that_dies_leaves_the_tip_retracted_by_the_guard(heartbeat_s: float) -> None:
    line = Gwyscope(heartbeat_s=heartbeat_s)
    line.driver.open()
    line.follow(RETRACTED_M, 5)
    line.follow(NEAR_M, 60)
    silent_ms = 0
    while line.model.z_m > 0.0:
        line.pass_ms(1)
        silent_ms += 1
        assert silent_ms < 1000
    assert heartbeat_s * 1e3 <= silent_ms <= heartbeat_s * 1e3 + 2
    assert line.judge is not None
    assert line.judge.trips == 1
    # the process was held up only: it finds its connection gone, and stays retracted until the guard has the tip there
    for _ in range(800):
        line.follow(NEAR_M, 1)
        assert line.model.z_m == 0.0
    assert line.driver.report.status == "ok"


def test_pause_of_a_host_whose_tip_is_retracted_is_no_loss(line: Gwyscope) -> None:
    line.follow(RETRACTED_M, 1)
    assert line.driver.retract()
    line.pass_ms(500)
    line.follow(line.driver.safe_position_m, 5)
    assert line.driver.report.status == "ok"
    assert line.judge is not None
    assert line.judge.trips == 0


def test_guard_retracts_first_and_lets_nobody_in_before() -> None:
    line = Gwyscope()
    line.model.respond({"todo": "set_feedback", "feedback": False, "zpiezo": 1.99e-6}, line.now_ns)
    line.judge = SilenceJudge(line.guarded)
    assert line.judge.due
    with pytest.raises(OSError, match="refused"):
        line.connect("", 0)
    line.pass_ms(1)
    assert line.model.z_m == 0.0
    assert not line.judge.due


def test_a_driver_that_fails_in_its_retraction_is_told_and_its_connection_ended(rig: ControllerRig) -> None:
    """The driver of a package may raise anything, and that kept event and end from being done."""
    closed: list[bool] = []

    def fail() -> bool:
        raise ZeroDivisionError("the fault")

    def close() -> None:
        closed.append(True)
        fail()

    rig.line.driver.retract, rig.line.driver.close = fail, close
    rig.node.make_safe()
    assert closed
    texts = [event.text for event in rig.bench.take("session/event")]
    assert any("no retraction of the tip (an unexpected answer: ZeroDivisionError" in text for text in texts)


@pytest.mark.parametrize(
    ("begin", "text"),
    [
        pytest.param(refuse, "did not carry out get: it answered 'unknown'", id="refuses"),
        pytest.param(stop, "is connected and does not answer requests: is it a Gwyscope", id="stopped"),
        pytest.param(kill, "cannot be reached: Connection refused", id="killed"),
        pytest.param(swallow, "does not answer: check address, cable and firewall", id="blackholed"),
        pytest.param(stand, "its samples do not advance: start the loop of the server", id="loop stands at the start"),
        pytest.param(garble, "is not the beginning of a message of a Gwyscope", id="garbage at the start"),
    ],
)
def test_refused_start(bench_of: Any, begin: Any, text: str) -> None:
    refuses_to_start(bench_of("afm_node@slave"), Gwyscope(guarded=False, attended=True), begin, text)
