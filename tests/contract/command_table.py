"""The table of commands in proto/COMMANDS.md, from the nodes themselves."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from services.afm_node.node import WORDS, AfmNode
from services.controller.half import ControllerHalf
from services.delay_node.node import DelayNode
from services.haptic_node.node import HapticNode
from services.player.node import SETTERS, PlayerNode
from services.recorder.node import ACTIONS, RecorderNode
from telenano.runtime.loop.node import Node
from telenano.sections.controller_section import OWN_LAWS, ControllerConfig
from telenano.sections.program_requests import InstrumentRequest
from telenano.settings.afm_disturbances import DisturbanceConfig
from telenano.settings.config import flatten, nested
from telenano.settings.hand_disturbances import HandDisturbanceConfig
from telenano.settings.link_settings import LinkSettings

PAGE = Path(__file__).parents[2] / "proto" / "COMMANDS.md"
START, END = "<!-- commands: written by make regenerate -->", "<!-- end of commands -->"
NODES: dict[str, type[Node]] = {
    "haptic_node": HapticNode,
    "afm_node": AfmNode,
    "controller": ControllerHalf,
    "delay_node": DelayNode,
    "recorder": RecorderNode,
    "player": PlayerNode,
}
# the period is that of the hand, and the rig runs already
NOT_SETTABLE = "period_s"
# nodes of which every key can be set, and what is to be said of that
WHOLE_SECTIONS = {
    "controller": f" but `{NOT_SETTABLE}`; `law` is one of {', '.join((*OWN_LAWS, 'tactile'))}",
    "delay_node": "",
}


def settable(node: str) -> list[str]:
    """Give the keys that `set` takes at a node, in the order of its settings."""
    if node == "controller":
        return [key for key in flatten(ControllerConfig().model_dump()) if key != NOT_SETTABLE]
    if node == "delay_node":
        return list(LinkSettings().flattened())
    if node == "afm_node":
        return [
            *flatten(InstrumentRequest().model_dump()),
            *flatten({"disturbances": DisturbanceConfig().model_dump()}),
            "spring.stiffness_n_per_m",
            "sample.restore",
        ]
    if node == "haptic_node":
        return ["operator", *flatten({"disturbances": HandDisturbanceConfig().model_dump()})]
    return list(ACTIONS if node == "recorder" else SETTERS)


def condensed(keys: list[str]) -> str:
    """Write dotted keys with what they have in common once: `a.{b, c}`."""
    tree = nested(dict.fromkeys(keys, None), "table")
    return ", ".join(f"`{key}`" if below is None else _section(key, below) for key, below in tree.items())


def parameters(node: str, command: str) -> str:
    """Say what a command takes."""
    if command == "mark":
        return "any: they are the data of the mark"
    if (node, command) == ("afm_node", "arm"):
        return f"{', '.join(f'`{key}`' for key in WORDS)}, or none; `place` is `hand`"
    if (node, command) == ("afm_node", "stop"):
        return "`because`, or none: why a program withdraws the tip, which the event of the tip repeats"
    if command != "set":
        return "none"
    if node in WHOLE_SECTIONS:
        section = f"[section](../docs/scenarios.md#{node}) `{node}` of a scenario"
        return f"every key of the {section}{WHOLE_SECTIONS[node]}"
    flags = "; each is `true`" if node == "recorder" else ""
    return condensed(settable(node)) + flags


def table() -> str:
    """Give the table in Markdown."""
    rows = ["| node | command | reached by a pattern | parameters |", "|---|---|---|---|"]
    for node, kind in NODES.items():
        for command in (*kind.commands, *kind.named_commands):
            by_pattern = "yes" if command in kind.commands else "no, by its name"
            rows.append(f"| `{node}` | `{command}` | {by_pattern} | {parameters(node, command)} |")
    return "\n".join(rows)


def with_table(page: str) -> str:
    """Give the page with the table in its place."""
    head, _, rest = page.partition(START)
    _, end, tail = rest.partition(END)
    assert end, f"{PAGE.name} needs the lines {START!r} and {END!r}"
    return f"{head}{START}\n\n{table()}\n\n{end}{tail}"


def _section(key: str, below: Mapping[str, Any]) -> str:
    return f"`{key}`.{{{', '.join(_path(inner, leaf) for inner, leaf in below.items())}}}"


def _path(key: str, below: Mapping[str, Any] | None) -> str:
    if below is None:
        return key
    return f"{key}.{{{', '.join(_path(inner, leaf) for inner, leaf in below.items())}}}"
