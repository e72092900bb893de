"""Request, plan and run of a session in virtual time, for `telenano simulate` and the function `telenano.simulate`."""

import shlex
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Annotated

import yaml
from pydantic import Field

from telenano.launcher.plan import Plan, SessionRequest, UpRequest, make_plan
from telenano.launcher.rig_node import RigNode
from telenano.launcher.run import Outcome
from telenano.recording.session_folder import SessionFolder
from telenano.runtime.loop.commands import Command, CommandName
from telenano.settings.included import TWO_SITES_FILE
from telenano.settings.option import Option
from telenano.settings.scenario import SEEDS
from telenano.virtual.session import FAR_FOLDER, SimulatedRig, TimedCommand, absence_of
from telenano.wire.errors import ConfigError, known_names

_NAMES: tuple[str, ...] = CommandName.__args__  # type: ignore[attr-defined]


class SimulateRequest(SessionRequest):
    """A session in virtual time, as `telenano simulate` is asked for it."""

    seed: int | None = Field(
        default=None,
        ge=0,
        le=2**31 - 1,
        description="Seed of the delays on each site, and of the link and all disturbances; without it, 0 for the "
        "delays and the scenario's for the others",
    )
    at: Annotated[tuple[str, ...], Option(("--at",), "'TIME COMMAND TARGET [KEY=VALUE …]'", tuple, many=True)] = Field(
        default=(),
        description="Give a console command at a time [s] after the force profile began, such as '2.5 set controller "
        "law=wave'; may be repeated",
    )
    both_sites: Annotated[bool, Option(("--both-sites",))] = Field(
        default=False,
        description="Record at each site the messages that it sends, as on two machines: session.mcap, "
        "far/session.mcap, and both in both.mcap",
    )

    def commands(self) -> tuple[TimedCommand, ...]:
        """Return the commands of `at`; ConfigError names the text that is not a command."""
        return tuple(map(timed_command, self.at))


def timed_command(text: str) -> TimedCommand:
    """Parse a console command with its time, `TIME COMMAND TARGET [KEY=VALUE …]`; ConfigError states the mistake."""
    try:
        time, name, target, *rest = shlex.split(text)
        time_s = float(time)
    except ValueError:
        example = "'2.5 set controller law=wave'"
        raise ConfigError(f"--at {text!r}: is not of the form 'TIME COMMAND TARGET [KEY=VALUE …]': {example}") from None
    if name not in _NAMES:
        raise ConfigError(f"--at {text!r}: no such command, {known_names(name, _NAMES)}")
    if not 0.0 <= time_s < 86_400.0:
        raise ConfigError(f"--at {text!r}: the time must be 0 to 86400 s after the force profile began")
    parameters = {}
    for word in rest:
        key, sign, value = word.partition("=")
        try:
            parameters[key] = yaml.safe_load(value)
        except yaml.YAMLError:
            sign = ""
        if not sign or not key or not isinstance(parameters.get(key), bool | int | float | str):
            raise ConfigError(f"--at {text!r}: {word!r} is not of the form KEY=VALUE, with a number, a word or a flag")
    return TimedCommand(time_s, Command(name, target, parameters=parameters))  # type: ignore[arg-type]


def plan_of(request: SimulateRequest, default_out: Path) -> Plan:
    """Read and check everything for a session in virtual time; ConfigError names the file and key at fault."""
    seeds = () if request.seed is None else tuple(f"{key}={request.seed}" for key in SEEDS)
    sites = ("recorder.far=fetch",) if request.both_sites else ()
    asked = {name: getattr(request, name) for name in SessionRequest.model_fields}
    asked["settings"] = (*seeds, *request.settings, *sites)
    up = UpRequest(**asked, site_file=TWO_SITES_FILE if request.both_sites else None)
    request.commands()
    return make_plan(up, default_out)


def run_plan(
    plan: Plan,
    request: SimulateRequest,
    observe: Callable[[RigNode], None] = lambda rig: None,
    show: Callable[[str], None] = lambda text: None,
) -> Outcome:
    """Run a planned session in virtual time.

    Args:
        plan: The planned session.
        request: The request of the plan.
        observe: Called with the launcher's node at each of its ticks.
        show: Called with each line for the user.

    Raises:
        ConfigError: The scenario has a real device.
        RigError: The session could not be run.
    """
    rig = SimulatedRig(plan, request.seed or 0, commands=request.commands(), far=request.both_sites)
    if text := absence_of(plan):
        show(f"warning: {text}")
    outcome = rig.run(observe)
    for text in rig.failed_commands:
        show(f"a command of --at failed: {text}")
    if request.both_sites and outcome.ran and outcome.recordings:
        folder = SessionFolder(plan.out)
        parts = sorted((plan.out / FAR_FOLDER).glob("*.mcap"))
        folder.note_far([path.name for path in parts])
        return replace(outcome, recordings=(folder.merge(parts),))
    return outcome
