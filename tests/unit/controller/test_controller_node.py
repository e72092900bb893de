"""Both halves of a law as nodes: what they publish, when, and what they refuse."""

import pickle
from typing import Any

import pytest
from msgspec import structs

from services.controller.__main__ import half_of_site
from services.controller.master_half import MasterController
from services.controller.slave_half import SlaveController
from telenano.sections.controller_section import OWN_LAWS as LAWS
from telenano.sections.controller_section import ControllerConfig
from telenano.wire.errors import RefusedError
from telenano.wire.messages import SessionControl

PERIOD_NS = 1_000_000
ZERO = (0.0, 0.0, 0.0)


def hand_fields(force_n: float = 0.0, mode: str = "position", position_m: float = 0.0) -> dict[str, Any]:
    return {
        "position_m": (0.0, 0.0, -position_m),
        "velocity_m_per_s": ZERO,
        "operator_force_n": (0.0, 0.0, -force_n),
        "motor_force_n": ZERO,
        "reference_m": ZERO,
        "mode": mode,
        "estop": False,
        "limited": False,
        "session_s": -1.0,
        "answered_seq": 0,
        "answered_t_ns": 0,
        "answered_at_ns": 0,
        "step_s": 1e-3,
        "armed": True,
    }


def answer_fields(force_n: float, seq: int, t_ns: int, **changes: Any) -> dict[str, Any]:
    fields = {
        "law": "virtual_impedance",
        "active": True,
        "position_m": ZERO,
        "velocity_m_per_s": ZERO,
        "force_n": (0.0, 0.0, force_n),
        "wave_sqrt_w": None,
        "energy_j": None,
        "separation_m": 1e-9,
        "separation_valid": True,
        "in_contact": False,
        "hand_seq": seq,
        "hand_t_ns": t_ns,
    }
    return {**fields, **changes}


def tip_fields(force_n: float, command_seq: int, mode: str = "follow", hand_t_ns: int = 1) -> dict[str, Any]:
    return {
        "command_seq": command_seq,
        "base_position_m": (0.0, 0.0, -9e-9),
        "deflection_m": 1e-10,
        "tip_force_n": (0.0, 0.0, force_n),
        "separation_m": 2e-10,
        "separation_valid": True,
        "in_contact": True,
        "meniscus": False,
        "mode": mode,
        "limited": False,
        "hand_seq": 0,
        "hand_t_ns": hand_t_ns,
        "step_s": 1e-3,
    }


@pytest.fixture
def master(bench_of: Any) -> tuple[Any, MasterController]:
    bench = bench_of("controller@master")
    return bench, MasterController(bench.context, ControllerConfig())


def follows_already(bench: Any, node: SlaveController) -> None:
    """Report an instrument that follows: one that begins to is let in slowly (`telenano.laws.entering`)."""
    node.on_message(bench.received("afm/state", "afm_node@slave", **tip_fields(-1e-9, 0, hand_t_ns=0)))


@pytest.fixture
def slave(bench_of: Any) -> tuple[Any, SlaveController]:
    bench = bench_of("controller@slave")
    return bench, SlaveController(bench.context, ControllerConfig())


def tick(bench: Any, node: MasterController, force_n: float = 0.0, wait_ns: int = PERIOD_NS, **changes: Any) -> Any:
    bench.clock.advance_ns(wait_ns)
    hand = bench.received("haptic/state", "haptic_node@master", **{**hand_fields(force_n), **changes})
    node.on_message(hand)
    return hand.message


def test_hand_sample_is_forwarded_at_once_and_commanded_when_answered(master: Any) -> None:
    bench, node = master
    hand = tick(bench, node, 1.0)
    (forward,) = bench.take("teleop/forward")
    assert (forward.hand_seq, forward.hand_t_ns) == (hand.seq, hand.t_ns)
    assert bench.take("haptic/command") == []
    node.on_message(bench.received("teleop/backward", "controller@slave", **answer_fields(2e-9, hand.seq, hand.t_ns)))
    (command,) = bench.take("haptic/command")
    assert (command.hand_seq, command.hand_t_ns) == (hand.seq, hand.t_ns)
    assert command.force_n == (0.0, 0.0, 1e8 * 2e-9)
    assert command.position_m[2] < 0.0  # it moves towards the sample
    assert command.mode == "position"


def test_one_command_a_tick_whatever_the_answers(master: Any) -> None:
    bench, node = master
    hand = tick(bench, node)
    tick(bench, node)  # no answer came: the command of the first tick goes out now
    assert len(bench.take("haptic/command")) == 1
    for _ in range(3):  # a burst of answers belongs to one tick
        answer = answer_fields(0.0, hand.seq, hand.t_ns)
        node.on_message(bench.received("teleop/backward", "controller@slave", **answer))
    assert len(bench.take("haptic/command")) == 1
    tick(bench, node)
    assert bench.take("haptic/command") == []


