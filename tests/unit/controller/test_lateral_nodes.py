"""The lateral path in both halves as nodes: what crosses the bus, and what mode and clutch do as commands."""

from itertools import pairwise
from typing import Any

import pytest
from test_controller_node import answer_fields, forward_fields, hand_fields, tip_fields

from services.controller.master_half import MasterController
from services.controller.slave_half import SlaveController
from telenano.sections.controller_section import ControllerConfig
from telenano.wire.errors import RefusedError
from telenano.wire.messages import SessionControl
from telenano.wire.node_state import pack, restore

PERIOD_NS = 1_000_000


def config(**lateral: Any) -> ControllerConfig:
    return ControllerConfig.model_validate({"lateral": {"mode": "rate", **lateral}})


def control(node: Any, bench: Any, **parameters: Any) -> str:
    fields = {"id": "a", "command": "set", "target": "controller", "parameters": parameters}
    message = bench.make("session/control", "console@master", **fields)
    assert isinstance(message, SessionControl)
    return str(node.on_control(message))


def ticks(
    bench: Any, node: MasterController, x_m: float, count: int, force_n: float = 0.0, place_m: float = 0.0
) -> None:
    """Send samples of a hand at x_m, each answered at once with a lateral force and a place of the stage."""
    for _ in range(count):
        bench.clock.advance_ns(PERIOD_NS)
        fields = {**hand_fields(), "position_m": (x_m, 0.0, 0.0)}
        hand = bench.received("haptic/state", "haptic_node@master", **fields)
        node.on_message(hand)
        answer = answer_fields(0.0, hand.message.seq, hand.message.t_ns)
        answer |= {"force_n": (force_n, 0.0, 0.0), "position_m": (place_m, 0.0, 0.0)}
        node.on_message(bench.received("teleop/backward", "controller@slave", **answer))


@pytest.fixture
def master(bench_of: Any) -> tuple[Any, MasterController]:
    bench = bench_of("controller@master")
    return bench, MasterController(bench.context, config())


@pytest.fixture
def slave(bench_of: Any) -> tuple[Any, SlaveController]:
    bench = bench_of("controller@slave")
    return bench, SlaveController(bench.context, config())


def test_a_hand_beside_its_middle_moves_the_reference_and_feels_the_tip(master: Any) -> None:
    bench, node = master
    ticks(bench, node, 0.0, 20)
    bench.take("teleop/forward")
    ticks(bench, node, 6e-3, 1000, -1.07e-8)
    forwards, commands = bench.take("teleop/forward"), bench.take("haptic/command")
    ways = [b.position_m[0] - a.position_m[0] for a, b in pairwise(forwards)]
    # 150 nm/s
    assert max(ways) == pytest.approx(1.5e-10, rel=1e-9)
    # the tip's 1.07 N, and 30 N/m over 6 mm
    assert commands[-1].force_n[0] == pytest.approx(-1.07 - 0.18, rel=1e-9)
    assert [event.data["lateral"] for event in bench.take("session/event")] == ["met"]


def test_mode_and_clutch_are_commands_and_direct_cannot_be_returned_to(master: Any) -> None:
    bench, node = master
    ticks(bench, node, 0.0, 20)
    ticks(bench, node, 6e-3, 10)
    before = bench.take("teleop/forward")[-1].position_m[0]
    assert control(node, bench, **{"lateral.clutch": "released"}) == "set lateral.clutch = released"
    ticks(bench, node, 9e-3, 50)
    assert bench.take("teleop/forward")[-1].position_m[0] == before
    control(node, bench, **{"lateral.clutch": "engaged", "lateral.mode": "position"})
    ticks(bench, node, 9e-3, 5)
    ticks(bench, node, 9.01e-3, 5)
    assert bench.take("teleop/forward")[-1].position_m[0] == pytest.approx(before + 5e-10, rel=1e-6)
    with pytest.raises(RefusedError, match=r"lateral\.mode cannot be set back to direct"):
        control(node, bench, **{"lateral.mode": "direct"})
    with pytest.raises(RefusedError, match="clutch"):
        control(node, bench, **{"lateral.clutch": "half"})


def test_the_energy_across_is_in_the_account_of_the_port(master: Any) -> None:
    bench, node = master
    ticks(bench, node, 0.0, 50)
    # out by 10 mm against the damper and the spring to the middle
    for n in range(100):
        bench.clock.advance_ns(PERIOD_NS)
        fields = {**hand_fields(), "position_m": (1e-4 * n, 0.0, 0.0), "velocity_m_per_s": (0.1, 0.0, 0.0)}
        node.on_message(bench.received("haptic/state", "haptic_node@master", **fields))
    bench.run_deferred()
    status = bench.take("law/status")[-1]
    # 0.5 * 30 N/m * (10 mm)^2 and 0.2 N over 10 mm
    assert status.port_energy_j == pytest.approx(1.5e-3 + 2e-3, rel=0.15)
    assert status.passive


def test_the_state_of_a_hand_that_pushes_can_be_restored(master: Any, bench_of: Any) -> None:
    bench, node = master
    ticks(bench, node, 0.0, 20)
    ticks(bench, node, 6e-3, 300, -1e-8)
    other = MasterController(bench_of("controller@master").context, config())
    restore(other, pack(node))
    assert other.memory.across == node.memory.across
    assert pack(other) == pack(node)


def signals(bench: Any, node: SlaveController, references: list[float], place_m: float, mode: str = "follow") -> Any:
    """Send references of a hand, with an instrument whose stage stands at a place; return the commands."""
    found = []
    for n, x_m in enumerate(references):
        bench.clock.advance_ns(PERIOD_NS)
        stamp = bench.clock.now_ns()
        fields = {**forward_fields(0.0, n, stamp), "position_m": (x_m, 0.0, 0.0), "hand_t_ns": stamp}
        node.on_message(bench.received("teleop/forward", "controller@master", **fields))
        (command,) = bench.take("afm/command")
        found.append(command)
        tip = {**tip_fields(0.0, command.seq, mode=mode), "base_position_m": (place_m, 0.0, 0.0), "hand_t_ns": stamp}
        node.on_message(bench.received("afm/state", "afm_node@slave", **tip))
    return found


def test_the_stage_is_commanded_from_where_it_is_while_the_hand_moves_it(slave: Any) -> None:
    bench, node = slave
    resting = signals(bench, node, [5e-7] * 20, 2e-6)
    assert all(command.lateral_m is None and command.base_position_m[:2] == (0.0, 0.0) for command in resting)
    moving = signals(bench, node, [5e-7 + 3e-10 * n for n in range(1, 11)], 2e-6)
    assert moving[-1].lateral_m == pytest.approx((2e-6 + 3e-9, 0.0), rel=1e-9)
    after = signals(bench, node, [5e-7 + 3e-9] * 300, 2e-6 + 3e-9)
    assert after[-1].lateral_m is None


def test_a_tip_that_does_not_follow_is_not_moved_and_nothing_is_made_up_for(slave: Any) -> None:
    bench, node = slave
    signals(bench, node, [0.0] * 20, 0.0)
    away = signals(bench, node, [3e-10 * n for n in range(500)], 0.0, mode="retracting")
    assert all(command.lateral_m is None for command in away[2:])
    back = signals(bench, node, [3e-10 * n for n in range(500, 520)], 0.0)
    assert back[-1].lateral_m is not None and back[-1].lateral_m[0] < 20 * 3e-10
