"""Another simulated hand by `set operator`, between two runs of the operator's force profile."""

import json
from typing import Any

import pytest

from services.haptic_node.node import HapticNode
from telenano.hand.sim import SimulatedHaptic
from telenano.sections.hand_section import HapticConfig
from telenano.settings.config import validate
from telenano.wire.errors import RefusedError

PRESS = {"kind": "force_profile", "points": [{"time_s": 0.0, "force_n": 0.0}, {"time_s": 0.01, "force_n": 1.0}]}
HARDER = {"kind": "force_profile", "points": [{"time_s": 0.0, "force_n": 0.0}, {"time_s": 0.01, "force_n": 3.0}]}
ARM = {"kind": "impedance", "path": [{"time_s": 0.0, "position_m": 1e-3}], "arm": "soft"}


class Bench:
    def __init__(self, bench: Any, operator: dict[str, Any], device: Any = None) -> None:
        self.bench = bench
        config = validate(HapticConfig, {"operator": operator}, "test", "haptic_node")
        simulated = SimulatedHaptic(config.to_plant_params(), config.device.start_position_m)
        self.node = HapticNode(bench.context, config, device or simulated)
        self._count = 0

    def control(self, command: str, **parameters: Any) -> str:
        self._count += 1
        fields = {"id": f"a{self._count}", "command": command, "target": "haptic_node", "parameters": parameters}
        return self.node.on_control(self.bench.make("session/control", "console@master", **fields))

    def forces(self, ticks: int) -> list[float]:
        """Return the operator's force over so many ticks [N], towards the sample."""
        for _ in range(ticks):
            clock = self.bench.clock
            clock.advance_ns(max(0, self.node.deadline_ns() - clock.monotonic_ns()))
            self.node.on_deadline(clock.monotonic_ns())
        return [-state.operator_force_n[2] for state in self.bench.take("haptic/state")]


@pytest.fixture
def hand(bench_of: Any) -> Bench:
    return Bench(bench_of("haptic_node@master"), PRESS)


def test_the_next_programme_is_that_of_the_new_hand(hand: Bench) -> None:
    hand.control("start")
    assert hand.forces(40)[-1] == 1.0
    hand.control("stop")
    assert (
        hand.control("set", operator=json.dumps(HARDER)) == "the operator is force_profile from the next session start"
    )
    assert set(hand.forces(5)) == {0.0}
    hand.control("start")
    assert hand.forces(40)[-1] == 3.0


def test_a_hand_of_another_kind_begins_at_rest_where_the_arm_is(hand: Bench) -> None:
    hand.control("set", operator=json.dumps(ARM))
    hand.control("start")
    first = hand.forces(1)[0]
    # 50 N/m of the soft arm over a millimetre
    assert first == pytest.approx(0.05, rel=1e-6)


def test_it_is_refused_while_the_programme_runs(hand: Bench) -> None:
    hand.control("start")
    with pytest.raises(RefusedError, match="its force profile runs; stop the session first"):
        hand.control("set", operator=json.dumps(HARDER))


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ("{", "operator: "),
        ('{"kind": "octopus"}', "operator: session/control: haptic_node.operator"),
        ('{"kind": "interactive"}', "operator: a change between a person and a simulated hand needs a new rig"),
        ('"press"', "operator: session/control: haptic_node.operator"),
    ],
)
def test_a_wrong_section_changes_nothing_and_says_what_is_wrong(hand: Bench, text: str, complaint: str) -> None:
    with pytest.raises(RefusedError) as caught:
        hand.control("set", operator=text)
    assert str(caught.value).startswith(complaint)
    hand.control("start")
    assert hand.forces(40)[-1] == 1.0


def test_it_comes_alone(hand: Bench) -> None:
    with pytest.raises(RefusedError, match=r"disturbances\.seed: cannot be set together with operator"):
        hand.control("set", **{"operator": json.dumps(HARDER), "disturbances.seed": 1})


def test_no_state_is_kept_that_a_rerun_could_not_go_on_from(hand: Bench) -> None:
    assert hand.node.capture() is not None
    hand.control("set", operator=json.dumps(HARDER))
    with pytest.raises(ValueError, match="a re-run must begin before that"):
        hand.node.capture()