def test_silence_past_the_limit_lets_the_hand_go(master: Any) -> None:
    bench, node = master
    hand = tick(bench, node)
    node.on_message(bench.received("teleop/backward", "controller@slave", **answer_fields(0.0, hand.seq, hand.t_ns)))
    modes = []
    for _ in range(55):
        tick(bench, node)
        modes += [command.mode for command in bench.take("haptic/command")]
    assert modes[:50] == ["position"] * 50
    assert modes[-1] == "off"
    assert node.state == "safe"


def test_first_signal_of_a_half_that_has_begun_anew_interrupts_the_law(master: Any) -> None:
    bench, node = master
    modes = []
    # A message that was overtaken has a lower number as well, and is about an older sample.
    for number, is_old in ((40, False), (41, False), (39, True), (0, False), (1, False)):
        hand = tick(bench, node)
        bench.take("haptic/command")
        fields = answer_fields(0.0, hand.seq, hand.t_ns - 5 * PERIOD_NS * is_old)
        answer = bench.received("teleop/backward", "controller@slave", **fields)
        node.on_message(answer._replace(message=structs.replace(answer.message, seq=number)))
        modes += [command.mode for command in bench.take("haptic/command")]
    assert modes == ["position", "position", "position", "off", "position"]


def test_signal_of_another_law_counts_as_silence_and_answers_nothing(master: Any) -> None:
    bench, node = master
    first = tick(bench, node)
    node.on_message(bench.received("teleop/backward", "controller@slave", **answer_fields(0.0, first.seq, first.t_ns)))
    for _ in range(55):
        hand = tick(bench, node)
        other = answer_fields(1e-9, hand.seq, hand.t_ns, law="wave")
        node.on_message(bench.received("teleop/backward", "controller@slave", **other))
    command = bench.take("haptic/command")[-1]
    assert (command.mode, command.hand_seq, command.hand_t_ns) == ("off", first.seq, first.t_ns)
    assert node.law.name == "virtual_impedance"


@pytest.mark.parametrize(("law", "in_force"), [("wave", "wave"), ("unknown", "virtual_impedance")])
def test_half_that_has_just_started_takes_over_a_known_law(master: Any, law: str, in_force: str) -> None:
    bench, node = master
    hand = tick(bench, node)
    other = answer_fields(0.0, hand.seq, hand.t_ns, law=law)
    node.on_message(bench.received("teleop/backward", "controller@slave", **other))
    tick(bench, node)
    assert (node.law.name, bench.take("teleop/forward")[-1].law) == (in_force, in_force)


def test_half_that_a_command_told_its_law_takes_over_no_other(master: Any) -> None:
    bench, node = master
    command = {"id": "a", "command": "set", "target": "controller", "parameters": {"law": "wave"}}
    node.on_control(bench.make("session/control", "console@master", **command))
    # longer than a command is valid, so that none for the other half is on its way
    for _ in range(1200):
        hand = tick(bench, node)
        other = answer_fields(0.0, hand.seq, hand.t_ns, law="virtual_impedance")
        node.on_message(bench.received("teleop/backward", "controller@slave", **other))
    assert node.law.name == "wave"


def test_missed_ticks_are_bridged_by_their_number(master: Any, bench_of: Any) -> None:
    moved = []
    for gap in (1, 3):
        bench = bench_of("controller@master")
        node = MasterController(bench.context, ControllerConfig())
        for wait in (1, gap):
            bench.clock.advance_ns((wait - 1) * PERIOD_NS)
            hand = tick(bench, node, 1.0)
            fields = answer_fields(0.0, hand.seq, hand.t_ns)
            node.on_message(bench.received("teleop/backward", "controller@slave", **fields))
        moved.append(node.law_state.position_m)
    assert moved[1] > 3.0 * moved[0]


def test_lateness_of_the_hand_does_not_enter_the_law(master: Any, bench_of: Any) -> None:
    positions = []
    for lateness in ((0, 0, 0), (40_000, 7_000, 90_000)):
        bench = bench_of("controller@master")
        node = MasterController(bench.context, ControllerConfig())
        for late in lateness:
            bench.clock.advance_ns(late)
            hand = tick(bench, node, 1.0)
            fields = answer_fields(0.0, hand.seq, hand.t_ns)
            node.on_message(bench.received("teleop/backward", "controller@slave", **fields))
        positions.append(node.law_state.position_m)
    assert positions[0] == positions[1]


def pushed(bench: Any, node: MasterController) -> Any:
    """Push for a while in free space, and give the last reference of the tip."""
    for _ in range(200):
        hand = tick(bench, node, 1.0)
        place_m = (0.0, 0.0, 0.0 - node.memory.tip_reference_m)
        fields = answer_fields(0.0, hand.seq, hand.t_ns, position_m=place_m)
        node.on_message(bench.received("teleop/backward", "controller@slave", **fields))
    last = bench.take("teleop/forward")[-1].position_m[2]
    assert last < -2e-9
    return last


def test_hand_that_stalled_finds_its_reference_where_it_was(master: Any) -> None:
    bench, node = master
    before = pushed(bench, node)
    bench.clock.advance_ns(10**9)
    tick(bench, node, 1.0, position_m=(0.0, 0.0, -node.law_state.position_m))
    after = bench.take("teleop/forward")[-1].position_m[2]
    # a tick of free motion at most
    assert 0.0 < before - after < 16e-12


