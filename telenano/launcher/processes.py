"""The processes of a rig: each is started in its own process session with a log file, and they are stopped in order."""

import contextlib
import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Collection, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple, Protocol

from telenano.runtime.bus.publisher import LINGER_S
from telenano.settings.config import ENVIRONMENT_PREFIX
from telenano.signals import children
from telenano.timing.clock import EPOCH_OFFSET_VARIABLE
from telenano.wire.nodes import module_of, name_of

# Time for a node to publish its last message [s]; it is safe within milliseconds and then publishes its counts.
GRACE_S = 8.0
# Time to deliver the last messages to readers that are behind, above all the recorder [s].
LINGER_GRACE_S = LINGER_S + 2.0
# Time to exit once everything is delivered [s]; it takes milliseconds, except on a busy machine.
EXIT_GRACE_S = 3.0
# Time for a recorder to exit [s]; on an overloaded machine it still has to write the messages in its queue.
RECORDER_GRACE_S = 30.0
# Polling interval while waiting for a process [s].
_WAIT_S = 0.02
_TAIL_BYTES = 16_384
_TAIL_LINES = 6
# The steps are compiled for one core, so a thread pool in a process of the loop would only compete with the loop.
_THREAD_VARIABLES = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")


class StopObserver:
    """Receives progress while processes are stopped; this base class knows nothing about them and does nothing."""

    def has_ended(self, node: str) -> bool:
        """Return whether a node has published its last message, which may still have to be delivered."""
        return False

    def has_delivered(self, node: str, gone: Collection[str]) -> bool:
        """Return whether every reader has all messages of a node; `gone` are the nodes whose processes have ended."""
        return False

    def wait(self, nodes: Sequence[str], waited_s: float, limit_s: float) -> None:
        """Process messages while nodes are waited for, since `waited_s` of at most `limit_s` [s]; called each 20 ms."""


class Inheritance(NamedTuple):
    """Environment variables and open descriptors that one process inherits."""

    environment: Mapping[str, str] = {}
    descriptors: tuple[int, ...] = ()


class _Log(NamedTuple):
    """The open log of a node, readable even if its file was deleted; `fault`: the reason why there is none."""

    descriptor: int
    fault: str = ""


class Children(Protocol):
    """The child processes as a supervisor controls them."""

    def start(self, node: str) -> int:
        """Start a node and return its process id."""

    def reap(self) -> dict[str, int]:
        """Return the exit codes of the nodes that ended since the last call; a negative code is a signal."""

    def kill(self, node: str) -> None:
        """Kill a node's process; the next `reap` returns it."""

    def log_tail(self, node: str) -> str:
        """Return the last lines of a node's log, as readable text."""

    def log_path(self, node: str) -> Path:
        """Return the path of a node's log file."""

    def stop(self, observer: StopObserver) -> None:
        """Stop every process and wait until it has ended."""


_NO_OBSERVER = StopObserver()


