"""The AFM as a node: one state a command, a thousand a second without any, and what it does about silence."""

from typing import Any

import numpy as np
import pytest

from services.afm_node.node import AfmNode
from telenano.afm.sim import simulated_afm
from telenano.sections.afm_section import AfmConfig
from telenano.wire.errors import RefusedError


class Instrument:
    """An AFM on a bench."""

    def __init__(self, bench: Any) -> None:
        self.bench = bench
        config = AfmConfig()
        self.driver = simulated_afm(config.to_params())
        self.node = AfmNode(bench.context, config, self.driver)

    def command(
        self,
        x_s_m: float = 0.0,
        mode: str = "position",
        hand_seq: int = 7,
        hand_ms: float = 0.0,
        armed: bool | None = True,
    ) -> None:
        """Receive a command that descends from a sample of the hand taken so long ago [ms]."""
        fields = {"mode": mode, "base_position_m": (0.0, 0.0, -x_s_m), "hand_seq": hand_seq, "hand_armed": armed}
        fields["hand_t_ns"] = self.bench.clock.now_ns() - round(hand_ms * 1e6)
        self.node.on_message(self.bench.received("afm/command", "controller@slave", **fields))

    def waited(self, waited_ms: float, x_s_m: float = 0.0) -> None:
        """Receive a command that was sent so long ago [ms]."""
        sent_ns = self.bench.clock.now_ns() - round(waited_ms * 1e6)
        fields = {"mode": "position", "base_position_m": (0.0, 0.0, -x_s_m), "hand_seq": 7, "hand_armed": True}
        received = self.bench.received("afm/command", "controller@slave", **fields, hand_t_ns=sent_ns, t_ns=sent_ns)
        self.node.on_message(received)

    def pass_ms(self, duration_ms: float, every_ms: float | None = None) -> None:
        """Let time pass, with a command every so often."""
        clock = self.bench.clock
        end = clock.monotonic_ns() + round(duration_ms * 1e6)
        while clock.monotonic_ns() < end:
            if every_ms is not None:
                clock.advance_ns(round(every_ms * 1e6))
                self.command()
                continue
            clock.advance_ns(max(0, self.node.deadline_ns() - clock.monotonic_ns()))
            self.node.on_deadline(clock.monotonic_ns())

    def control(self, command: str, **parameters: Any) -> str:
        fields = {"id": "a", "command": command, "target": "afm_node", "parameters": parameters}
        return self.node.on_control(self.bench.make("session/control", "console@master", **fields))

    def states(self) -> list[Any]:
        return self.bench.take("afm/state")


@pytest.fixture
def afm(bench_of: Any) -> Instrument:
    return Instrument(bench_of("afm_node@slave"))


def follow(afm: Instrument) -> None:
    """Arm, and let the base reach its rest point."""
    afm.command()
    afm.control("arm", place="hand")
    afm.pass_ms(80.0, every_ms=1.0)
    afm.states()