def test_hand_that_was_restarted_is_joined_where_it_is_and_the_tip_stays(master: Any) -> None:
    bench, node = master
    before = pushed(bench, node)
    bench.clock.advance_ns(10**9)
    for _ in range(3):
        hand = tick(bench, node, 0.0, mode="off", position_m=(0.0, 0.0, -4e-3))
        fields = answer_fields(0.0, hand.seq, hand.t_ns)
        node.on_message(bench.received("teleop/backward", "controller@slave", **fields))
    assert node.law_state.position_m == 4e-3
    after = bench.take("teleop/forward")[-1].position_m[2]
    assert abs(before - after) < 32e-12


@pytest.mark.parametrize("law", sorted(LAWS))
def test_sample_that_is_repeated_is_none(bench_of: Any, law: str) -> None:
    states = []
    for repeated in (True, False):
        bench = bench_of("controller@master")
        node = MasterController(bench.context, ControllerConfig(law=law))
        for number in range(240):
            stale = 200 <= number < 214 or 220 <= number < 226
            where_m = (0.0, 0.0, -node.memory.reference.position_m)
            if stale and not repeated:
                bench.clock.advance_ns(PERIOD_NS)
            elif stale:
                # the device says again where it was 6 ms ago
                tick(bench, node, 1.0, position_m=ZERO, device="stale", sample_age_s=6e-3)
                assert bench.take("teleop/forward") == []
                # or the guard would take the silence for a controller that has ended
                (command,) = bench.take("haptic/command")
                assert (command.mode, command.position_m) == ("position", where_m)
            else:
                hand = tick(bench, node, 1.0, position_m=where_m, device="ok", sample_age_s=1e-3)
                (forward,) = bench.take("teleop/forward")
                waves = {key: getattr(forward, key) for key in ("position_m", "energy_j", "wave_sqrt_w")}
                fields = answer_fields(0.0, hand.seq, hand.t_ns, law=law, **waves)
                node.on_message(bench.received("teleop/backward", "controller@slave", **fields))
                bench.take("haptic/command")
        assert node.memory.reference.active
        assert node.memory.reference.position_m > 1e-4
        states.append(pickle.dumps(node.law_state))
    assert states[0] == states[1]


