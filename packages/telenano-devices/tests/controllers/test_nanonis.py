"""The Nanonis driver against the emulator in virtual time: golden bytes, samples, each row of the table of faults."""

import math
import random
import struct
from collections.abc import Callable
from functools import partial
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
from telenano_devices.controllers.request_answer import Incoming, WireError
from telenano_devices.doubles.controller_line import Gwyscope, Nanonis
from telenano_devices.nanonis import nanonis_driver, nanonis_model, nanonis_wire
from telenano_devices.nanonis.nanonis_driver import cut_frame
from telenano_devices.nanonis.nanonis_wire import COMMANDS, NanonisRefusalError

from telenano.testing import afm_node, instrument_of, refused_laws, shorten_waits
from telenano.wire import ConfigError, RefusedError

MS = 1_000_000

NAN = math.nan
# as the vendor's client 1.0.9 sends and parses them: after the name of 32 bytes
GOLDEN = [
    (
        ("Signals.ValsGet", [0, 24, 76], 1),
        "0000001400010000 00000003 00000000 00000018 0000004c 00000001",
        "0000001800000000 00000003 30ce288f be800000 40000000 0000000000000000",
        [[1.5e-9, -0.25, 2.0]],
    ),
    (("ZCtrl.ZPosSet", -1.25e-7), "0000000400010000 b40637bd", "0000000800000000 0000000000000000", []),
    (("ZCtrl.StatusGet",), "0000000000010000", "0000000a00000000 0005 0000000000000000", [5]),
    (
        ("ZCtrl.Withdraw", 1, -1),
        "0000000800010000 00000001 ffffffff",
        "0000000800000000 0000000000000000",
        [],
    ),
    (
        ("FolMe.XYPosSet", 1e-7, -2.5e-8, 0),
        "0000001400010000 3e7ad7f29abcaf48 be5ad7f29abcaf48 00000000",
        "0000000800000000 0000000000000000",
        [],
    ),
    (
        ("Scan.FrameDataGrab", 14, 1),
        "0000000800010000 0000000e 00000001",
        "0000003500000000 00000005 5a20286d29 00000002 00000003 00000000 3f000000 3f800000 3fc00000 7fc00000 7fc00000"
        " 00000001 0000000000000000",
        ["Z (m)", np.array([[0.0, 0.5, 1.0], [1.5, NAN, NAN]], np.float32), 1],
    ),
]


# --- the wire


def named(command: str, hexadecimal: str) -> bytes:
    return command.encode().ljust(32, b"\0") + bytes.fromhex(hexadecimal)


@pytest.mark.parametrize(("call", "request_hex", "answer_hex", "values"), GOLDEN, ids=[row[0][0] for row in GOLDEN])
def test_messages_are_those_of_the_vendors_client(
    call: tuple[Any, ...], request_hex: str, answer_hex: str, values: list[Any]
) -> None:
    command, *arguments = call
    frame = nanonis_wire.request(command, *arguments)
    assert frame == named(command, request_hex)
    asked = nanonis_wire.parse_request(frame)
    assert (asked.command, asked.answers) == (command, True)
    answer = named(command, answer_hex)
    assert nanonis_wire.cut(answer) == len(answer)
    assert nanonis_wire.answer(command, nanonis_wire.pack(COMMANDS[command][1], values)) == answer
    for found, expected in zip(nanonis_wire.returned(command, answer), values, strict=True):
        np.testing.assert_equal(
            np.asarray(found, np.float32) if isinstance(found, list) else found,
            np.asarray(expected, np.float32) if isinstance(expected, list) else expected,
        )


def test_an_error_is_read_with_its_arguments_without_them_and_with_eight_bytes_more() -> None:
    text = "Error in command: zctrl.zposget: no"
    block = struct.pack(">Ii", 1, len(text)) + text.encode()
    for before in (bytes(4), b"", bytes(12)):
        body = before + block
        frame = nanonis_wire.HEADER.pack(b"zctrl.zposget", len(body), 0, 0) + body
        with pytest.raises(NanonisRefusalError, match="zposget: no"):
            nanonis_wire.returned("ZCtrl.ZPosGet", frame)