class NodeProcesses:
    """The nodes of a rig as processes of this machine."""

    def __init__(
        self,
        commands: Mapping[str, Sequence[str]],
        stop_order: Sequence[str],
        log_directory: Path,
        epoch_offset_ns: int,
        on_stopping: Callable[[str], None] = lambda node: None,
        inherited: Mapping[str, Inheritance] | None = None,
        held: Sequence[int] = (),
        before_start: Callable[[], None] = lambda: None,
        joined: Mapping[str, str] | None = None,
    ) -> None:
        """Prepare empty logs for the nodes in `commands`, the command line of each by its key.

        Args:
            commands: The command line of each node, by its key.
            stop_order: The keys in the order in which the nodes are stopped.
            log_directory: The folder of their logs.
            epoch_offset_ns: Offset of the monotonic clock to the epoch for all stamps of the rig [ns].
            on_stopping: Called with the key, or keys in words, of a process before it is stopped.
            inherited: Additional variables and descriptors of some nodes, by key.
            held: The descriptors that every process inherits.
            before_start: Called before each start.
            joined: The name of the process of each node that shares one; such nodes have one command line and one log.
        """
        self._commands = commands
        self._joined = joined or {}
        self._stop_order = stop_order
        self._log_directory = log_directory
        self._environment = child_environment(os.environ, epoch_offset_ns)
        self._on_stopping = on_stopping
        self._inherited = inherited or {}
        self._held = tuple(held)
        self._before_start = before_start
        self._logs: dict[str, _Log] = {}
        self._running: dict[str, subprocess.Popen[bytes]] = {}
        log_directory.mkdir(parents=True, exist_ok=True)
        for path in {self.log_path(node) for node in commands}:
            path.write_bytes(b"")

    def log_path(self, node: str) -> Path:
        return self._log_directory / f"{self._process_of(node)}.log"

    def start(self, node: str) -> int:
        for other in self._mates_of(node):
            process = self._running.get(other)
            if process is not None and process.poll() is None:
                # Another node of the same process has already started it.
                self._running[node] = process
                return process.pid
        inherited = self._inherited.get(node, Inheritance())
        self._before_start()
        log = self._opened_log(node)
        process = children.start(
            self._commands[node],
            stdin=subprocess.DEVNULL,
            stdout=log.descriptor,
            stderr=log.descriptor,
            env={**self._environment, **inherited.environment},
            pass_fds=(*inherited.descriptors, *self._held),
            # Ctrl-C on the terminal must reach the supervisor alone, which then stops the nodes in order.
            start_new_session=True,
            dies_with_parent=True,
        )
        self._running[node] = process
        return process.pid

    def reap(self) -> dict[str, int]:
        # Poll each process once, so that all nodes of one process end in the same call.
        codes = {process: process.poll() for process in set(self._running.values())}
        ended = {node: code for node, process in self._running.items() if (code := codes[process]) is not None}
        for node in ended:
            del self._running[node]
        return ended

    def kill(self, node: str) -> None:
        if node in self._running:
            self._running[node].kill()

    def log_tail(self, node: str) -> str:
        if (log := self._logs.get(self._process_of(node))) is None:
            return ""
        if log.fault:
            return log.fault
        try:
            size = os.fstat(log.descriptor).st_size
            tail = os.pread(log.descriptor, _TAIL_BYTES, max(0, size - _TAIL_BYTES))
        except OSError as error:
            return f"its log {self.log_path(node)} cannot be read: {error.strerror}"
        lines = tail.decode(errors="replace").splitlines()
        return "\n".join(_readable(line) for line in lines[-_TAIL_LINES:])

    def stop(self, observer: StopObserver = _NO_OBSERVER) -> None:
        """Stop every process, in order: SIGTERM, eight seconds to publish the last message, then SIGKILL.

        A process delivers its last messages while the next ones are stopped; it is killed if it has not ended three
        seconds after its readers have them. Recorders are stopped after all others, and have thirty seconds.
        """
        nodes = [node for node in dict.fromkeys([*self._stop_order, *self._running]) if node in self._running]
        senders = [node for node in nodes if name_of(node) != "recorder"]
        asked: set[str] = set()
        for node in senders:
            # A process of several nodes is stopped once, with the first of them.
            if self._process_of(node) not in asked:
                asked.add(self._process_of(node))
                self._terminate(node)
            self._wait((node,), GRACE_S, observer, until_ended=True)
        self._wait(senders, LINGER_GRACE_S, observer)
        for node in nodes:
            if node not in senders:
                self._terminate(node)
                self._wait((node,), RECORDER_GRACE_S, observer)

    def _process_of(self, node: str) -> str:
        return self._joined.get(node, node)

    def _mates_of(self, node: str) -> list[str]:
        """Return the other nodes that run in the process of a node."""
        name = self._process_of(node)
        return [other for other, process in self._joined.items() if process == name and other != node]

    def _opened_log(self, node: str) -> "_Log":
        """Open the log of a node for its next start, and create its folder if it was removed.

        If the log cannot be written, the node runs without one.
        """
        name = self._process_of(node)
        path, before = self.log_path(node), self._logs.pop(name, None)
        if before is not None:
            os.close(before.descriptor)
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            log = _Log(os.open(path, os.O_RDWR | os.O_APPEND | os.O_CREAT, 0o666))
        except OSError as error:
            log = _Log(os.open(os.devnull, os.O_RDWR), f"its log {path} cannot be written: {error.strerror}")
        self._logs[name] = log
        return log

    def _terminate(self, node: str) -> None:
        self._on_stopping(" and ".join([node, *(other for other in self._mates_of(node) if other in self._running)]))
        if node in self._running:
            self._running[node].send_signal(signal.SIGTERM)

    def _wait(self, nodes: Sequence[str], grace_s: float, observer: StopObserver, *, until_ended: bool = False) -> None:
        """Wait until processes have ended, and kill them after the grace [s].

        With `until_ended`, return as soon as each has published its last message.
        """
        begin_s = time.monotonic()
        delivered_s: dict[str, float] = {}
        while waiting := [node for node in nodes if self._is_running(node)]:
            if until_ended and all(map(observer.has_ended, waiting)):
                return
            waited_s = time.monotonic() - begin_s
            gone = self._commands.keys() - self._running.keys()
            for node in waiting:
                if observer.has_delivered(node, gone):
                    delivered_s.setdefault(node, waited_s)
                else:
                    delivered_s.pop(node, None)
                if waited_s >= min(grace_s, delivered_s.get(node, grace_s) + EXIT_GRACE_S):
                    self._running[node].kill()
                    self._running.pop(node).wait()
            if not (waiting := [node for node in waiting if node in self._running]):
                return
            with contextlib.suppress(subprocess.TimeoutExpired):
                self._running[waiting[0]].wait(_WAIT_S)
            observer.wait(waiting, waited_s, grace_s)

    def _is_running(self, node: str) -> bool:
        process = self._running.get(node)
        if process is not None and process.poll() is not None:
            del self._running[node]
            return False
        return process is not None


