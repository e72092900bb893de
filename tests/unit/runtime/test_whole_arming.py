"""An `arm` that a device refuses has armed nothing, begun nothing and released no stop, and its answer says why."""

from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import pytest

from services.afm_node.node import AfmNode
from services.haptic_node.node import HapticNode
from telenano.afm import safety
from telenano.afm.sim import simulated_afm
from telenano.hand.sim import SimulatedHaptic
from telenano.runtime.loop.commands import CommandHandler
from telenano.sections.afm_section import AfmConfig
from telenano.sections.hand_section import HapticConfig
from telenano.settings.config import validate
from telenano.wire.errors import ConfigError

CURVE = {"program": "curve", "curve": {"load_n": 5e-9}}
TOO_HARD = {"program": "curve", "curve": {"load_n": 1e-3}}
TOO_FAR = {"program": "tactile", "tactile": {"x1_m": 1e-3}}
# The lateral stage reaches 50 µm.
LED_TOO_FAR = {**CURVE, "lateral": {"x_m": 1e-3}}


class Armed(NamedTuple):
    """A device on a bench, behind what takes its commands, in emergency stop or as it was at its start."""

    bench: Any
    node: Any
    handler: CommandHandler

    def command(self, name: str) -> tuple[str, str]:
        """Give a command, which quotes the newest stop; return kind and text of the answer."""
        quoted = {self.node.context.key: self.handler.latch.quotation}
        fields = {"id": f"{name}-{self.bench.clock.now_ns()}", "command": name, "target": "*"}
        fields["parameters"] = {"place": "hand"} if name == "arm" else {}
        control = self.bench.make("session/control", "console@master", **fields, node_latch=quoted)
        self.handler.handle(control, self.bench.clock.now_ns())
        answer = self.bench.take("session/event")[-1]
        return answer.kind, answer.text

    def turn(self, count: int = 1) -> None:
        for _ in range(count):
            self.bench.advance_ms(1.0)
            self.node.on_deadline(self.bench.clock.monotonic_ns())

    def follow(self, mode: str = "position") -> None:
        """Give the tip something to follow."""
        fields = {"mode": mode, "base_position_m": (0.0, 0.0, 1e-9), "hand_seq": 1, "hand_armed": True}
        now_ns = self.bench.clock.now_ns()
        self.node.on_message(self.bench.received("afm/command", "controller@slave", **fields, hand_t_ns=now_ns))

    def go_on(self) -> None:
        """Let a time pass in which everything that could move the device may."""
        for _ in range(300):
            if isinstance(self.node, AfmNode):
                self.follow()
            self.turn()

    def lose(self) -> None:
        self.node.is_lost = True

    def press(self) -> None:
        self.node._switch_pressed = True


def tip(bench: Any, kept: Path, begin: dict[str, Any] | None) -> Armed:
    config = AfmConfig.model_validate({} if begin is None else {"begin": begin})
    node = AfmNode(bench.context, config, simulated_afm(config.to_params()))
    return behind_its_handler(bench, node, kept)


def hand(bench: Any, kept: Path) -> Armed:
    config = HapticConfig()
    node = HapticNode(bench.context, config, SimulatedHaptic(config.to_plant_params(), 0.0))
    return behind_its_handler(bench, node, kept)


def behind_its_handler(bench: Any, node: AfmNode | HapticNode, kept: Path) -> Armed:
    def latched() -> bool:
        return node.is_latched

    handler = CommandHandler(bench.context.key, node.commands, node.on_control, node.event, is_latched=latched)
    handler.latch.path = kept
    return Armed(bench, node, handler)


def nothing(armed: Armed) -> None:
    """Do nothing: there is no command to follow."""


def still_goes_back(armed: Armed) -> None:
    """Stop the tip when it is far from where it rests, which takes it longer than the command that follows."""
    armed.node._memory.guard = armed.node._memory.guard._replace(base_m=0.0)
    armed.follow()


def lost(armed: Armed) -> None:
    armed.follow()
    armed.lose()


# What the tip begins when it is armed, what is so before that, and what the answer says.
REFUSALS_OF_THE_TIP: list[tuple[dict[str, Any] | None, Callable[[Armed], None], str]] = [
    *(
        case
        for begin in (None, CURVE)
        for case in (
            (begin, still_goes_back, "still_retracting"),
            (begin, lost, "device_lost" if begin is None else "the instrument is lost"),
        )
    ),
    (TOO_HARD, Armed.follow, "curve.load_n must be below"),
    (TOO_HARD, nothing, "curve.load_n must be below"),
    (TOO_HARD, lambda armed: armed.follow("hold"), "curve.load_n must be below"),
    (TOO_FAR, Armed.follow, "tactile"),
    (LED_TOO_FAR, Armed.follow, "is beyond lateral.reach_m"),
]


