"""The operator's page of a rig: how its commands reach the nodes, what it can set, and the process that serves it."""

import contextlib
import importlib.util
import os
import re
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import IO, Any

from proto.errors import ConfigError, TelenanoError
from proto.messages import Scalar
from proto.nodes import VIEW
from services.console.command_client import send_control
from services.console.emergency_stop import Answer, LocalRig, emergency_stop
from services.launcher.restart_policy import RestartPolicy, RestartTracker, describe_exit
from services.numerics.frames import to_site_frame
from services.runtime.bus.ends import publish_end
from services.runtime.bus.local_endpoint import runtime_directory
from services.runtime.loop.clock import SystemClock
from services.runtime.loop.commands import Command, CommandName
from services.runtime.loop.main import load_site
from services.runtime.loop.participant import open_participant
from services.runtime.security.private_files import check_runtime_directory, write_private
from services.viz_node.access import Access
from services.viz_node.connections import DescriptorReserve
from services.viz_node.serve import address_of, bind, page_folder

OPERATOR_VARIABLE = "TELENANO_VIEW_OPERATOR_TOKEN"
OBSERVER_VARIABLE = "TELENANO_VIEW_OBSERVER_TOKEN"
# the number of a socket that is bound already
SOCKET_VARIABLE = "TELENANO_VIEW_SOCKET"
_PACKAGES = ("starlette", "uvicorn", "websockets")
_STOP_S = 3.0
# of what the process of the page wrote to its standard error [bytes]
_LAST_WORDS = 4096
_NAMES: dict[str, CommandName] = {"start": "start", "stop": "stop", "arm": "arm", "set": "set", "mark": "mark"}
# which nodes the commands of the page are for; `*` for those that have several
_EVERYBODY = "*"


class RigCommander:
    """Sends the commands of pages as `telenano session` does: at the console of the site, for one command at a time."""

    def __init__(self, site_file: Path) -> None:
        """Read the site file, and keep descriptors for an emergency stop: later there may be none left."""
        self._site_file = site_file
        self._rig = LocalRig.read(site_file)
        self._reserve = DescriptorReserve()

    def send(
        self,
        command: str,
        target: str,
        parameters: Mapping[str, Scalar],
        is_wanted: Callable[[], bool],
        issued_ns: int,
    ) -> dict[str, tuple[str, str]]:
        """Send a command and return by node `ack` or `refused` and a sentence; RigError when nobody answers."""
        if command not in _NAMES:
            raise ConfigError(f"{command}: is not a command of a session")
        wanted = Command(_NAMES[command], target, parameters=parameters)
        answers = send_control(wanted, self._site_file, "master", lambda event: None, is_wanted, issued_ns=issued_ns)
        return {src: (event.kind, event.text) for src, event in answers.items()}

    def estop(self) -> dict[str, tuple[str, str]]:
        """Stop the devices as `telenano estop` does: those of this machine at once, others at the console."""
        with self._reserve.lent():
            return self._estop()

    def close(self) -> None:
        """Give up the descriptors that are kept."""
        self._reserve.close()

    def _estop(self) -> dict[str, tuple[str, str]]:
        rig, reach = self._rig, self._rig.reach(_EVERYBODY, "")
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
    from services.afm_node.programs.settings import InstrumentRequest
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


def missing_packages(extra: str) -> str:
    """Return in words what this installation lacks to serve anything, and the extra that has it."""
    absent = [name for name in _PACKAGES if importlib.util.find_spec(name) is None]
    return f"{', '.join(absent)} is not installed: pip install 'telenano[{extra}]'" if absent else ""


def missing_for_view() -> str:
    """Return in words what this installation lacks to serve the page; empty when it lacks nothing."""
    if reason := missing_packages("view"):
        return reason
    if page_folder() is None:
        return "its page has not been built: `make page` in the repository builds it"
    return ""


def tokens_given() -> dict[str, str]:
    """Return the tokens that the environment names; a role without one gets a new one."""
    return {"operator": os.environ.get(OPERATOR_VARIABLE, ""), "observer": os.environ.get(OBSERVER_VARIABLE, "")}