def child_environment(environment: Mapping[str, str], epoch_offset_ns: int) -> dict[str, str]:
    """Return the environment of the nodes: without settings, which are in the effective scenario, and with the epoch.

    `epoch_offset_ns`: offset of the monotonic clock to the epoch for all stamps [ns]. Math libraries get one thread.
    """
    kept = {name: value for name, value in environment.items() if not name.startswith(ENVIRONMENT_PREFIX)}
    threads = {name: kept.get(name, "1") for name in _THREAD_VARIABLES}
    return {**kept, **threads, EPOCH_OFFSET_VARIABLE: str(epoch_offset_ns)}


def node_command(node: str, site_file: Path, scenario_file: Path, held: int | None = None) -> list[str]:
    """Return the command line that runs a node as a child of this process.

    Args:
        node: The node as node@site.
        site_file: The site file.
        scenario_file: The scenario.
        held: The descriptor of the table by which the node finds the files that this process holds; None without it.

    Raises:
        ValueError: The table of nodes has no such process.
    """
    name, _, site = node.partition("@")
    given = [] if held is None else ["--held", str(held)]
    files = ["--site-file", str(site_file), "--scenario", str(scenario_file)]
    return [sys.executable, "-m", module_of(name), *files, "--site", site, "--with-parent", *given]


def joint_command(process: str, nodes: Sequence[str], site_file: Path, scenario_file: Path, held: int) -> list[str]:
    """Return the command line that runs several nodes in one process, such as site@master."""
    names = [word for node in nodes for word in ("--node", node)]
    return [*node_command(process, site_file, scenario_file, held), *names]


def _readable(line: str) -> str:
    """Return a line of the structured log as text; any other output of the process is returned unchanged."""
    try:
        entry = json.loads(line)
        return f"{entry['level']}: {entry['text']}" + (f"\n{entry['exception']}" if "exception" in entry else "")
    except (ValueError, KeyError, TypeError):
        return line