def test_damaged_answers_are_refused_and_nothing_else_is_raised() -> None:
    source = random.Random(4)
    refused = 0
    for call, _, answer_hex, _ in GOLDEN:
        for _ in range(400):
            damaged = bytearray(named(call[0], answer_hex))
            for _ in range(source.choice([1, 2, 5])):
                damaged[source.randrange(32, len(damaged))] = source.randrange(256)
            try:
                nanonis_wire.returned(call[0], bytes(damaged[: source.randrange(40, len(damaged) + 1)]))
            except (WireError, NanonisRefusalError):
                refused += 1
    assert refused > 1000
    with pytest.raises(WireError, match=r"an answer to ZCtrl.StatusGet came"):
        nanonis_wire.returned("ZCtrl.ZPosGet", nanonis_wire.answer("ZCtrl.StatusGet", b"\0\5"))


@pytest.mark.parametrize("garbage", [b"HTTP/1.1 400 Bad Request\r\n" + bytes(40), bytes(60), b"\xff" * 60])
def test_bytes_that_are_no_message_are_refused(garbage: bytes) -> None:
    incoming = Incoming(nanonis_wire.cut)
    incoming.add(garbage)
    with pytest.raises(WireError, match="is not the beginning of a message of Nanonis"):
        incoming.take()


def test_text_arrays_are_parsed_by_their_count_and_no_count_is_believed() -> None:
    # the vendor's client sends four bytes for each text in the place of all bytes
    body = struct.pack(">ii", 8, 2) + b"".join(struct.pack(">i", len(t)) + t for t in (b"Z (m)", b"Bias (V)"))
    assert nanonis_wire.unpack("S", body) == ([["Z (m)", "Bias (V)"]], len(body))
    for layout, bad in (("S", struct.pack(">ii", 8, 2**30)), ("nf", struct.pack(">i", -1)), ("M", b"\x7f" * 8)):
        with pytest.raises(WireError):
            nanonis_wire.unpack(layout, bad)


# --- the emulator


def ask(line: Nanonis, command: str, *arguments: Any) -> list[Any]:
    answer = line.served(nanonis_wire.request(command, *arguments), line.now_ns)
    assert answer is not None
    return nanonis_wire.returned(command, answer)


def test_the_emulator_says_what_a_controller_says() -> None:
    line = Nanonis(guarded=False)
    with pytest.raises(NanonisRefusalError, match="the limitation of the Z position is not enabled yet"):
        ask(line, "ZCtrl.LimitsSet", 1e-7, -1e-7)
    ask(line, "ZCtrl.OnOffSet", 1)
    with pytest.raises(NanonisRefusalError, match=r"zctrl.zposset: .*must be off"):
        ask(line, "ZCtrl.ZPosSet", 0.0)
    # switching off takes its time, and then lifts the tip
    ask(line, "ZCtrl.TipLiftSet", 5e-8)
    ask(line, "ZCtrl.OnOffSet", 0)
    assert ask(line, "ZCtrl.OnOffGet") == [1]
    before_m = line.model.z_m
    line.pass_ms(5)
    assert ask(line, "ZCtrl.OnOffGet") == [0]
    assert line.model.z_m >= min(before_m + 4.9e-8, 1e-6)
    # safe tip is set by 1 and 2, and read as 1 and 0
    for mode, read in ((1, 1), (0, 1), (2, 0)):
        ask(line, "SafeTip.OnOffSet", mode)
        assert ask(line, "SafeTip.OnOffGet") == [read]
    frame = nanonis_wire.HEADER.pack(b"tiprec.dataget", 0, 1, 0)
    answer = line.served(frame, line.now_ns)
    assert answer is not None
    assert b"Cannot access the tiprec module. \nPlease make sure it is running." in answer
    assert line.served(nanonis_wire.HEADER.pack(b"zctrl.zposget", 0, 0, 0), line.now_ns) is None
    assert len(line.served(nanonis_wire.HEADER.pack(b"zctrl.zposget", 0, 1, 0), line.now_ns) or b"") == 40 + 4 + 8


