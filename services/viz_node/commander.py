"""Sends the commands of pages to the nodes of a running rig, and describes the settings that pages can change."""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from telenano.console.answers import kind_of
from telenano.console.coupling import recouple
from telenano.console.emergency_stop import LocalRig, emergency_stop
from telenano.console.going_back import send_way
from telenano.console.last_seen import with_last_seen
from telenano.console.send_commands import arm_steps, send_control
from telenano.runtime.loop.commands import Command, CommandName
from telenano.wire.errors import ConfigError, TelenanoError
from telenano.wire.messages import Scalar, SessionEvent
from telenano.wire.nodes import TIP

_NAMES: dict[str, CommandName] = {"start": "start", "stop": "stop", "arm": "arm", "set": "set", "mark": "mark"}
# Command of a page that consists of several commands to the nodes: couple hand and tip again.
COUPLE = "couple"
# Target of a command for all nodes.
_EVERYBODY = "*"


class RigCommander:
    """Sends the commands of pages like `telenano session`: one at a time, from the console of the site."""

    def __init__(self, site_file: Path) -> None:
        """Read the site file now, so that an emergency stop does not have to."""
        self._site_file = site_file
        self._rig = LocalRig.read(site_file)

    def send(
        self,
        command: str,
        target: str,
        parameters: Mapping[str, Scalar],
        is_wanted: Callable[[], bool],
        issued_ns: int,
        by: str,
    ) -> dict[str, tuple[str, str]]:
        """Send a command; return for each node `ack` or `refused` and a sentence.

        Raises:
            RigError: No node answers.
            ConfigError: There is no such command.
        """
        if command == COUPLE:
            return {TIP: ("ack", recouple(self._site_file, is_wanted, issued_ns=issued_ns, by=by))}
        if command not in _NAMES:
            raise ConfigError(f"{command}: is not a command of a session")
        wanted = Command(_NAMES[command], target, parameters=parameters)
        if (wanted.name, target) == ("arm", _EVERYBODY):
            steps = arm_steps(self._site_file, "master", parameters)
            answers = send_way(
                steps, self._site_file, "master", lambda event: None, is_wanted, issued_ns=issued_ns, by=by
            )
        else:
            answers = send_control(
                wanted, self._site_file, "master", lambda event: None, is_wanted, issued_ns=issued_ns, by=by
            )
        return {src: (kind_of(event.kind), event.text) for src, event in answers.items()}

    def estop(self, by: str) -> dict[str, tuple[str, str]]:
        """Stop the devices like `telenano estop`; return a kind and a sentence for each device, answered or not."""
        rig, reach = self._rig, self._rig.reach(_EVERYBODY, "")
        rows = with_last_seen(rig, emergency_stop(rig, reach, _EVERYBODY, lambda answer: None, by))
        answers = {node: (answer.kind, answer.sentence) for node, answer in rows.items()}
        for target in reach.by_console or (() if rows else (_EVERYBODY,)):
            events: list[SessionEvent] = []
            try:
                send_control(Command("estop", target), self._site_file, "master", events.append, by=by)
            except TelenanoError as error:
                if target == _EVERYBODY:
                    raise
                answers[target] = ("unreached", str(error))
            answers |= {event.src: (kind_of(event.kind), event.text) for event in events}
        return answers


def forms() -> dict[str, Any]:
    """Return the JSON schemas of the settings that `set` changes, by node, the laws, and the profiles of the link."""
    # Importing the models of the laws takes a second, and only a page needs them.
    from telenano.sections.controller_section import LAWS, ControllerConfig
    from telenano.sections.program_requests import InstrumentRequest
    from telenano.settings.link_settings import LinkSettings
    from telenano.settings.network_profiles import PROFILES

    return {
        "afm_node": InstrumentRequest.model_json_schema(),
        "controller": ControllerConfig.model_json_schema(),
        "delay_node": LinkSettings.model_json_schema(),
        "laws": list(LAWS),
        "profiles": sorted(PROFILES),
    }