@pytest.mark.parametrize("law", [law for law in sorted(LAWS) if law != "tactile"])
def test_hand_is_where_it_would_be_if_no_sample_had_been_late(bench_of: Any, law: str) -> None:
    places = []
    for late_ns in (0, 400_000, 800_000):
        bench = bench_of("controller@master")
        node = MasterController(bench.context, ControllerConfig(law=law))
        for number in range(200):
            # late, and less late, and then in time again
            waits_ns = {1: PERIOD_NS + late_ns, 2: PERIOD_NS - late_ns // 2, 3: PERIOD_NS - late_ns + late_ns // 2}
            where_m = (0.0, 0.0, -node.memory.reference.position_m)
            hand = tick(bench, node, 1.0, waits_ns.get(number % 5, PERIOD_NS), position_m=where_m)
            place_m = (0.0, 0.0, 0.0 - node.memory.tip_reference_m)
            fields = answer_fields(0.0, hand.seq, hand.t_ns, law=law, position_m=place_m)
            node.on_message(bench.received("teleop/backward", "controller@slave", **fields))
            # and one command a tick, whether it is answered or none later
            (command,) = bench.take("haptic/command")
            assert command.position_m == (0.0, 0.0, -node.memory.reference.position_m)
        places.append(node.memory.reference.position_m)
    assert places[0] > 5e-4
    assert places[1:] == pytest.approx([places[0]] * 2, rel=1e-9, abs=0.0)


def test_parameters_change_at_run_time(master: Any) -> None:
    bench, node = master
    tick(bench, node)
    control = bench.make(
        "session/control",
        "console@master",
        id="a",
        command="set",
        target="controller",
        parameters={"virtual_impedance.force_gain": 10.0},
    )
    assert "force_gain = 10.0" in node.on_control(control)
    assert node.params.force_gain == 10.0


def test_a_law_that_the_instrument_is_too_slow_for_is_refused_live_in_the_words_of_the_plan(bench_of: Any) -> None:
    refused = {"wave": "controller.law: wave closes a loop through the instrument"}
    config = ControllerConfig.model_validate({"law": "model_mediated", "refused_laws": refused})
    for site, half in (("master", MasterController), ("slave", SlaveController)):
        bench = bench_of(f"controller@{site}")
        node = half(bench.context, config)
        for parameters, text in (
            ({"law": "wave"}, "wave closes a loop through the instrument"),
            ({"refused_laws.wave": ""}, "follows from the instrument, which stays the same"),
        ):
            fields = {"id": "a", "command": "set", "target": "controller", "parameters": parameters}
            with pytest.raises(RefusedError, match=text):
                node.on_control(bench.make("session/control", "console@master", **fields))
            assert (node.config.law, node.half.switching) == ("model_mediated", False)


@pytest.mark.parametrize(
    ("parameters", "text"),
    [
        ({}, "needs parameters"),
        ({"virtual_impedance.force_gain": -1.0}, "controller.virtual_impedance.force_gain"),
        (
            {"virtual_impedance.fource_gain": 1.0},
            "fource_gain: unknown key, did you mean force_gain. Known are position_scale",
        ),
        ({"virtual_impedance.mass_kg": "heavy"}, "controller.virtual_impedance.mass_kg"),
        ({"period_s": 0.01}, "period_s cannot be changed"),
    ],
)
def test_bad_parameters_are_refused_and_change_nothing(master: Any, parameters: Any, text: str) -> None:
    bench, node = master
    before = node.params
    fields = {"id": "a", "command": "set", "target": "controller", "parameters": parameters}
    control: SessionControl = bench.make("session/control", "console@master", **fields)
    with pytest.raises(RefusedError, match=text):
        node.on_control(control)
    assert node.params == before


def forward_fields(position_m: float, seq: int, t_ns: int) -> dict[str, Any]:
    fields = answer_fields(0.0, seq, t_ns, position_m=(0.0, 0.0, -position_m))
    kept = {k: v for k, v in fields.items() if k not in ("separation_m", "separation_valid", "in_contact")}
    return {**kept, "hand_armed": True}


def test_slave_commands_at_once_and_answers_when_the_instrument_has(slave: Any) -> None:
    bench, node = slave
    follows_already(bench, node)
    node.on_message(bench.received("teleop/forward", "controller@master", **forward_fields(8e-9, 5, 50)))
    (command,) = bench.take("afm/command")
    assert command.base_position_m == (0.0, 0.0, -8e-9)
    assert (command.hand_seq, command.hand_t_ns, command.mode) == (5, 50, "position")
    assert bench.take("teleop/backward") == []
    node.on_message(bench.received("afm/state", "afm_node@slave", **tip_fields(-3e-9, command.seq)))
    (backward,) = bench.take("teleop/backward")
    assert backward.force_n == (0.0, 0.0, -3e-9)
    assert (backward.hand_seq, backward.hand_t_ns, backward.active) == (5, 50, True)


def test_state_that_answers_no_command_is_kept_for_the_next_answer(slave: Any) -> None:
    bench, node = slave
    node.on_message(bench.received("afm/state", "afm_node@slave", **tip_fields(-1e-9, 0, hand_t_ns=0)))
    assert bench.take("teleop/backward") == []
    node.on_message(bench.received("teleop/forward", "controller@master", **forward_fields(8e-9, 5, 50)))
    node.on_message(bench.received("afm/state", "afm_node@slave", **tip_fields(-2e-9, 99)))
    assert bench.take("teleop/backward") == []
    node.on_message(bench.received("teleop/forward", "controller@master", **forward_fields(8e-9, 6, 1_000_050)))
    (backward,) = bench.take("teleop/backward")
    assert backward.force_n == (0.0, 0.0, -2e-9)
    assert backward.hand_seq == 5


def test_dead_instrument_lets_the_hand_go(slave: Any) -> None:
    bench, node = slave
    follows_already(bench, node)
    node.on_message(bench.received("teleop/forward", "controller@master", **forward_fields(8e-9, 0, 50)))
    (command,) = bench.take("afm/command")
    node.on_message(bench.received("afm/state", "afm_node@slave", **tip_fields(-1e-9, command.seq)))
    active = []
    for n in range(1, 60):
        bench.advance_ms(1.0)
        fields = forward_fields(8e-9, n, 50 + n * PERIOD_NS)
        node.on_message(bench.received("teleop/forward", "controller@master", **fields))
        active += [message.active for message in bench.take("teleop/backward")]
    # the first answer came from the instrument; those after it are made with its last sample, for 50 ms
    assert active[:50] == [True] * 50
    assert not any(active[51:])
    assert len(bench.take("session/event")) == 1


def test_retracted_tip_is_not_active(slave: Any) -> None:
    bench, node = slave
    node.on_message(bench.received("teleop/forward", "controller@master", **forward_fields(8e-9, 5, 50)))
    (command,) = bench.take("afm/command")
    node.on_message(bench.received("afm/state", "afm_node@slave", **tip_fields(0.0, command.seq, mode="retracted")))
    (backward,) = bench.take("teleop/backward")
    assert not backward.active
    assert node.state == "safe"


def test_a_tip_that_images_by_itself_moves_no_hand_until_it_is_done_or_falls_silent(slave: Any) -> None:
    bench, node = slave

    def is_active(state: str, wait_ms: float = 0.0) -> bool:
        fields = {"program": "scan", "state": state, "text": "", "done_percent": 0.0, "line": 0, "lines": 4}
        node.on_message(bench.received("afm/program", "afm_node@slave", **fields))
        bench.advance_ms(wait_ms)
        hand_ms = bench.clock.now_ns() // 10**6
        fields = {**forward_fields(8e-9, hand_ms, 50), "hand_t_ns": bench.clock.now_ns()}
        node.on_message(bench.received("teleop/forward", "controller@master", **fields))
        command = bench.take("afm/command")[-1]
        tip = {**tip_fields(0.0, command.seq, mode="follow"), "hand_t_ns": bench.clock.now_ns()}
        node.on_message(bench.received("afm/state", "afm_node@slave", **tip))
        return bench.take("teleop/backward")[-1].active

    assert [is_active(state) for state in ("running", "paused", "finished")] == [False, False, True]
    assert is_active("running", wait_ms=499.0) is False
    assert is_active("running", wait_ms=501.0) is True


def test_x_and_y_of_a_hand_reach_the_tip_and_its_lateral_force_comes_back(master: Any, bench_of: Any) -> None:
    bench, node = master
    hand = bench.received("haptic/state", "haptic_node@master", **{**hand_fields(), "position_m": (4e-3, -2e-3, 0.0)})
    node.on_message(hand)
    (forward,) = bench.take("teleop/forward")
    # alpha_p = 1.5e-6
    assert forward.position_m[:2] == pytest.approx((6e-9, -3e-9), rel=1e-12, abs=0.0)
    far = bench_of("controller@slave")
    slave = SlaveController(far.context, ControllerConfig())
    fields = {**forward_fields(0.0, 5, 50), "position_m": forward.position_m, "hand_t_ns": far.clock.now_ns()}
    slave.on_message(far.received("teleop/forward", "controller@master", **fields))
    (command,) = far.take("afm/command")
    assert command.base_position_m[:2] == forward.position_m[:2]
    tip = {**tip_fields(2e-9, command.seq), "base_position_m": (6e-9, -3e-9, 0.0), "tip_force_n": (-1e-9, 5e-10, 2e-9)}
    slave.on_message(far.received("afm/state", "afm_node@slave", **tip))
    (backward,) = far.take("teleop/backward")
    assert (backward.position_m[:2], backward.force_n[:2]) == ((6e-9, -3e-9), (-1e-9, 5e-10))
    answer = {**answer_fields(2e-9, hand.message.seq, hand.message.t_ns), "force_n": backward.force_n}
    node.on_message(bench.received("teleop/backward", "controller@slave", **answer))
    # alpha_f = 1e8
    assert bench.take("haptic/command")[-1].force_n[:2] == pytest.approx((-0.1, 0.05), rel=1e-12, abs=0.0)


def test_each_site_gets_its_half(bench_of: Any) -> None:
    config = ControllerConfig()
    assert isinstance(half_of_site(bench_of("controller@master").context, config), MasterController)
    assert isinstance(half_of_site(bench_of("controller@slave").context, config), SlaveController)


def heard_forward(bench: Any, node: SlaveController, law: str, seq: int, position_m: float) -> None:
    fields = forward_fields(position_m, seq, 50 + seq * PERIOD_NS) | {"law": law, "force_n": (0.0, 0.0, -1e-8)}
    fields |= {"wave_sqrt_w": ZERO if law == "wave" else None, "energy_j": 0.0 if law != "model_mediated" else None}
    node.on_message(bench.received("teleop/forward", "controller@master", **fields))


@pytest.mark.parametrize("law", ["passivity", "model_mediated", "wave"])
def test_local_loop_goes_on_with_the_instruments_own_steps(bench_of: Any, law: str) -> None:
    bench = bench_of("controller@slave")
    node = SlaveController(bench.context, ControllerConfig(law=law))
    for seq in range(3):
        heard_forward(bench, node, law, seq, 1e-8)
        (command,) = bench.take("afm/command")
        node.on_message(bench.received("afm/state", "afm_node@slave", **tip_fields(2e-8, command.seq)))
        bench.advance_ms(1.0)
    bench.take("teleop/backward")
    # nothing comes any more, but the instrument steps by itself and says what it measures
    commands = 0
    for _ in range(2000):
        bench.advance_ms(1.5)
        node.on_message(bench.received("afm/state", "afm_node@slave", **tip_fields(2e-8, command.seq)))
        news = bench.take("afm/command")
        if not news:
            break
        (command,) = news
        commands += 1
        assert command.hand_seq == 2
        # what a command of its own did is accounted for, and not sent
        node.on_message(bench.received("afm/state", "afm_node@slave", **tip_fields(2e-8, command.seq)))
    # for as long as the last signal counts, then it stands, so that the guard of the instrument judges the silence
    assert commands == int((node.config.law_config().silence_limit_s - 1e-3) / 1.5e-3)
    assert bench.take("teleop/backward") == []


def wave_sent_back(bench_of: Any, answered_by: tuple[tuple[int, ...], ...]) -> tuple[list[Any], float]:
    """Give the slave six signals of a free tip; answered_by: of which commands the instrument tells after each.

    Returns the answers, and where the instrument told last that its base is [m].
    """
    bench = bench_of("controller@slave")
    node = SlaveController(bench.context, ControllerConfig(law="wave"))
    commands: list[Any] = []

    def tells(command: Any) -> None:
        state = tip_fields(0.0, command.seq) | {"base_position_m": command.base_position_m}
        node.on_message(bench.received("afm/state", "afm_node@slave", **state))

    # first it stands until both halves follow, then the hand jumps and its waves arrive
    for seq, told in enumerate(((0,), (1,), *(tuple(n + 2 for n in some) for some in answered_by))):
        bench.advance_ms(1.0)
        fields = forward_fields(1e-8 * (seq > 1), seq, 50 + seq * PERIOD_NS)
        fields |= {"law": "wave", "wave_sqrt_w": ZERO, "energy_j": 1.0 * (seq > 1)}
        node.on_message(bench.received("teleop/forward", "controller@master", **fields))
        commands += bench.take("afm/command")
        for n in told:
            tells(commands[n])
    assert commands[-1].base_position_m[2] < -4e-10
    return bench.take("teleop/backward"), commands[2 + answered_by[-1][-1]].base_position_m[2]


@pytest.mark.parametrize(
    "answered_by",
    [
        # two signals come before the instrument has answered the first; three do; it tells of the last one alone
        ((0,), (1,), (), (2, 3), (4,), (5,)),
        ((0,), (1,), (), (), (2, 3, 4), (5,)),
        ((0,), (), (), (), (), (5,)),
        # an instrument that is always late by one
        ((0,), (), (1,), (2,), (3,), (4, 5)),
    ],
)
def test_signals_that_come_before_the_instrument_has_answered_send_back_the_motion_that_there_was(
    bench_of: Any, answered_by: Any
) -> None:
    on_time, on_time_m = wave_sent_back(bench_of, ((0,), (1,), (2,), (3,), (4,), (5,)))
    late, late_m = wave_sent_back(bench_of, answered_by)
    # every signal has its answer, with the stamp of its own sample
    assert [(message.hand_seq, message.hand_t_ns) for message in late] == [
        (message.hand_seq, message.hand_t_ns) for message in on_time
    ]
    # a late instrument does not slow the base down, because it still carries out what it was asked for
    assert late_m == pytest.approx(on_time_m, rel=1e-9, abs=0.0)
    for answers, base_m in ((on_time, on_time_m), (late, late_m)):
        assert answers[-1].position_m[2] == pytest.approx(base_m, rel=1e-9, abs=0.0)
    assert 0.0 < late[-1].energy_j <= on_time[-1].energy_j * (1.0 + 1e-9)


def test_law_without_a_local_loop_waits_for_signals_and_gets_one_with_the_clamp(bench_of: Any) -> None:
    for enabled in (False, True):
        bench = bench_of("controller@slave")
        config = ControllerConfig.model_validate({"law": "position_force", "clamp": {"enabled": enabled}})
        node = SlaveController(bench.context, config)
        heard_forward(bench, node, "position_force", 0, 5e-8)
        (command,) = bench.take("afm/command")
        # The tip was not following before, so the clamp did not act; the guard of the instrument sets the hand off.
        assert command.base_position_m[2] == -5e-8
        for _ in range(2):
            node.on_message(bench.received("afm/state", "afm_node@slave", **tip_fields(2e-8, command.seq)))
        news = bench.take("afm/command")
        assert len(news) == enabled
        # 2 N at the tip for 1 N of the hand: the base, at 9 nm, gives way
        assert all(message.base_position_m[2] > -9e-9 for message in news)


def test_energy_is_counted_at_the_device_and_a_law_that_makes_some_is_not_passive(bench_of: Any) -> None:
    bench = bench_of("controller@master")
    node = MasterController(bench.context, ControllerConfig(law="position_force"))
    position_m, expected_j = 0.0, 0.0
    for n in range(40):
        # the device is driven back against the hand that presses it
        step_m = 1e-5 if n < 10 else -1e-5
        force_n = 0.5 if n < 10 else 1.0
        if n > 1:
            expected_j += force_n * step_m
        position_m += step_m
        bench.advance_ms(1.0)
        hand = bench.received("haptic/state", "haptic_node@master", **hand_fields(force_n, position_m=position_m))
        node.on_message(hand)
        fields = answer_fields(1.5e-8, hand.message.seq, hand.message.t_ns, law="position_force")
        node.on_message(bench.received("teleop/backward", "controller@slave", **fields))
        far = status_fields(0.0)
        node.on_message(bench.received("law/status", "controller@slave", **far))
        bench.advance_ms(0.2)
        bench.run_deferred()
    last = bench.take("law/status")[-1]
    assert last.port_energy_j == pytest.approx(expected_j, rel=0.4)
    assert last.port_energy_j < -1e-4
    assert last.net_valid
    assert not last.passive


def test_the_status_of_the_law_is_deferred_and_as_it_was_at_its_tick(master: Any) -> None:
    bench, node = master
    for n in range(1, 41):
        bench.advance_ms(0.7)
        hand = bench.received("haptic/state", "haptic_node@master", **hand_fields(0.5, position_m=n * 1e-5))
        node.on_message(hand)
        entered_j = node.half.port.energy_j
        assert bench.take("law/status") == []
        assert bench.context.deferred.has_turns is (n % 10 == 0)
        if n % 10 == 0:
            # the answer comes before the idle gap, and changes nothing in what is said of the tick
            bench.advance_ms(0.1)
            fields = answer_fields(1.5e-8, hand.message.seq, hand.message.t_ns)
            node.on_message(bench.received("teleop/backward", "controller@slave", **fields))
            bench.run_deferred()
            (status,) = bench.take("law/status")
            assert (status.port_energy_j, status.t_ns) == (entered_j, bench.clock.now_ns())
            # not once more
            bench.run_deferred()
            assert bench.take("law/status") == []
        bench.advance_ms(0.3)


def status_fields(port_energy_j: float) -> dict[str, Any]:
    return {
        "law": "position_force",
        "switching": False,
        "port_energy_j": port_energy_j,
        "port_power_w": 0.0,
        "net_valid": False,
        "net_energy_j": 0.0,
        "left_j": 0.0,
        "dissipated_j": 0.0,
        "passive": True,
        "saved_percent": 0.0,
        "heard": True,
        "silence_s": 0.0,
        "round_trip_valid": False,
        "round_trip_s": 0.0,
    }


# --- the age of what is heard, and a half that was held up ---

LINK_MS = [0, 150]


def aged(bench: Any, topic: str, src: str, age_ms: float, **fields: Any) -> Any:
    """Give a message that was sent so long ago [ms], received now."""
    return bench.received(topic, src, t_ns=bench.clock.now_ns() - round(age_ms * 1e6), **fields)


def faults(bench: Any) -> list[str]:
    return [event.text for event in bench.take("session/event") if event.kind == "fault"]


@pytest.mark.parametrize(("age_ms", "taken"), [(49.0, True), (51.0, False)])
def test_an_old_sample_of_the_hand_goes_no_further(master: Any, age_ms: float, taken: bool) -> None:
    bench, node = master
    tick(bench, node)
    bench.take("teleop/forward")
    bench.advance_ms(1.0)
    node.on_message(aged(bench, "haptic/state", "haptic_node@master", age_ms, **hand_fields()))
    assert len(bench.take("teleop/forward")) == taken
    assert node.stale == (not taken)
    assert faults(bench) == ["haptic/state of haptic_node@master is 51 ms off, of 50 ms allowed: it is rejected"] * (
        not taken
    )


@pytest.mark.parametrize("link_ms", LINK_MS)
@pytest.mark.parametrize(("age_ms", "mode"), [(49, "position"), (51, "off")])
def test_an_old_answer_does_not_couple_the_hand(master: Any, age_ms: int, mode: str, link_ms: int) -> None:
    """It was sent a moment ago by a half that was held up: the sample that it descends from shows it."""
    bench, node = master
    for direction in ("forward", "backward"):
        node.on_message(bench.link_delay(direction, link_ms * PERIOD_NS))
    hand = tick(bench, node)
    sampled_ns = bench.clock.now_ns() - (age_ms + 2 * link_ms) * PERIOD_NS
    node.on_message(bench.received("teleop/backward", "controller@slave", **answer_fields(0.0, hand.seq, sampled_ns)))
    tick(bench, node)
    assert [command.mode for command in bench.take("haptic/command")] == [mode]
    assert node.stale == (mode == "off")


@pytest.mark.parametrize("link_ms", LINK_MS)
@pytest.mark.parametrize(("age_ms", "commands"), [(49, 1), (51, 0)])
def test_an_old_signal_moves_no_tip(slave: Any, age_ms: int, commands: int, link_ms: int) -> None:
    bench, node = slave
    node.on_message(bench.link_delay("forward", link_ms * PERIOD_NS))
    sampled_ns = bench.clock.now_ns() - (age_ms + link_ms) * PERIOD_NS
    node.on_message(bench.received("teleop/forward", "controller@master", **forward_fields(8e-9, 5, sampled_ns)))
    assert len(bench.take("afm/command")) == commands
    assert node.stale == 1 - commands


def test_a_row_of_old_signals_is_reported_once(slave: Any) -> None:
    bench, node = slave
    for n in range(5):
        sampled_ns = bench.clock.now_ns() - 200 * PERIOD_NS
        node.on_message(bench.received("teleop/forward", "controller@master", **forward_fields(8e-9, n, sampled_ns)))
        bench.advance_ms(1.0)
    assert len(faults(bench)) == 1
    node.on_message(
        bench.received("teleop/forward", "controller@master", **forward_fields(8e-9, 5, bench.clock.now_ns()))
    )
    node.on_message(bench.received("teleop/forward", "controller@master", **forward_fields(8e-9, 6, sampled_ns)))
    assert len(faults(bench)) == 1
    assert node.stale == 6


@pytest.mark.parametrize("stalled_ms", [200, 1000, 3000])
def test_a_master_that_stalled_waits_for_a_fresh_answer(master: Any, stalled_ms: int) -> None:
    bench, node = master
    for _ in range(5):
        hand = tick(bench, node)
        answer = answer_fields(0.0, hand.seq, hand.t_ns)
        node.on_message(bench.received("teleop/backward", "controller@slave", **answer))
    assert {command.mode for command in bench.take("haptic/command")} == {"position"}
    # held up between a sample and its command: neither that nor the answer before counts any more
    tick(bench, node)
    bench.take("session/event")
    bench.advance_ms(stalled_ms)
    hand = tick(bench, node)
    assert bench.take("haptic/command") == []
    assert faults(bench) == [f"this process stalled for {stalled_ms + 1} ms: messages that waited for it are late"]
    tick(bench, node)
    (command,) = bench.take("haptic/command")
    assert command.mode == "off"
    node.on_message(bench.received("teleop/backward", "controller@slave", **answer_fields(0.0, hand.seq, hand.t_ns)))
    assert [command.mode for command in bench.take("haptic/command")] == ["position"]


def follow(bench: Any, node: SlaveController, ticks: int = 5) -> None:
    """Let the instrument follow for a while, at a base that is not where the reference is."""
    follows_already(bench, node)
    for n in range(ticks):
        bench.advance_ms(1.0)
        fields = forward_fields(8e-9, n, bench.clock.now_ns())
        node.on_message(bench.received("teleop/forward", "controller@master", **fields))
        (command,) = bench.take("afm/command")
        node.on_message(bench.received("afm/state", "afm_node@slave", **tip_fields(-1e-9, command.seq)))
    bench.take("teleop/backward")


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("stalled_ms", [200, 1000, 3000])
def test_a_slave_that_stalled_holds_until_it_knows_where_the_base_is(bench_of: Any, law: str, stalled_ms: int) -> None:
    bench = bench_of("controller@slave")
    node = SlaveController(bench.context, ControllerConfig(law=law))
    follow(bench, node)
    before = node.memory.reference.position_m
    bench.advance_ms(stalled_ms)
    fields = {**forward_fields(20e-9, 9, bench.clock.now_ns()), "law": law, "active": True}
    node.on_message(bench.received("teleop/forward", "controller@master", **fields))
    (command,) = bench.take("afm/command")
    assert (command.mode, command.base_position_m[2]) == ("hold", -before)
    # no answer is owed for what was asked before
    assert bench.take("teleop/backward") == []
    assert faults(bench) == [f"this process stalled for {stalled_ms} ms: messages that waited for it are late"]
    # the instrument says where it is, 9 nm: the half begins there
    node.on_message(bench.received("afm/state", "afm_node@slave", **tip_fields(0.0, command.seq)))
    (backward,) = bench.take("teleop/backward")
    assert backward.active
    assert node.memory.reference.position_m == 9e-9
    bench.advance_ms(1.0)
    fields = {**fields, "hand_seq": 10, "hand_t_ns": bench.clock.now_ns()}
    node.on_message(bench.received("teleop/forward", "controller@master", **fields))
    (command,) = bench.take("afm/command")
    assert command.mode == "position"


@pytest.mark.parametrize("law", LAWS)
def test_a_silent_instrument_is_told_to_hold(bench_of: Any, law: str) -> None:
    """What a law would ask of a base whose place it does not know would be obeyed when the instrument goes on."""
    bench = bench_of("controller@slave")
    node = SlaveController(bench.context, ControllerConfig(law=law))
    follow(bench, node)
    modes = []
    for n in range(5, 65):
        bench.advance_ms(1.0)
        fields = {**forward_fields(8e-9 + n * 1e-10, n, bench.clock.now_ns()), "law": law}
        node.on_message(bench.received("teleop/forward", "controller@master", **fields))
        modes += [command.mode for command in bench.take("afm/command")]
    assert modes[:50] == ["position"] * 50
    assert set(modes[52:]) == {"hold"}


def test_a_controller_takes_a_turn_at_least_twice_a_bound(master: Any) -> None:
    bench, node = master
    tick(bench, node)
    assert node.deadline_ns() - bench.clock.monotonic_ns() == 25 * PERIOD_NS
    bench.advance_ms(25.0)
    node.on_deadline(bench.clock.monotonic_ns())
    assert faults(bench) == []
    bench.advance_ms(51.0)
    node.on_deadline(bench.clock.monotonic_ns())
    assert faults(bench) == ["this process stalled for 51 ms: messages that waited for it are late"]


def test_a_hand_that_is_played_from_a_recording_is_followed(master: Any, slave: Any) -> None:
    """Its stamps are from before the halves began, and a law counts its periods by them as ever."""
    bench, node = master
    for n in range(3):
        bench.advance_ms(1.0)
        played = bench.received("haptic/state", "haptic_node@master", t_ns=10**12 + n * PERIOD_NS, **hand_fields())
        node.on_message(played)
    forwards = bench.take("teleop/forward")
    assert [forward.hand_t_ns for forward in forwards] == [10**12 + n * PERIOD_NS for n in range(3)]
    far, half = slave
    for n in range(3):
        half.on_message(
            far.received("teleop/forward", "controller@master", **forward_fields(8e-9, n, 10**12 + n * PERIOD_NS))
        )
    assert len(far.take("afm/command")) == 3
    assert node.stale == half.stale == 0
