"""The table of commands in proto/COMMANDS.md is what the nodes do, and its examples are obeyed."""

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any, get_args

import command_table
import msgspec
import pytest
import spec_client
import yaml

from services.afm_node.node import AfmNode
from services.controller.master_half import MasterController
from services.controller.slave_half import SlaveController
from services.delay_node.node import DelayNode
from services.haptic_node.node import HapticNode
from telenano.afm.sim import simulated_afm
from telenano.hand.sim import SimulatedHaptic
from telenano.runtime.loop.commands import CommandHandler
from telenano.runtime.loop.log import StructuredLog
from telenano.runtime.loop.node import Node, NodeContext
from telenano.sections.afm_section import AfmConfig
from telenano.sections.controller_section import ControllerConfig
from telenano.sections.hand_section import HapticConfig
from telenano.settings.config import flatten
from telenano.settings.link_settings import LinkSettings
from telenano.testing import VirtualClock
from telenano.wire import Message, decode
from telenano.wire.errors import RefusedError
from telenano.wire.messages import AfmState, SessionControl, SessionEvent
from telenano.wire.topics import TOPICS

COMMANDS = get_args(SessionControl.__annotations__["command"].__origin__)
_PAGE = command_table.PAGE.read_text(encoding="utf-8")
EXAMPLES = [yaml.safe_load(text) for text in re.findall(r"^```\n(\{seq:.*?\})\n```$", _PAGE, re.MULTILINE | re.DOTALL)]


class Outside:
    """What surrounds a node: a clock that shows the time of the examples, and what the node publishes."""

    def __init__(self, key: str) -> None:
        self.clock = VirtualClock(epoch_offset_ns=EXAMPLES[0]["t_ns"])
        self.sent: list[Message] = []
        self.context = NodeContext(key, self.clock, self, StructuredLog(key))

    def publish(self, topic: str, **fields: Any) -> Message:
        model = TOPICS[topic].model
        header = {"seq": 0, "t_ns": self.clock.now_ns(), "src": self.context.key, "v": model.version}
        self.sent.append(msgspec.convert({**header, **fields}, model))
        return self.sent[-1]

    def send(self, topic: str, payload: bytes) -> None:
        """Forward nothing."""

    def receive(self) -> Iterator[Any]:
        return iter(())

    def wait(self, deadline_ns: int) -> None:
        """Do not wait."""

    def of(self, kind: type[Message]) -> list[Any]:
        return [message for message in self.sent if isinstance(message, kind)]


def node_of(name: str) -> tuple[Outside, Node]:
    outside = Outside(f"{name}@{'slave' if name == 'afm_node' else 'master'}")
    context = outside.context
    if name == "afm_node":
        return outside, AfmNode(context, AfmConfig(), simulated_afm(AfmConfig().to_params()))
    if name == "haptic_node":
        config = HapticConfig()
        device = SimulatedHaptic(config.to_plant_params(), config.device.start_position_m)
        return outside, HapticNode(context, config, device)
    if name == "delay_node":
        return outside, DelayNode(context, LinkSettings(), outside, outside, Path())
    return outside, MasterController(context, ControllerConfig())


def answered(outside: Outside, node: Node, control: Message) -> SessionEvent:
    assert isinstance(control, SessionControl)
    handler = CommandHandler(outside.context.key, node.commands, node.on_control, node.event)
    handler.handle(control, outside.clock.now_ns())
    events: list[SessionEvent] = [event for event in outside.of(SessionEvent) if event.id == control.id]
    (event,) = events
    return event


@pytest.mark.parametrize("command", COMMANDS)
@pytest.mark.parametrize("name", command_table.NODES)
def test_a_node_knows_the_commands_of_the_table_and_no_other(name: str, command: str) -> None:
    kind = command_table.NODES[name]
    if command in (*kind.commands, *kind.named_commands):
        assert f"| `{name}` | `{command}` |" in _PAGE
        return
    node = object.__new__({"controller": MasterController}.get(name, kind))
    node.context = Outside(f"{name}@master").context
    control = msgspec.convert({**EXAMPLES[0], "command": command, "parameters": {}}, SessionControl)
    with pytest.raises(RefusedError, match=f"^{name}@master does not know {command}$"):
        node.on_control(control)


@pytest.mark.parametrize("name", ["haptic_node", "afm_node", "delay_node", "controller"])
def test_a_node_takes_what_the_table_says(name: str) -> None:
    outside, node = node_of(name)
    # each key with the value that it has; none stands for what the law chooses
    values = LinkSettings().flattened() if name == "delay_node" else flatten(ControllerConfig().model_dump())
    for command in node.commands:
        keys = [key for key in command_table.settable(name) if values[key] is not None] if command == "set" else []
        parameters = {key: values[key] for key in keys}
        fields = {**EXAMPLES[0], "command": command, "target": name, "id": command, "parameters": parameters}
        event = answered(outside, node, msgspec.convert(fields, SessionControl))
        # the AFM is armed by a fresh command only, and knows what it is asked
        assert event.kind == "ack" or event.text.startswith("not armed: ")
    node.make_safe()


def test_examples_are_obeyed() -> None:
    setting, stop = (decode(*_frames(example)) for example in EXAMPLES)
    for key, kind in (("controller@master", MasterController), ("controller@slave", SlaveController)):
        outside = Outside(key)
        node = kind(outside.context, ControllerConfig())
        assert answered(outside, node, setting).kind == "ack"
        ((name, value),) = setting.parameters.items()
        assert flatten(node.config.model_dump())[name] == value != flatten(ControllerConfig().model_dump())[name]
    outside, node = node_of("afm_node")
    assert answered(outside, node, stop).kind == "ack"
    assert [state.mode for state in outside.of(AfmState)] == ["estop"]
    node.make_safe()


def _frames(fields: dict[str, Any]) -> tuple[str, bytes]:
    topic, payload = spec_client.write("session/control", **fields)
    return topic.decode(), payload