@pytest.mark.parametrize("kind", [np.float64, np.float32])
def test_an_instrument_that_answers_in_numbers_of_numpy_is_published_as_any_other(
    afm: Instrument, kind: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    exchange, kinds = afm.driver.exchange, {float: kind, bool: np.bool_}
    monkeypatch.setattr(
        afm.driver,
        "exchange",
        lambda base_m: (sample := exchange(base_m))._replace(
            **{name: kinds[type(value)](value) for name, value in sample._asdict().items()}
        ),
    )
    follow(afm)
    afm.pass_ms(20.0, every_ms=1.0)
    states = afm.states()
    assert len(states) >= 20
    numbers = [part for state in states for part in (state.deflection_m, *state.base_position_m, *state.tip_force_n)]
    assert {type(number) for number in numbers} == {float}
    assert {type(state.in_contact) for state in states} == {bool}


def test_a_command_is_answered_at_once_with_its_number(afm: Instrument) -> None:
    sampled_ns = afm.bench.clock.now_ns()
    afm.command(hand_seq=41)
    (state,) = afm.states()
    assert (state.hand_seq, state.hand_t_ns, state.command_seq) == (41, sampled_ns, 0)


def test_there_is_one_state_a_command_while_they_come(afm: Instrument) -> None:
    follow(afm)
    afm.pass_ms(100.0, every_ms=1.0)
    assert len(afm.states()) == 100


def test_without_commands_there_is_a_state_a_millisecond(afm: Instrument) -> None:
    afm.pass_ms(100.0)
    assert len(afm.states()) == pytest.approx(100, abs=1)


def test_an_armed_tip_stays_withdrawn_until_a_fresh_command_of_an_armed_hand_comes(afm: Instrument) -> None:
    waits = "armed: the tip stays withdrawn until a fresh command of an armed hand comes"
    assert afm.control("arm", place="hand") == waits
    for armed in (False, None):
        for _ in range(400):
            afm.bench.clock.advance_ns(1_000_000)
            afm.command(armed=armed)
        assert {(state.mode, state.armed, state.placed) for state in afm.states()} == {("retracted", True, False)}
    # a command that is armed and late is none either
    afm.command(hand_ms=60.0)
    assert afm.states()[-1].mode == "retracted"
    assert afm.control("arm", place="hand") == waits
    afm.command()
    assert afm.states()[-1].mode == "follow"
    assert afm.control("arm", place="hand") == "armed already"


@pytest.mark.parametrize("armed", [False, None])
def test_a_tip_withdraws_from_a_hand_that_is_armed_no_more_as_from_one_that_is_lost(
    afm: Instrument, armed: bool | None
) -> None:
    follow(afm)
    modes = []
    for _ in range(300):
        afm.bench.clock.advance_ns(1_000_000)
        # the newest command is answered all the same, whatever it asks for
        afm.command(20e-9, armed=armed, hand_seq=9)
        (state,) = afm.states()
        assert state.hand_seq == 9
        modes.append(state.mode)
    assert (modes.index("hold"), modes.index("retracting")) == (50, 250)
    for _ in range(300):
        afm.bench.clock.advance_ns(1_000_000)
        afm.command()
    assert {state.mode for state in afm.states()} == {"retracting", "retracted"}


def test_a_tip_reports_once_after_each_arming_that_it_is_placed(afm: Instrument) -> None:
    afm.command()
    afm.control("arm", place="hand")
    (begun,) = [event for event in afm.bench.take("session/event") if event.kind == "mode"]
    # 98 nm are left after the first step, at 2 um/s
    assert begun.data["placing_s"] == pytest.approx(0.049, rel=0.05, abs=0.0)
    assert begun.text.endswith("nm to 0 nm at 2000 nm/s, for 0.05 s")
    afm.pass_ms(80.0, every_ms=1.0)
    states = afm.states()
    placed = [event for event in afm.bench.take("session/event") if event.data.get("placed")]
    assert [event.text for event in placed] == ["the tip is placed: its base is at 0 nm"]
    first = next(state for state in states if state.placed)
    assert [state.placed for state in states] == [state.t_ns >= first.t_ns for state in states]
    assert first.base_position_m[2] == 0.0
    assert afm.control("arm", place="hand") == "armed already"
    afm.command()
    assert [event.data["placed"] for event in afm.bench.take("session/event") if event.data.get("placed")] == [True]


def test_an_arm_while_the_tip_is_held_says_so_and_one_with_which_it_retracts_is_refused(afm: Instrument) -> None:
    follow(afm)
    afm.pass_ms(100.0)
    assert afm.states()[-1].mode == "hold"
    told = "armed already, but in mode hold: command_deadline; without fresh commands the tip retracts"
    assert afm.control("arm", place="hand") == told
    afm.command()
    assert afm.control("arm", place="hand") == "armed already"
    # the step of the arm itself is the first that sees the silence
    afm.bench.clock.advance_ns(300_000_000)
    with pytest.raises(RefusedError, match=r"^not armed: the AFM is in mode retracting: hold_expired$"):
        afm.control("arm", place="hand")
    assert afm.states()[-1].mode == "retracting"


def test_the_end_of_a_session_withdraws_the_tip_and_is_no_emergency_stop(afm: Instrument) -> None:
    follow(afm)
    assert afm.control("stop") == "the tip retracts and stays until armed"
    # whatever is commanded meanwhile
    afm.pass_ms(200.0, every_ms=1.0)
    states = afm.states()
    assert list(dict.fromkeys(state.mode for state in states)) == ["retracting", "retracted"]
    assert states[-1].base_position_m[2] == pytest.approx(100e-9, rel=1e-9, abs=0.0)
    reasons = [event.data["reason"] for event in afm.bench.take("session/event") if event.kind == "mode"]
    assert reasons[-1] == "retract_requested"
    afm.control("arm", place="hand")
    afm.pass_ms(10.0, every_ms=1.0)
    assert afm.states()[-1].mode == "follow"


def test_estop_is_latched_until_armed_and_a_withdrawal_releases_none(afm: Instrument) -> None:
    follow(afm)
    afm.control("estop")
    assert afm.node.is_latched
    assert afm.control("stop") == "the tip is in emergency stop already"
    afm.pass_ms(200.0, every_ms=1.0)
    assert {state.mode for state in afm.states()} == {"estop"}
    afm.control("arm", place="hand")
    afm.command()
    assert afm.states()[-1].mode == "follow"


def test_silence_holds_then_retracts_and_stays(afm: Instrument) -> None:
    follow(afm)
    start_ns = afm.bench.clock.monotonic_ns()
    afm.pass_ms(600.0)
    modes: dict[str, float] = {}
    for state in afm.states():
        age_ms = (state.t_ns - afm.bench.clock.epoch_offset_ns - start_ns) * 1e-6
        modes.setdefault(state.mode, age_ms)
        last = state
    assert list(modes) == ["follow", "hold", "retracting", "retracted"]
    # one period of grain on the deadlines of 50 and 250 ms
    assert 50.0 < modes["hold"] <= 52.0
    assert 250.0 < modes["retracting"] <= 252.0
    assert last.base_position_m[2] == pytest.approx(100e-9, rel=1e-9, abs=0.0)
    afm.pass_ms(50.0, every_ms=1.0)
    assert {state.mode for state in afm.states()} == {"retracted"}
    events = [event.data["mode"] for event in afm.bench.take("session/event") if event.kind == "mode"]
    assert events == ["follow", "follow", "hold", "retracting", "retracted"]


def test_a_burst_of_commands_cannot_outrun_the_speed_limit(afm: Instrument) -> None:
    follow(afm)
    before = -afm.node._memory.guard.base_m
    for _ in range(100):
        afm.command(x_s_m=-90e-9)
    moved = abs(-afm.node._memory.guard.base_m - before)
    # no time has passed, so next to nothing may have moved
    assert moved < 1e-12


def test_the_end_retracts(afm: Instrument) -> None:
    follow(afm)
    afm.node.make_safe()
    with pytest.raises(RuntimeError, match="not open"):
        afm.driver.exchange(0.0)


def test_the_clock_question_is_answered(afm: Instrument) -> None:
    question = afm.bench.received("clock/ping", "delay_node@slave")
    afm.node.on_message(question)
    (pong,) = afm.bench.take("clock/pong")
    assert pong.ping_t_ns == question.message.t_ns
    assert pong.received_ns == question.received_ns


def test_unknown_commands_are_refused(afm: Instrument) -> None:
    with pytest.raises(RefusedError, match="does not know start"):
        afm.control("start")


def base_m(afm: Instrument) -> float:
    return float(-afm.states()[-1].base_position_m[2])


# a stamp from the future is as far off as an old one
@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize(
    ("waited_ms", "mode"), [(49.0, "follow"), (51.0, "hold"), (249.0, "hold"), (251.0, "retracting")]
)
def test_a_command_is_as_old_as_its_stamp_however_late_it_is_taken(
    afm: Instrument, waited_ms: float, mode: str, sign: float
) -> None:
    follow(afm)
    afm.waited(sign * waited_ms, x_s_m=5e-9)
    assert afm.states()[-1].mode == mode
    assert afm.node.stale == (mode != "follow")


@pytest.mark.parametrize("link_ms", [0.0, 150.0])
@pytest.mark.parametrize(("hand_ms", "mode"), [(49.0, "follow"), (51.0, "hold"), (251.0, "retracting")])
def test_a_new_command_is_as_old_as_the_sample_behind_it(
    afm: Instrument, hand_ms: float, mode: str, link_ms: float
) -> None:
    """A controller or a link that was held up stamps anew what descends from an old sample."""
    follow(afm)
    afm.node.on_message(afm.bench.link_delay("forward", round(link_ms * 1e6)))
    afm.command(hand_ms=hand_ms + link_ms)
    assert afm.states()[-1].mode == mode


@pytest.mark.parametrize(
    ("stalled_ms", "modes"), [(200, ["hold", "follow"]), (1000, ["retracting"] * 2), (3000, ["retracting"] * 2)]
)
def test_an_instrument_that_stalled_holds_or_retracts_before_anything_else(
    afm: Instrument, stalled_ms: int, modes: list[str]
) -> None:
    """Commands went on coming, the newest of them a moment ago: they wait until the guard has judged the silence."""
    follow(afm)
    afm.bench.take("session/event")
    afm.bench.advance_ms(stalled_ms)
    afm.command(x_s_m=10e-9)
    states = afm.states()
    assert [state.mode for state in states] == modes
    # the way back from the sample is the only one that is gone
    assert max(-state.base_position_m[2] for state in states) < 1e-15
    events = afm.bench.take("session/event")
    (said,) = (event for event in events if event.kind == "fault")
    assert said.level == "warning"
    assert said.text == f"this process stalled for {stalled_ms} ms: messages that waited for it are late"
    assert said.data == {"stalled_s": pytest.approx(stalled_ms * 1e-3, rel=1e-6, abs=0.0)}
    # and what that did to the tip
    assert next(event.data["mode"] for event in events if event.kind == "mode") == modes[0]


def test_the_tip_does_not_jump_when_the_instrument_goes_on(afm: Instrument) -> None:
    follow(afm)
    afm.bench.advance_ms(200.0)
    for _ in range(20):
        afm.command(x_s_m=5e-9)
        afm.bench.advance_ms(1.0)
    moved = base_m(afm)
    assert 0.1e-9 < moved < 0.5e-9
    for _ in range(100):
        afm.command(x_s_m=5e-9)
        afm.bench.advance_ms(1.0)
    assert base_m(afm) == 5e-9


def test_an_instrument_that_is_late_by_less_goes_on(afm: Instrument) -> None:
    follow(afm)
    afm.bench.take("session/event")
    afm.bench.advance_ms(49.0)
    afm.command()
    assert afm.states()[-1].mode == "follow"
    assert afm.bench.take("session/event") == []


def test_a_played_hand_behind_live_commands_is_followed(afm: Instrument) -> None:
    """Its stamps are those of the recording: the commands are live, and theirs count."""
    follow(afm)
    afm.command(hand_ms=1e9)
    assert afm.states()[-1].mode == "follow"
    afm.pass_ms(60.0)
    assert afm.states()[-1].mode == "hold"


@pytest.mark.parametrize("allow", [False, True])
def test_played_commands_count_from_their_reception_where_they_are_allowed(bench_of: Any, allow: bool) -> None:
    bench = bench_of("afm_node@slave")
    config = AfmConfig(allow_replay=allow)
    node = AfmNode(bench.context, config, simulated_afm(config.to_params()))
    fields = {"mode": "position", "base_position_m": (0.0, 0.0, 0.0), "hand_seq": 7, "hand_t_ns": 3, "t_ns": 5}
    fields["hand_armed"] = True
    command = bench.received("afm/command", "controller@slave", **fields)
    node.on_message(command)
    arm = {"id": "a", "command": "arm", "target": "afm_node", "parameters": {"place": "hand"}}
    control = bench.make("session/control", "console@master", **arm)
    assert "armed" in node.on_control(control)
    if not allow:
        assert bench.take("afm/state")[-1].mode == "retracted"
        return
    bench.advance_ms(49.0)
    node.on_deadline(bench.clock.monotonic_ns())
    assert bench.take("afm/state")[-1].mode == "follow"
    bench.advance_ms(2.0)
    node.on_deadline(bench.clock.monotonic_ns())
    assert bench.take("afm/state")[-1].mode == "hold"


def test_a_hand_that_moves_the_tip_across_has_the_stage_and_leaves_the_tip_where_it_is(afm: Instrument) -> None:
    follow(afm)
    node, bench = afm.node, afm.bench

    def across(place: tuple[float, float] | None, count: int) -> Any:
        for _ in range(count):
            bench.clock.advance_ns(1_000_000)
            fields = {"mode": "position", "base_position_m": (0.0, 0.0, 0.0), "hand_seq": 7, "hand_armed": True}
            fields |= {"hand_t_ns": bench.clock.now_ns()} | ({} if place is None else {"lateral_m": place})
            node.on_message(bench.received("afm/command", "controller@slave", **fields))
        return afm.states()[-1].base_position_m[:2]

    # 20 um/s are 20 nm a step
    assert across((5e-8, -2e-8), 1) == pytest.approx((1.857e-8, -7.43e-9), rel=1e-3)
    assert across((5e-8, -2e-8), 5) == (5e-8, -2e-8)
    assert across(None, 5) == (5e-8, -2e-8)
    # beyond its range it stops there
    assert across((9e-4, 0.0), 4000)[0] == 5e-5
    stood = across((0.0, 0.0), 100)
    # no command: the guard holds, and the stage stands
    afm.pass_ms(100.0)
    held = afm.states()[-1]
    assert held.mode == "hold"
    # the command was in force for the 50 ms of its deadline
    assert abs(held.base_position_m[0] - stood[0]) <= 52 * 20e-9
    afm.pass_ms(50.0)
    assert afm.states()[-1].base_position_m[:2] == held.base_position_m[:2]