def test_the_z_controller_of_the_emulator_approaches_and_holds_its_set_point() -> None:
    line = Nanonis(guarded=False)
    ask(line, "ZCtrl.SetpntSet", 5e-3)
    ask(line, "ZCtrl.OnOffSet", 1)
    line.pass_ms(6000)
    assert ask(line, "Signals.ValGet", nanonis_model.DEFLECTION, 0) == [pytest.approx(5e-3, rel=0.02)]
    ask(line, "ZCtrl.Withdraw", 0, -1)
    line.pass_ms(50)
    assert line.model.z_m == 1e-6
    assert ask(line, "ZCtrl.StatusGet") == [1]


def test_an_image_of_the_emulator_fills_its_frames() -> None:
    line = Nanonis(guarded=False)
    ask(line, "Scan.BufferSet", [nanonis_model.Z, nanonis_model.X], 40, 3)
    assert ask(line, "Scan.BufferGet") == [[nanonis_model.Z, nanonis_model.X], 32, 3]
    ask(line, "Scan.FrameSet", 0.0, 0.0, 32e-9, 3e-9, 0.0)
    ask(line, "Scan.SpeedSet", 1e-6, 1e-6, 0.064, 0.064, 2, 1.0)
    ask(line, "Scan.Action", 0, 1)
    line.pass_ms(150)
    name, half, up = ask(line, "Scan.FrameDataGrab", nanonis_model.X, 1)
    assert (name, up) == ("X (m)", 1)
    assert np.isnan(half).any()
    assert np.isfinite(half[0]).all()
    line.pass_ms(400)
    assert ask(line, "Scan.StatusGet") == [0]
    for forward in (1, 0):
        whole = ask(line, "Scan.FrameDataGrab", nanonis_model.X, forward)[1]
        np.testing.assert_allclose(whole[1], (np.arange(32) - 15.5) * 1e-9, atol=1.1e-9)


# --- the driver


@pytest.fixture(params=[None, nanonis_model.LOG_PORT], ids=["polled", "logger"])
def line(request: Any) -> Nanonis:
    found = Nanonis(logger_port=request.param)
    found.driver.open()
    return found


def test_identifies_withdraws_protects_and_follows(line: Nanonis) -> None:
    assert line.driver.report.status == "ok"
    assert "a slow instrument (" in line.driver.report.text
    assert "what a hand feels is a model that these correct" in line.driver.report.text
    assert "is ready and retracted" in line.driver.report.text
    assert line.model.z_m == pytest.approx(5e-7)
    assert (line.model.safe_tip, line.model._values["ZCtrl.LimitsEnabled"]) == (True, [1])
    assert line.model._values["SafeTip.Props"] == [0, 0, pytest.approx(0.06)]
    line.follow(RETRACTED_M, 30)
    simulated = Nanonis(guarded=False).model._afm
    for base_m in (0.0, 8e-9, 14e-9, 20e-9):
        sample = line.follow(base_m, 120)
        same = simulated.exchange(base_m)
        assert sample.base_m == pytest.approx(base_m, abs=1e-13)
        assert sample.force_n == pytest.approx(same.force_n, rel=1e-3, abs=1e-11)
    assert line.driver.retract()
    assert line.model.z_m == pytest.approx(5e-7)


def test_a_polled_value_is_as_old_as_a_tap_and_a_frame_of_the_logger_is_not() -> None:
    ages = {}
    for port in (None, nanonis_model.LOG_PORT):
        line = Nanonis(logger_port=port)
        line.driver.open()
        line.follow(RETRACTED_M, 100)
        found = []
        for _ in range(200):
            line.follow(RETRACTED_M, 1)
            found.append(line.driver.report.age_s)
        ages[port] = max(found)
    assert 20e-3 < ages[None] <= 25e-3
    assert ages[nanonis_model.LOG_PORT] <= 5e-3


