"""`telenano session`: send a command to the nodes of a running rig."""

import contextlib
import re
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Annotated, Literal

import typer

from telenano.cli.estop_command import EstopRequest, run_estop
from telenano.cli.exit_codes import EXIT_FAILED
from telenano.cli.keyboard import RawKeyboard
from telenano.cli.option_rules import Void, rules
from telenano.cli.options import JsonOption, RigFileOption, SiteOption, TargetOption
from telenano.cli.output import print_answer, print_json, report_errors
from telenano.console.answers import kind_of
from telenano.console.coupling import recouple
from telenano.console.going_back import WayBack, go_back
from telenano.console.lease import CONSOLE
from telenano.console.lease_register import holding
from telenano.console.send_commands import arm_devices, parse_parameters, send_control
from telenano.runtime.loop.commands import Command, CommandName
from telenano.settings.included import DEFAULT_SITE_FILE, TWO_SITES_FILE
from telenano.timing.clock import process_start_ns
from telenano.wire.errors import ConfigError
from telenano.wire.lengths import in_nm
from telenano.wire.messages import SessionEvent
from telenano.wire.nodes import Site

SessionCommand = Literal["arm", "start", "stop", "estop", "set", "mark", "couple"]


@rules(
    Void("--return", "which alone has a way back", unless="COMMAND arm, COMMAND estop"),
    Void("--target", "which is for both devices", beside="--return", unless="COMMAND estop"),
    Void("KEY=VALUE, --target, --site slave", "which is for both, at the master's site", beside="COMMAND couple"),
)
def session(
    command: Annotated[SessionCommand, typer.Argument(metavar="COMMAND", help="Command to send.")],
    parameters: Annotated[
        list[str] | None, typer.Argument(metavar="KEY=VALUE", help="Parameters by dotted key, units in the names.")
    ] = None,
    target: TargetOption = "*",
    site: SiteOption = None,
    site_file: RigFileOption = None,
    back: Annotated[
        bool,
        typer.Option(
            "--return",
            help="With arm: let the tip go back to a place; place, speed and time are printed, and any key stops it.",
        ),
    ] = False,
    take: Annotated[bool, typer.Option("--take", help="Take control from a page for this command.")] = False,
    as_json: JsonOption = False,
) -> None:
    """Send a command to a running rig and wait for the answers; exit code 1 unless all who are asked acknowledge it.

    Who is asked follows from site file and target; a pattern such as * asks those that obey the command without their
    name. From the instrument's site the nodes of the other one are out of reach.

    `arm` starts nothing: tip and hand stay where they are. With --return the tip goes back to its place, or to place_m
    at speed_m_per_s.

    `set` without --target is for the nodes that have the key; those that do not know it do not count.

    While a person at a page holds control, only stop, estop and mark are accepted. TELENANO_NAME names the sender.
    """
    if command == "estop":
        raise typer.Exit(run_estop(EstopRequest(target, site or "", site_file, as_json, answer=print_json)))
    with report_errors(as_json), holding(CONSOLE, from_anyone=True) if take else contextlib.nullcontext():
        if command == "couple":
            text = recouple(site_file or _usual_file(site), issued_ns=process_start_ns())
            print_answer({"command": "couple", "text": text}, text, as_json=as_json)
        elif back:
            _return(parameters or (), site_file or _usual_file(site), site or "master", as_json=as_json)
        else:
            send_command(command, parameters or (), target, site_file, site, as_json=as_json)


def _return(parameters: Sequence[str], site_file: Path, site: Site, *, as_json: bool) -> None:
    """Let the tip go back, after its place, speed and time are printed; a key ends the motion."""
    given = parse_parameters(parameters)
    if unknown := sorted(set(given) - {"place_m", "speed_m_per_s"}):
        raise ConfigError(f"arm --return takes place_m and speed_m_per_s, and not {', '.join(unknown)}")
    numbers = {key: _number(key, value) for key, value in given.items()}
    issued_ns = process_start_ns()

    def announce(way: WayBack) -> None:
        if not as_json:
            typer.echo(str(way))

    with RawKeyboard() as keys:
        way = go_back(
            site_file,
            site,
            announce,
            lambda: not keys.pressed(),
            place_m=numbers.get("place_m"),
            speed_m_per_s=numbers.get("speed_m_per_s"),
            issued_ns=issued_ns,
        )
    text = "the tip is where the hand has it: there is no way back"
    if way is not None:
        text = f"the tip is back: its base is at {in_nm(way.place_m)}"
    print_answer({"command": "arm", "text": text, **({} if way is None else way._asdict())}, text, as_json=as_json)


def _number(key: str, value: object) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise ConfigError(f"{key}={value}: a number is needed")
    return float(value)


def send_command(
    command: CommandName,
    parameters: Sequence[str],
    target: str,
    site_file: Path | None,
    site: Site | None = None,
    *,
    as_json: bool,
) -> None:
    """Send a command, print the answers, and exit with 1 if a node refuses or does not answer."""
    with report_errors(as_json):
        wanted = Command(command, target, parameters=parse_parameters(parameters))
        show = (lambda event: None) if as_json else lambda event: typer.echo(f"{event.src} {event.kind}: {event.text}")
        book_file = site_file or _usual_file(site)
        at, issued_ns = site or "master", process_start_ns()
        if (command, target) == ("arm", "*"):
            answers = arm_devices(book_file, at, show, parameters=wanted.parameters, issued_ns=issued_ns)
        else:
            answers = send_control(wanted, book_file, at, show, issued_ns=issued_ns)
    if as_json:
        rows = {src: {"kind": kind_of(event.kind), "text": event.text} for src, event in sorted(answers.items())}
        print_json({"command": command, "target": target, "answers": rows})
    elif command == "arm" and (hint := _way_back(answers.values())):
        typer.echo(hint)
    refused = [event.text for event in answers.values() if event.kind == "refused"]
    if (command, target) == ("set", "*") and len(refused) < len(answers):
        # Without a target every node is asked, and refusals by nodes that do not have the key do not count.
        refused = [text for text in refused if not all(_OF_ANOTHER.search(line) for line in text.splitlines())]
    if refused:
        raise typer.Exit(EXIT_FAILED)


def _way_back(answers: Iterable[SessionEvent]) -> str:
    """Return a sentence on how the tip can go back, if the instrument states a place; else empty."""
    for event in answers:
        keys = ("return_place_m", "return_speed_m_per_s", "return_s")
        place, speed, time_s = (event.data.get(key) for key in keys)
        if isinstance(place, float) and isinstance(speed, float) and isinstance(time_s, float):
            numbers = f"{in_nm(place)} at {1e9 * speed:.4g} nm/s, for {time_s:.2g} s"
            return f"the tip stays where it is; `telenano session arm --return` takes it back to {numbers}"
    return ""


# The texts by which a node refuses a key that it does not have.
_OF_ANOTHER = re.compile("unknown key|cannot be set: settable are")


def _usual_file(site: Site | None) -> Path:
    return DEFAULT_SITE_FILE if site is None else TWO_SITES_FILE
