"""A `set` that a node refuses has changed nothing: whatever else the command asks for, at every node that takes one."""

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import fuzzed_nodes
import msgspec
import pytest

from telenano.runtime.loop.node import Node
from telenano.wire.errors import RecordingError, RefusedError
from telenano.wire.messages import Scalar
from telenano.wire.topics import TOPICS

Parameters = dict[str, Scalar]
THERMAL = {"disturbances.thermal.enabled": True}


def afm(node: Any) -> Any:
    return node._memory.pointer, node._programs.name, node._driver.simulation.disturbances


def player(node: Any) -> Any:
    playback, clock = node.playback, node.playback_clock
    return clock.rate, clock.paused, playback.loop, playback.start_ns, playback.end_ns, node._steps


# Each node has what is compared, what it takes, and what it refuses beside it.
COMMANDS: list[tuple[str, Callable[[Any], Any], Parameters, Parameters]] = [
    ("afm_node@slave", afm, THERMAL, {"lateral.x_m": 1.0}),
    ("afm_node@slave", afm, THERMAL, {"program": "pause"}),
    ("afm_node@slave", afm, THERMAL, {"sample.restore": False}),
    ("afm_node@slave", afm, THERMAL, {"spring.stiffness_n_per_m": 2.0}),
    ("afm_node@slave", afm, {"lateral.x_m": 1e-9}, {"program": "pause"}),
    ("afm_node@slave", afm, {"lateral.x_m": 1e-9}, {"program": "scan", "scan.width_m": -1.0}),
    ("afm_node@slave", afm, {"lateral.x_m": 1e-9}, {"lateral.y_m": 1.0}),
    ("afm_node@slave", afm, {"lateral.x_m": 1e-9}, {"nothing": 1.0}),
    ("player@master", player, {"player.rate": 2.0}, {"player.step": 0}),
    ("player@master", player, {"player.rate": 2.0}, {"player.a_s": 0.2, "player.b_s": 0.1}),
    ("player@master", player, {"player.loop": False}, {"player.rate": -1.0}),
    ("player@master", player, {"player.pause": True}, {"player.step": 0}),
    ("player@master", player, {"player.pause": True}, {"player.next_event": True}),
    ("player@master", player, {"player.a_s": 0.1}, {"player.loop": 1.0}),
    ("player@master", player, {"player.a_s": 0.1, "player.b_s": 0.2}, {"player.step": 0}),
    ("delay_node@master", lambda node: node.engine.settings, {"forward.delay_s": 0.02}, {"backward.delay_s": -1.0}),
    ("delay_node@master", lambda node: node.engine.settings, {"forward.delay_s": 0.02}, {"profile": "none"}),
    *(
        (f"controller@{site} virtual_impedance", lambda node: node.config, {"law": "wave"}, refused)
        for site in ("master", "slave")
        for refused in ({"wave.impedance_n_s_per_m": -1.0}, {"nothing": 1.0}, {"lateral.mode": "x"})
    ),
    ("haptic_node@master", lambda node: node._config, {}, {"operator": "{}", "x": 1.0}),
    ("launcher@master", lambda node: vars(node).get("phase"), {}, {"nothing": 1.0}),
]


@pytest.fixture
def build(tmp_path: Path) -> Iterator[Callable[[str], Any]]:
    with fuzzed_nodes.opened(tmp_path) as opened:
        yield lambda name: opened(name)[1].node


def told(node: Node, parameters: Parameters) -> str:
    topic = TOPICS["session/control"].model
    header = {"seq": 0, "t_ns": node.clock.now_ns(), "src": "console@master", "v": topic.version}
    fields = {"id": "a", "command": "set", "target": node.context.key, "parameters": parameters}
    return node.on_control(msgspec.convert({**header, **fields}, topic))


@pytest.mark.parametrize(("name", "seen", "taken", "refused"), COMMANDS)
def test_a_command_is_carried_out_as_a_whole_or_not_at_all(
    build: Callable[[str], Any], name: str, seen: Callable[[Any], Any], taken: Parameters, refused: Parameters
) -> None:
    node = build(name)
    before = seen(node)
    for parameters in (refused | taken, taken | refused):
        with pytest.raises((RefusedError, RecordingError)):
            told(node, parameters)
        assert seen(node) == before
    if taken:
        told(node, taken)
        assert seen(node) != before


def test_every_node_that_takes_a_set_is_tried() -> None:
    # `test_recorder_rotation` has the recorder, which needs a file for it.
    tried = {name.partition(" ")[0] for name, *_ in COMMANDS} | {"recorder@master"}
    assert tried == {name.partition(" ")[0] for name in fuzzed_nodes.BUILD}
