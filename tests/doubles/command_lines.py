"""Every command of the project and its packages, as an object of typer, and the arguments that it needs.

for words, command in commands():
    end = ended([*words, *needed(words, command), "--site-file", "nosuch.yaml"], most_s=2.0)
"""

from collections.abc import Collection, Iterator
from typing import Any, Literal, get_args, get_origin

import typer

from telenano.cli.root import app
from telenano.settings import DEMO_RECORDING

# Arguments of a command in addition to the option under test, if it needs more than recordings and folders.
WORDS = {
    "up": "--scenario fig12",
    "session": "mark",
    "simulate": "fig12 --out out/made",
    "topic echo": "afm/state",
    "topic hz": "afm/state",
    "link set": "delay_s=0.01",
    "link profile": "5g",
    "link udp": "127.0.0.1:5000 127.0.0.1:5001",
    "record": "--out made.mcap",
    "scenario check": "fig12",
    "scenario new": "fig12",
    "law balance": "wave",
    "law by-line": "--scenario fig12",
    "new": "law my_law",
    "keys allow": "other KEY --role data",
    "bag export": f"{DEMO_RECORDING} --out out/made --to mcap-json",
    "bag rerun": f"{DEMO_RECORDING} --node controller@master",
    "device probe": "--device simulated_impedance",
    "device monitor": "--device simulated_impedance",
    "device trial": "haply",
    "push": "--from 0,0 --to 100,0",
    "curve": "--out out/made",
    "sample": "--out out/made",
    "study advise": "--delay 20",
    "study stability": "--environment spring --law wave --out out/made",
}


def commands() -> Iterator[tuple[tuple[str, ...], Any]]:
    """Yield the words of each command and the command; a group that runs without one of its commands is one as well."""

    def below(group: Any, words: tuple[str, ...]) -> Iterator[tuple[tuple[str, ...], Any]]:
        context = typer.Context(group)
        for name in group.list_commands(context):
            _, command, _ = group.resolve_command(context, [name])
            is_group = hasattr(command, "commands")
            if not is_group or command.invoke_without_command:
                yield (*words, name), command
            if is_group:
                yield from below(command, (*words, name))

    yield from below(typer.main.get_command(app), ())


def needed(words: tuple[str, ...], command: Any, left_out: Collection[str] = ()) -> list[str]:
    """Return the required arguments of a command, without the parameters in `left_out`."""
    if given := WORDS.get(" ".join(words)):
        return given.split()
    found = []
    for parameter in command.params:
        if parameter.required and parameter.name not in left_out:
            is_option = parameter.param_type_name == "option"
            found += [parameter.opts[0], _value_of(parameter)] if is_option else [_value_of(parameter)]
    return found


def _value_of(parameter: Any) -> str:
    """Return a value that a parameter takes: a path to make, a recording, the first of its words, or a number."""
    if parameter.name == "out":
        return "out/made"
    if parameter.param_type_name != "option":
        return str(DEMO_RECORDING)
    annotation = parameter.type_descriptor.annotation
    return str(get_args(annotation)[0]) if get_origin(annotation) is Literal else "1"