def test_a_ramp_is_followed_with_the_declared_latency() -> None:
    line = Nanonis()
    line.driver.open()
    line.follow(RETRACTED_M, 60)
    speed, lags = 1e-7, []
    for step in range(800):
        base_m = RETRACTED_M + speed * step * 1e-3
        found = line.follow(base_m, 1)
        if step > 100:
            lags.append((base_m - found.base_m) / speed)
    # z of a published value is that of the end of its Tap, so half a Tap of the declared one is the averaging
    assert np.mean(lags) == pytest.approx(line.driver.latency_s - 10e-3, abs=2e-3)


def test_frames_of_a_logger_are_cut_and_others_refused() -> None:
    frame = struct.pack(">IfQH", 2, 1.0, 7, 4) + struct.pack(">2f", 1.0, 2.0)
    assert cut_frame(frame + b"xyz") == len(frame)
    assert cut_frame(frame[:-1]) == 0
    with pytest.raises(WireError, match="is not the beginning of a frame"):
        cut_frame(b"\xff" * 20)


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({"safe_tip": None}, "controller.yaml: safe_tip: Input should be a valid number"),
        ({"deflection": {"signal": "Bias"}}, "has no signal 'Bias'"),
        ({"z": {"towards_sample": 1}}, "is not further from the sample"),
    ],
)
def test_calibration_that_would_not_do_is_refused(changes: Any, text: str) -> None:
    with pytest.raises(ConfigError, match=text):
        Nanonis(**changes).driver.open()


def test_a_law_with_a_loop_and_a_program_of_the_node_are_refused_in_words(bench_of: Any) -> None:
    refused = refused_laws("nanonis")
    assert not {"model_mediated", "tactile"} & set(refused)
    assert "wave closes a loop through the instrument, and nanonis gives 50 samples" in refused["wave"]
    section = {"driver": "nanonis", "nanonis": {"calibration": "nanonis.yaml"}}
    bench, line = bench_of("afm_node@slave"), Nanonis()
    node = afm_node(bench, line.driver, section)
    fields = {"id": "a", "command": "set", "target": "afm_node", "parameters": {"program": "curve"}}
    with pytest.raises(RefusedError, match=r"curve regulates the tip in the node .* let the controller do that itself"):
        node.on_control(bench.make("session/control", "console@slave", **fields))


# --- another channel

FEEL = {
    "channel": "frequency_shift", "unit": "Hz", "table": [[-0.5, 0.0], [-4.0, 1e-9], [-7.5, 3e-9]], "tolerance": 0.05,
    "slope_limit_n_per_unit": 1e-9, "rate_limit_n_per_s": 1e-3,
}  # fmt: skip
SHIFT = {"frequency_shift": {"signal": "OC M1 Freq. Shift (Hz)"}}


def frequency_shift_hz(z_m: Any) -> Any:
    """Return a frequency shift with its minimum of -8 Hz at 0.4 nm [Hz]."""
    u = np.asarray(z_m) / 0.4e-9
    return -8.0 * u * np.exp(1.0 - u)


def shift_map(tmp_path: Path) -> dict[str, Any]:
    """Return the section of a map of a frequency shift, which falls from 2 nm to its minimum at 0.4 nm."""
    z = np.linspace(0.0, 2e-9, 401)
    place = {"x": np.zeros(1), "y": np.zeros(1), "z": z, "length_unit": "m"}
    np.savez(tmp_path / "shift.npz", value=frequency_shift_hz(z)[None, None], unit="Hz", **place)
    return {"sample": {"map": str(tmp_path / "shift.npz")}, "rest_distance_m": 2e-9, "feel": FEEL}


