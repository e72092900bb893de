"""How the commands of a page, and the force of its operator, reach the nodes of a running rig; what it can set."""

import contextlib
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from telenano.console.command_client import arm_devices, send_control
from telenano.console.coupling import couple_anew
from telenano.console.emergency_stop import Answer, LocalRig, emergency_stop
from telenano.numerics.frames import to_site_frame
from telenano.runtime.bus.address_book import load_site
from telenano.runtime.bus.publisher import publish_end
from telenano.runtime.loop.commands import Command, CommandName
from telenano.runtime.wiring.participant import open_participant
from telenano.wire.errors import ConfigError, TelenanoError
from telenano.wire.messages import Scalar
from telenano.wire.nodes import TIP, VIEW

_NAMES: dict[str, CommandName] = {"start": "start", "stop": "stop", "arm": "arm", "set": "set", "mark": "mark"}
# This one consists of several commands: hand and tip are coupled anew.
COUPLE = "couple"
# A command that is for several nodes is sent to this target.
_EVERYBODY = "*"


class RigCommander:
    """Sends the commands of pages as `telenano session` does: at the console of the site, for one command at a time."""

    def __init__(self, site_file: Path) -> None:
        """Read the site file, because an emergency stop needs none when it comes."""
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
        """Send a command and return by node `ack` or `refused` and a sentence; RigError when nobody answers."""
        if command == COUPLE:
            return {TIP: ("ack", couple_anew(self._site_file, is_wanted, issued_ns=issued_ns, by=by))}
        if command not in _NAMES:
            raise ConfigError(f"{command}: is not a command of a session")
        wanted = Command(_NAMES[command], target, parameters=parameters)
        if (wanted.name, target) == ("arm", _EVERYBODY):
            answers = arm_devices(self._site_file, "master", lambda event: None, is_wanted, issued_ns=issued_ns, by=by)
        else:
            answers = send_control(
                wanted, self._site_file, "master", lambda event: None, is_wanted, issued_ns=issued_ns, by=by
            )
        return {src: (event.kind, event.text) for src, event in answers.items()}

    def estop(self, by: str) -> dict[str, tuple[str, str]]:
        """Stop the devices as `telenano estop` does: those of this machine at once, others at the console."""
        rig, reach = self._rig, self._rig.reach(_EVERYBODY, "")
        answers: dict[str, tuple[str, str]] = {}

        def note(answer: Answer) -> None:
            answers.setdefault(answer.node, (answer.kind, answer.text))

        if reach.direct or reach.by_link:
            emergency_stop(rig, reach, _EVERYBODY, note, by)
        if reach.by_console or not answers:
            send_control(
                Command("estop", _EVERYBODY),
                self._site_file,
                "master",
                lambda event: note(Answer(event.src, event.kind, event.text)),
                by=by,
            )
        return answers


class RigHand:
    """The force of an operator at a page, on `operator/force`: what a scenario with an interactive operator follows."""

    def __init__(self, site_file: Path) -> None:
        """Bind the endpoint of the view; ConfigError or EndpointError when the site file has none, or it is taken."""
        self._open = contextlib.ExitStack()
        participant = self._open.enter_context(open_participant(VIEW, load_site(site_file)))
        self._clock = participant.clock
        try:
            self._publisher = participant.bind(VIEW)
        except TelenanoError:
            self._open.close()
            raise

    def push(self, force_n: float, across_n: tuple[float, float] = (0.0, 0.0), by: str = "") -> None:
        named = {"by": by} if by else {}
        self._publisher.publish("operator/force", force_n=(*across_n, to_site_frame(force_n)[2]), **named)

    def answer(self, **fields: Any) -> None:
        """Publish what a person answered to a cue of an experiment."""
        self._publisher.publish("experiment/answer", **fields)

    def now_ns(self) -> int:
        """Return the time on the clock of this endpoint [ns]."""
        return self._clock.now_ns()

    def close(self) -> None:
        """Publish the last message, and close the endpoint."""
        publish_end(self._publisher, VIEW)
        self._open.close()


def forms() -> dict[str, Any]:
    """Return the JSON schemas of what `set` changes, by node, and the profiles of the link."""
    # the models of the laws take a second to import, which only a page needs
    from telenano.afm.programs.settings import InstrumentRequest
    from telenano.laws.config import LAWS, ControllerConfig
    from telenano.link.config import LinkSettings
    from telenano.link.profiles import PROFILES

    return {
        "afm_node": InstrumentRequest.model_json_schema(),
        "controller": ControllerConfig.model_json_schema(),
        "delay_node": LinkSettings.model_json_schema(),
        "laws": list(LAWS),
        "profiles": sorted(PROFILES),
    }