@pytest.mark.parametrize("stopped", [False, True], ids=["at rest", "stopped"])
@pytest.mark.parametrize(("begin", "before", "why"), REFUSALS_OF_THE_TIP)
def test_a_tip_that_refuses_to_be_armed_stays_where_it_is(
    bench_of: Any,
    tmp_path: Path,
    begin: dict[str, Any] | None,
    before: Callable[[Armed], None],
    why: str,
    stopped: bool,
) -> None:
    armed = tip(bench_of("afm_node@slave"), tmp_path / "kept", begin)
    if stopped:
        assert armed.command("estop")[0] == "ack"
        armed.turn(2)
    before(armed)
    mode = armed.node._memory.guard.mode
    kind, text = armed.command("arm")
    assert (kind, text[:11]) == ("refused", "not armed: ")
    assert why in text
    assert armed.node._memory.guard.mode == mode
    armed.go_on()
    assert armed.node._memory.guard.mode == (safety.MODE_ESTOP if stopped else safety.MODE_RETRACTED)
    assert not armed.bench.take("afm/program")
    assert (tmp_path / "kept").exists() is stopped


@pytest.mark.parametrize("why", ["the device itself reports an emergency stop", "an emergency stop came"])
def test_a_hand_that_refuses_to_be_armed_stays_in_emergency_stop(bench_of: Any, tmp_path: Path, why: str) -> None:
    armed = hand(bench_of("haptic_node@master"), tmp_path / "kept")
    assert armed.command("estop")[0] == "ack"
    if "itself" in why:
        armed.turn()
        armed.press()
    kind, text = armed.command("arm")
    assert (kind, text[:11]) == ("refused", "not armed: ")
    assert why in text
    armed.go_on()
    assert armed.node._memory.guard.estop_latched
    assert (tmp_path / "kept").exists()


@pytest.mark.parametrize("stopped", [False, True], ids=["at rest", "stopped"])
@pytest.mark.parametrize("begin", [None, CURVE])
def test_a_tip_that_is_armed_does_what_it_begins(
    bench_of: Any, tmp_path: Path, begin: dict[str, Any] | None, stopped: bool
) -> None:
    armed = tip(bench_of("afm_node@slave"), tmp_path / "kept", begin)
    if stopped:
        armed.command("estop")
        armed.turn(2)
    armed.follow()
    assert armed.command("arm")[0] == "ack"
    assert armed.node._memory.guard.mode == safety.MODE_FOLLOW
    assert not (tmp_path / "kept").exists()
    armed.turn(200)
    assert bool(armed.bench.take("afm/program")) is (begin is not None)


def test_a_tip_is_led_to_the_place_that_the_scenario_begins_with_once_it_is_armed(
    bench_of: Any, tmp_path: Path
) -> None:
    armed = tip(bench_of("afm_node@slave"), tmp_path / "kept", {**CURVE, "lateral": {"x_m": 2e-7, "y_m": -1e-7}})
    still_goes_back(armed)
    assert armed.command("arm")[0] == "refused"
    assert armed.node._memory.pointer == (0.0, 0.0)
    armed.go_on()
    kind, text = armed.command("arm")
    assert kind == "ack" and "the tip goes to x = 200 nm, y = -100 nm" in text
    assert armed.node._memory.pointer == (2e-7, -1e-7)


def test_a_hand_is_armed_once_its_stop_has_been_carried_out(bench_of: Any, tmp_path: Path) -> None:
    armed = hand(bench_of("haptic_node@master"), tmp_path / "kept")
    armed.command("estop")
    armed.turn()
    assert armed.command("arm")[0] == "ack"
    armed.turn()
    assert not armed.node._memory.guard.estop_latched
    assert not (tmp_path / "kept").exists()


@pytest.mark.parametrize("begin", [{"lateral": {"x_m": 1e-9}}, {"program": "pause"}])
def test_what_is_no_program_cannot_begin(begin: dict[str, Any]) -> None:
    with pytest.raises(ConfigError, match=r"begin\.program: must be one of scan, curve"):
        validate(AfmConfig, {"begin": begin}, "s.yaml", "afm_node")