@pytest.mark.parametrize(
    "port", [None, pytest.param(nanonis_model.LOG_PORT, marks=pytest.mark.endurance)], ids=["polled", "logger"]
)
def test_a_frequency_shift_is_felt_through_the_driver(bench_of: Any, tmp_path: Path, port: int | None) -> None:
    pytest.importorskip("telenano_lab.afm_files", reason="a map of npz is what is felt")
    line = Nanonis(afm=instrument_of(shift_map(tmp_path)), channels=SHIFT, logger_port=port)
    line.model._values["ZCtrl.WithdrawRate"] = [1e-3]
    config = {"driver": "nanonis", "nanonis": {"calibration": "nanonis.yaml"}, "feel": FEEL}
    rig = ControllerRig(bench_of("afm_node@slave"), line, config)
    rig.tick(80, RETRACTED_M)
    rig.control("arm", place="hand")
    rig.tick(700, 0.0)
    for z_m in (1.9e-9, 1.5e-9, 1.1e-9, 0.9e-9, 0.7e-9):
        rig.tick(80, 2e-9 - z_m)
        state = rig.bench.take("afm/state")[-1]
        expected = float(frequency_shift_hz(z_m))
        assert (state.mode, state.felt_channel) == ("follow", "frequency_shift")
        assert state.felt_value == pytest.approx(expected, rel=1e-4)
        assert state.tip_force_n[2] == pytest.approx(
            np.interp(-expected, [0.5, 4.0, 7.5], [0.0, 1e-9, 3e-9]), rel=1e-3, abs=1e-13
        )
    # beyond the last row the branch is left
    rig.tick(80, 2e-9 - 0.45e-9)
    assert rig.bench.take("afm/state")[-1].mode in ("retracting", "retracted")
    texts = [event.text for event in rig.bench.take("session/event")]
    assert sum("has left the branch of feel.table: the tip retracts" in text for text in texts) == 1


def test_a_signal_that_the_controller_has_not_is_refused_by_its_key() -> None:
    line = Nanonis(channels={"current": {"signal": "Amperes"}})
    with pytest.raises(ConfigError, match="has no signal 'Amperes': the signal of each of channels must be one"):
        line.driver.open()
    with pytest.raises(ConfigError, match="channels: the driver of a Gwyscope reads the deflection only"):
        Gwyscope(channels=SHIFT)


# --- faults


def garble(line: Nanonis) -> None:
    line.to_host = lambda sent: b"HTTP/1.1 400 Bad Request\r\n" + bytes(40)


def cut(line: Nanonis) -> None:
    line.to_host = lambda sent: sent[:30]


def refuse(line: Nanonis) -> None:
    line.model.locked = "The module is locked."


def clamp(line: Nanonis) -> None:
    line.model._move_z = lambda z_m: None  # type: ignore[method-assign]
    line.model.z_m -= 2e-8


def unclamp(line: Nanonis) -> None:
    del line.model._move_z


def press_safe_tip(line: Nanonis) -> None:
    line.model._values["SafeTip.Props"][2] = -1.0


def release_safe_tip(line: Nanonis) -> None:
    line.model._values["SafeTip.Props"][2] = 0.06


def others(*calls: tuple[Any, ...]) -> Callable[[Nanonis], None]:
    """Return what somebody does at the vendor's screen, without the guard."""

    def begin(line: Nanonis) -> None:
        for command, *arguments in calls:
            ask(line, command, *arguments)

    return begin


def slow_down(line: Nanonis) -> None:
    line.latency_ms = 40.0


def saturate(line: Nanonis) -> None:
    usual, line.model.safe_tip = line.model._move_z, False

    def move(z_m: float) -> None:
        usual(z_m)
        line.model._bridge_v = 11.0

    line.model._move_z = move  # type: ignore[method-assign]


SEIZED = "another program has moved the tip"
fault = partial(Fault, duration_ms=120, at_ms=30)
FAULTS = {
    "connection lost": fault(interrupt, "the connection is gone", duration_ms=40),
    "server killed": fault(kill, "the connection is gone", at_ms=None, duration_ms=40),
    "server stopped": fault(stop, "has been silent for 250 ms", duration_ms=300, at_ms=None),
    "server swallows": fault(swallow, "does not answer: check address, cable and firewall", duration_ms=500, at_ms=30),
    "garbage": fault(garble, "is not the beginning of a message"),
    "half answers": fault(cut, "the connection is gone", duration_ms=90, at_ms=80),
    "two answers": fault(answer_twice, "has sent more answers than there were requests"),
    "command refused": fault(refuse, "The module is locked.", at_ms=None),
    "z is not taken": fault(clamp, SEIZED, at_ms=None, end=unclamp, moves=True),
    "safe tip latched": fault(press_safe_tip, "The Safe Tip has been triggered", end=release_safe_tip),
    "z moved from outside": fault(others(("ZCtrl.ZPosSet", 4e-7), ("Util.AcqPeriodSet", 1e-3)), SEIZED, at_ms=60),
    "z-controller from outside": fault(others(("ZCtrl.OnOffSet", 1)), "must be off", at_ms=30),
    "withdrawn from outside": fault(others(("ZCtrl.Withdraw", 0, -1)), "must be off"),
    "slow controller": fault(slow_down, status="stale", duration_ms=400, at_ms=None, retracts=""),
    # the value of a Tap is an average, which is beyond the force limit before it is beyond the input
    "input out of range": fault(saturate, status="ok", at_ms=None, retracts="force_limit", end=unclamp, moves=True),
}


