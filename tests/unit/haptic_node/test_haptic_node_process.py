"""The haptic node: grid, programme, deadline on commands, e-stop, and the stamps of the loop's age."""

import itertools
from typing import Any

import numpy as np
import pytest

from services.haptic_node.node import HapticNode
from telenano.extend.hands import DeviceError
from telenano.hand.sim import SimulatedHaptic
from telenano.sections.hand_section import HapticConfig
from telenano.wire.errors import RefusedError

ZERO = (0.0, 0.0, 0.0)


class Hand:
    """A haptic node on a bench."""

    def __init__(self, bench: Any) -> None:
        self.bench = bench
        config = HapticConfig()
        self.device = SimulatedHaptic(config.to_plant_params(), config.device.start_position_m)
        self.node = HapticNode(bench.context, config, self.device)

    def command(self, x_m: float = 0.0, mode: str = "position", **changes: Any) -> None:
        fields = {
            "mode": mode,
            "position_m": (0.0, 0.0, -x_m),
            "velocity_m_per_s": ZERO,
            "force_n": ZERO,
            "hand_seq": 0,
            "hand_t_ns": self.bench.clock.now_ns(),
            **changes,
        }
        self.node.on_message(self.bench.received("haptic/command", "controller@master", **fields))

    def tick(self, count: int = 1, commanded: bool = False, late_ns: int = 0) -> None:
        for _ in range(count):
            if commanded:
                self.command()
            clock = self.bench.clock
            clock.advance_ns(max(0, self.node.deadline_ns() + late_ns - clock.monotonic_ns()))
            self.node.on_deadline(clock.monotonic_ns())

    def control(self, command: str) -> str:
        fields = {"id": "a", "command": command, "target": "haptic_node", "parameters": {}}
        return self.node.on_control(self.bench.make("session/control", "console@master", **fields))

    def states(self) -> list[Any]:
        return self.bench.take("haptic/state")


@pytest.fixture
def hand(bench_of: Any) -> Hand:
    return Hand(bench_of("haptic_node@master"))


