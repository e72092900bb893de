"""The operator's page of a rig: how its commands reach the nodes, what it can set, and the process that serves it."""

import contextlib
import importlib.util
import os
import subprocess
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from proto.errors import ConfigError, TelenanoError
from proto.messages import Scalar
from proto.nodes import VIEW
from services.console.command_client import send_control
from services.console.emergency_stop import Answer, LocalRig, emergency_stop
from services.runtime.commands import Command, CommandName
from services.runtime.ends import publish_end
from services.runtime.frames import to_site_frame
from services.runtime.main import load_site
from services.runtime.participant import open_participant
from services.viz_node.access import Access
from services.viz_node.serve import address_of, bind, page_folder

OPERATOR_VARIABLE = "TELENANO_VIEW_OPERATOR_TOKEN"
OBSERVER_VARIABLE = "TELENANO_VIEW_OBSERVER_TOKEN"
# the number of a socket that is bound already
SOCKET_VARIABLE = "TELENANO_VIEW_SOCKET"
_PACKAGES = ("starlette", "uvicorn", "websockets")
_STOP_S = 3.0
_NAMES: dict[str, CommandName] = {"start": "start", "stop": "stop", "arm": "arm", "set": "set", "mark": "mark"}
# which nodes the commands of the page are for; `*` for those that have several
_EVERYBODY = "*"


class RigCommander:
    """Sends the commands of pages as `telenano session` does: at the console of the site, for one command at a time."""

    def __init__(self, site_file: Path) -> None:
        self._site_file = site_file

    def send(self, command: str, target: str, parameters: Mapping[str, Scalar]) -> dict[str, tuple[str, str]]:
        """Send a command and return by node `ack` or `refused` and a sentence; RigError when nobody answers."""
        if command not in _NAMES:
            raise ConfigError(f"{command}: is not a command of a session")
        wanted = Command(_NAMES[command], target, parameters=parameters)
        answers = send_control(wanted, self._site_file, "master", lambda event: None)
        return {src: (event.kind, event.text) for src, event in answers.items()}

    def estop(self) -> dict[str, tuple[str, str]]:
        """Stop the devices as `telenano estop` does: those of this machine at once, others at the console."""
        rig = LocalRig.read(self._site_file)
        reach = rig.reach(_EVERYBODY, "")
        answers: dict[str, tuple[str, str]] = {}

        def note(answer: Answer) -> None:
            answers.setdefault(answer.node, (answer.kind, answer.text))

        if reach.direct or reach.by_link:
            emergency_stop(rig, reach, _EVERYBODY, note)
        if reach.by_console or not answers:
            send_control(
                Command("estop", _EVERYBODY),
                self._site_file,
                "master",
                lambda event: note(Answer(event.src, event.kind, event.text)),
            )
        return answers


class RigHand:
    """The force of an operator at a page, on `operator/force`: what a scenario with an interactive operator follows."""

    def __init__(self, site_file: Path) -> None:
        """Bind the endpoint of the view; ConfigError or EndpointError when the site file has none, or it is taken."""
        self._open = contextlib.ExitStack()
        participant = self._open.enter_context(open_participant(VIEW, load_site(site_file)))
        try:
            self._publisher = participant.bind(VIEW)
        except TelenanoError:
            self._open.close()
            raise

    def push(self, force_n: float) -> None:
        self._publisher.publish("operator/force", force_n=to_site_frame(force_n))

    def close(self) -> None:
        """Publish the last message, and close the endpoint."""
        publish_end(self._publisher, VIEW)
        self._open.close()


def forms() -> dict[str, Any]:
    """Return the JSON schemas of what `set` changes, by node, and the profiles of the link."""
    # the models of the laws take a second to import, which only a page needs
    from services.afm_node.program_config import InstrumentRequest
    from services.controller.config import LAWS, ControllerConfig
    from services.delay_node.config import LinkSettings
    from services.delay_node.profiles import PROFILES

    return {
        "afm_node": InstrumentRequest.model_json_schema(),
        "controller": ControllerConfig.model_json_schema(),
        "delay_node": LinkSettings.model_json_schema(),
        "laws": list(LAWS),
        "profiles": sorted(PROFILES),
    }


def missing_for_view() -> str:
    """Return in words what this installation lacks to serve the page; empty when it lacks nothing."""
    absent = [name for name in _PACKAGES if importlib.util.find_spec(name) is None]
    if absent:
        return f"{', '.join(absent)} is not installed: pip install 'telenano[view]'"
    if page_folder() is None:
        return "its page has not been built: `make page` in the repository builds it"
    return ""


def tokens_given() -> dict[str, str]:
    """Return the tokens that the environment names; a role without one gets a new one."""
    return {"operator": os.environ.get(OPERATOR_VARIABLE, ""), "observer": os.environ.get(OBSERVER_VARIABLE, "")}


@contextlib.contextmanager
def view_beside_rig(site_file: Path, show: Callable[[str], None]) -> Iterator[None]:
    """Serve the page of a rig in a process of its own while the block runs, and show its address.

    Whatever keeps it from being served is shown, and the rig runs without it.
    """
    if reason := missing_for_view():
        show(f"no view: {reason}")
        yield
        return
    with contextlib.ExitStack() as stack:
        try:
            access = Access.made(**tokens_given())
            bound = stack.enter_context(bind())
            show(f"view: {address_of(bound, access, tls=False)}")
            process = _start(bound.fileno(), access, ["--site-file", str(site_file)])
        except (TelenanoError, OSError) as error:
            show(f"no view: {error}")
        else:
            stack.callback(_stop, process)
        yield


def _start(descriptor: int, access: Access, arguments: Sequence[str]) -> "subprocess.Popen[bytes]":
    tokens = {OPERATOR_VARIABLE: access.operator_token, OBSERVER_VARIABLE: access.observer_token}
    return subprocess.Popen(
        [sys.executable, "-m", "telenano", "view", *arguments],
        env={**os.environ, **tokens, SOCKET_VARIABLE: str(descriptor)},
        pass_fds=[descriptor],
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        # Ctrl-C is for the rig, which stops this process when it has ended itself
        start_new_session=True,
    )


def _stop(process: "subprocess.Popen[bytes]") -> None:
    process.terminate()
    try:
        process.wait(_STOP_S)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()