@pytest.fixture
def rig(bench_of: Any, monkeypatch: pytest.MonkeyPatch) -> ControllerRig:
    shorten_waits(monkeypatch, retry_ms=100, step_ms=300)
    found = ControllerRig(bench_of("afm_node@slave"), Nanonis())
    approach(found)
    return found


def approach(rig: ControllerRig) -> None:
    """Arm, and follow to the place near the sample."""
    rig.tick(80, NEAR_M)
    rig.arm_and_follow_to(NEAR_M)
    rig.tick(100, NEAR_M)
    state = rig.bench.take("afm/state")[-1]
    assert (state.mode, state.device) == ("follow", "ok")


@pytest.mark.parametrize("name", FAULTS)
def test_fault(rig: ControllerRig, name: str) -> None:
    walk(rig, FAULTS[name])
    if FAULTS[name].retracts:
        approach(rig)


def test_scan_that_somebody_runs_is_not_disturbed(rig: ControllerRig) -> None:
    ask(rig.line, "Scan.Action", 0, 1)
    z_m = rig.line.model.z_m
    rig.line.close()
    rig.line.judge.driven = rig.line.judge.due = False
    rig.tick(150)
    texts = [event.text for event in rig.bench.take("session/event")]
    assert any("is scanning: end that in its own software first; it was not driven" in text for text in texts)
    assert rig.line.model.z_m == z_m


@pytest.mark.parametrize("heartbeat_s", [0.02, 0.05, 0.2])
def test_process_that_dies_leaves_the_tip_withdrawn_by_the_guard(heartbeat_s: float) -> None:
    line = Nanonis(heartbeat_s=heartbeat_s)
    line.driver.open()
    line.follow(RETRACTED_M, 60)
    line.follow(NEAR_M, 60)
    silent_ms = 0
    while line.model.z_m < 5e-7 - 1e-12:
        line.pass_ms(1)
        silent_ms += 1
        assert silent_ms < 1000
    # the withdraw rate of 100 um/s goes on for half a micrometre
    assert heartbeat_s * 1e3 <= silent_ms <= heartbeat_s * 1e3 + 10


def test_logger_that_falls_silent_is_a_loss(bench_of: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    line = Nanonis(logger_port=nanonis_model.LOG_PORT)
    line.driver.open()
    line.follow(RETRACTED_M, 60)
    line.model.log.state = 1
    line.follow(RETRACTED_M, 260)
    assert "its TCP Logger has sent no frame for 250 ms" in line.driver.report.text
    assert nanonis_driver.GUARD_COMMAND


@pytest.mark.parametrize(
    ("begin", "text"),
    [
        pytest.param(refuse, "refuses ZCtrl.Withdraw.*The module is locked", id="refuses"),
        pytest.param(stop, "is connected and does not answer requests: is it a Nanonis", id="stopped"),
        pytest.param(kill, "cannot be reached: Connection refused", id="killed"),
        pytest.param(swallow, "does not answer: check address, cable and firewall", id="blackholed"),
        pytest.param(garble, "is not the beginning of a message of Nanonis", id="garbage at the start"),
    ],
)
def test_refused_start(bench_of: Any, begin: Any, text: str) -> None:
    refuses_to_start(bench_of("afm_node@slave"), Nanonis(guarded=False, attended=True), begin, text)