@pytest.mark.parametrize("kind", [np.float64, np.float32])
def test_a_device_that_answers_in_numbers_of_numpy_is_published_as_any_other(
    hand: Hand, kind: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    read = hand.device.read

    def in_numpy(*given: Any) -> Any:
        sample = read(*given)
        changes = {name: kind(value) for name, value in sample._asdict().items() if type(value) is float}
        return sample._replace(**changes)

    monkeypatch.setattr(hand.device, "read", in_numpy)
    hand.tick(20, commanded=True)
    states = hand.states()
    assert len(states) == 20
    numbers = [part for state in states for part in (*state.position_m, *state.operator_force_n, state.session_s)]
    assert {type(number) for number in numbers} == {float}


def test_states_lie_on_the_grid_whatever_the_lateness(hand: Hand) -> None:
    hand.tick()
    for late in (0, 300_000, 20_000, 0):
        hand.tick(late_ns=late)
    stamps = [state.t_ns for state in hand.states()]
    assert [round((b - stamps[0]) / 1e6) for b in stamps] == [0, 1, 2, 3, 4]
    assert stamps[-1] - stamps[0] == 4_000_000


def test_missed_ticks_are_counted_and_covered(hand: Hand) -> None:
    hand.tick()
    hand.tick(late_ns=4_500_000)
    *_, state = hand.states()
    assert state.step_s == pytest.approx(5e-3, rel=1e-12, abs=0.0)
    assert hand.node.overruns == 4


def test_programme_runs_from_start_to_stop(hand: Hand) -> None:
    hand.tick(3, commanded=True)
    assert {state.session_s for state in hand.states()} == {-1.0}
    hand.control("start")
    hand.tick(1300, commanded=True)
    states = hand.states()
    assert [round(state.session_s * 1e3) for state in states[:3]] == [1, 2, 3]
    # Fig. 12: nothing until 0.8 s, 1 N towards the sample at 1.2 s
    assert states[799].operator_force_n[2] == 0.0
    assert states[1250].operator_force_n[2] == pytest.approx(-1.0, rel=1e-9, abs=0.0)
    hand.control("stop")
    hand.tick(1, commanded=True)
    (state,) = hand.states()
    assert (state.session_s, state.operator_force_n[2]) == (-1.0, 0.0)


def test_zero_is_plus_zero_on_the_wire(hand: Hand) -> None:
    hand.tick(2, commanded=True)
    assert "-0.0" not in str(hand.states()[-1].position_m)


def test_silence_takes_the_force_from_the_motor(hand: Hand) -> None:
    hand.tick(5, commanded=True)
    hand.tick(60)
    modes = [state.mode for state in hand.states()]
    assert modes[:5] == ["position"] * 5
    assert modes[40] == "position"
    assert modes[-1] == "off"
    texts = [event.text for event in hand.bench.take("session/event")]
    assert any("no command within the deadline" in text for text in texts)
    hand.tick(2, commanded=True)
    assert hand.states()[-1].mode == "position"


def test_estop_is_latched_until_armed(hand: Hand) -> None:
    hand.tick(3, commanded=True)
    hand.control("estop")
    hand.tick(3, commanded=True)
    state = hand.states()[-1]
    assert (state.mode, state.estop) == ("off", True)
    hand.control("arm")
    hand.tick(2, commanded=True)
    state = hand.states()[-1]
    assert (state.mode, state.estop) == ("position", False)


def test_force_mode_is_refused_by_this_device(hand: Hand) -> None:
    hand.command(mode="force", force_n=(0.0, 0.0, 1.0))
    hand.tick()
    assert hand.states()[-1].mode == "off"


def test_far_reference_is_approached_and_not_jumped_to(hand: Hand) -> None:
    hand.command(x_m=10e-3)
    hand.tick(1)
    state = hand.states()[-1]
    assert 0.0 < -state.reference_m[2] <= 0.03 * 1e-3 * (1 + 1e-9)
    assert state.limited


def test_limits_that_come_and_go_are_no_events(hand: Hand) -> None:
    hand.tick(2, commanded=True)
    hand.bench.take("session/event")
    for step in range(20):
        hand.command(x_m=10e-3 if step % 2 else 0.0)
        hand.tick()
    assert hand.bench.take("session/event") == []


def test_answer_is_stamped_when_it_arrives(hand: Hand) -> None:
    hand.tick(2, commanded=True)
    hand.bench.advance_ms(0.4)
    arrived = hand.bench.clock.now_ns()
    hand.command(hand_seq=1, hand_t_ns=12345)
    hand.tick()
    state = hand.states()[-1]
    assert (state.answered_seq, state.answered_t_ns, state.answered_at_ns) == (1, 12345, arrived)


def test_the_end_closes_the_device(hand: Hand) -> None:
    hand.node.make_safe()
    with pytest.raises(DeviceError):
        hand.device.read(0.0, 1e-3)


def test_unknown_commands_are_refused(hand: Hand) -> None:
    with pytest.raises(RefusedError, match="does not know mark"):
        hand.control("mark")


@pytest.mark.parametrize("link_ms", [0, 300])
@pytest.mark.parametrize(("answer_ms", "mode"), [(48, "position"), (51, "off")])
def test_a_new_command_is_as_old_as_the_sample_that_it_answers(
    hand: Hand, answer_ms: int, mode: str, link_ms: int
) -> None:
    """Both ways of the link are taken off: an answer over 2 x 150 ms is fresh, one about a second old is not."""
    hand.tick(5, commanded=True)
    for direction in ("forward", "backward"):
        hand.node.on_message(hand.bench.link_delay(direction, link_ms * 500_000))
    hand.command(hand_t_ns=hand.bench.clock.now_ns() - (answer_ms + link_ms) * 1_000_000)
    hand.tick()
    assert hand.states()[-1].mode == mode
    assert hand.node.stale == (mode == "off")


def test_a_command_that_was_sent_long_ago_is_not_followed(hand: Hand) -> None:
    hand.tick(5, commanded=True)
    old_ns = hand.bench.clock.now_ns() - 60_000_000
    hand.command(t_ns=old_ns, hand_t_ns=old_ns)
    hand.tick()
    assert hand.states()[-1].mode == "off"


def test_a_command_to_be_off_answers_nothing_and_needs_no_sample(hand: Hand) -> None:
    hand.command(mode="off", hand_t_ns=hand.bench.clock.now_ns() - 10**9)
    hand.tick()
    assert hand.node.stale == 0
    assert [event.text for event in hand.bench.take("session/event")] == ["the motor is off, as it is commanded to be"]


@pytest.mark.parametrize("stalled_ms", [200, 1000, 3000])
def test_a_device_that_stalled_lets_go_whatever_waits(hand: Hand, stalled_ms: int) -> None:
    hand.tick(5, commanded=True)
    hand.bench.take("session/event")
    hand.bench.advance_ms(stalled_ms)
    # as fresh as can be
    hand.command(x_m=5e-3)
    hand.tick()
    state = hand.states()[-1]
    assert (state.mode, state.motor_force_n) == ("off", ZERO)
    said = [event for event in hand.bench.take("session/event") if event.kind == "fault"]
    assert [event.text for event in said] == [
        # late by so much for the tick that was due a period after the last
        f"this process stalled for {stalled_ms - 1} ms: messages that waited for it are late"
    ]
    before_m = -state.position_m[2]
    hand.command(x_m=5e-3)
    hand.tick()
    state = hand.states()[-1]
    assert state.mode == "position"
    # from where it is, at the speed limit
    assert abs(-state.reference_m[2] - before_m) <= 0.03 * 1e-3 * (1 + 1e-9)


def test_a_device_that_is_late_by_less_goes_on(hand: Hand) -> None:
    hand.tick(5, commanded=True)
    hand.bench.take("session/event")
    hand.bench.advance_ms(48.0)
    hand.command()
    hand.tick()
    assert hand.states()[-1].mode == "position"
    assert hand.bench.take("session/event") == []


@pytest.mark.parametrize("rate_hz", [100, 1000, 2000])
def test_the_grid_is_that_of_the_rate_of_the_rig(bench_of: Any, rate_hz: int) -> None:
    bench = bench_of("haptic_node@master")
    bench.context.period_s = 1.0 / rate_hz
    hand = Hand(bench)
    hand.control("arm"), hand.control("start")
    hand.tick(rate_hz // 10)
    states = hand.states()
    assert {b.t_ns - a.t_ns for a, b in itertools.pairwise(states)} == {10**9 // rate_hz}
    assert {state.step_s for state in states} == {1.0 / rate_hz}
    assert states[-1].session_s == pytest.approx(0.1, rel=1e-9, abs=0.0)
    assert hand.node.period_s == 1.0 / rate_hz