@contextlib.contextmanager
def announced(addresses: Mapping[str, str], show: Callable[[str], None], what: str = "view") -> Iterator[None]:
    """Show the addresses of a server on a terminal; elsewhere write them to a private file while the block runs.

    An address ends with the token, and what goes to a pipe or a file is kept: logs of containers and of services.
    Parameters: addresses, by what they are called; show, prints a line; what, the server.
    """
    if sys.stdout.isatty():
        for name, address in addresses.items():
            show(f"{name}: {address}")
        yield
        return
    base = re.split("[#?]", next(iter(addresses.values())))[0]
    check_runtime_directory(make=True)
    file = runtime_directory() / f"{what}-{base.rstrip('/').rpartition(':')[2]}.addresses"
    write_private(file, "".join(f"{name}: {address}\n" for name, address in addresses.items()))
    show(f"{what}: {base}")
    show(f"its addresses with their tokens, for its owner alone to read: {file}")
    try:
        yield
    finally:
        file.unlink(missing_ok=True)


class ViewProcess:
    """The process that serves the page of a rig; it is started again when it ends by itself."""

    def __init__(self, arguments: Sequence[str], environment: Mapping[str, str], descriptor: int) -> None:
        self._arguments = arguments
        self._environment = environment
        self._descriptor = descriptor
        # never given up: the page is how the operator stops the rig
        self._tracker = RestartTracker(SystemClock(), [VIEW], RestartPolicy(crash_loop_exits=sys.maxsize))
        self._errors: IO[bytes] = tempfile.TemporaryFile()  # noqa: SIM115 - closed with the process
        self._process: subprocess.Popen[bytes] | None = None
        self._start()

    def look(self) -> str:
        """Start the process again where it is due; return in words that it has ended, empty as long as it has not."""
        if self._process is None:
            return self._start_again() if self._tracker.due() else ""
        code = self._process.poll()
        if code is None:
            return ""
        end = self._tracker.record_exit(VIEW, code)
        last = self._last_words()
        self._process = None
        return f"the view {describe_exit(code)} after {end.life_s:.1f} s{last}; {end.verdict}"

    def close(self) -> None:
        if self._process is not None:
            _stop(self._process)
        self._errors.close()

    def _start_again(self) -> str:
        try:
            self._start()
        except OSError as error:
            # the rig goes on without its page for now
            end = self._tracker.record_exit(VIEW, 1)
            return f"the view cannot be started: {error}; {end.verdict}"
        return ""

    def _start(self) -> None:
        self._errors.seek(0)
        self._errors.truncate()
        self._tracker.record_start(VIEW)
        self._process = subprocess.Popen(
            [sys.executable, "-m", "telenano", "view", *self._arguments],
            env={**os.environ, **self._environment, SOCKET_VARIABLE: str(self._descriptor)},
            pass_fds=[self._descriptor],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=self._errors,
            # Ctrl-C is for the rig, which stops this process when it has ended itself
            start_new_session=True,
        )

    def _last_words(self) -> str:
        self._errors.seek(max(0, self._errors.seek(0, os.SEEK_END) - _LAST_WORDS))
        lines = self._errors.read().decode(errors="replace").strip().splitlines()
        return f" ({lines[-1].strip()})" if lines else ""


@contextlib.contextmanager
def view_beside_rig(site_file: Path, show: Callable[[str], None]) -> Iterator[Callable[[], str]]:
    """Serve the page of a rig in a process of its own while the block runs, and show its address.

    Yields what has to be called now and then: it starts a page anew that has ended, and returns in words that it did.
    Whatever keeps the page from being served is shown, and the rig runs without it.
    """
    if reason := missing_for_view():
        show(f"no view: {reason}")
        yield str
        return
    with contextlib.ExitStack() as stack:
        look: Callable[[], str] = str
        try:
            access = Access.made(**tokens_given())
            bound = stack.enter_context(bind())
            stack.enter_context(announced({"view": address_of(bound, access, tls=False)}, show))
            tokens = {OPERATOR_VARIABLE: access.operator_token, OBSERVER_VARIABLE: access.observer_token}
            process = ViewProcess(["--site-file", str(site_file)], tokens, bound.fileno())
        except (TelenanoError, OSError) as error:
            show(f"no view: {error}")
        else:
            stack.callback(process.close)
            look = process.look
        yield look


def _stop(process: "subprocess.Popen[bytes]") -> None:
    process.terminate()
    try:
        process.wait(_STOP_S)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()
