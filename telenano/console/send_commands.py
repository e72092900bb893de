"""`telenano session`: a console that sends one command to a running rig and waits for the answers."""

import math
import os
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, ExitStack, contextmanager, nullcontext
from dataclasses import replace
from pathlib import Path

import zmq

from telenano.console.lease import FREE_COMMANDS, MOST_LETTERS
from telenano.console.lease_register import NAME_VARIABLE, Hold, acting
from telenano.runtime.bus.address_book import AddressBook
from telenano.runtime.bus.publisher import ZmqPublisher
from telenano.runtime.loop.arming import ARM
from telenano.runtime.loop.commands import Command, CommandClient
from telenano.runtime.wiring.observer import RIG_HINT, require_rig
from telenano.runtime.wiring.participant import Participant
from telenano.wire.errors import ConfigError, EndpointError, RigError
from telenano.wire.messages import Message, NodeHealth, Scalar, SessionEvent
from telenano.wire.nodes import LINK, PAGE, TIP, Site, is_console, is_estop, is_meant, is_pattern, name_of, site_of

_BIND_PATIENCE_NS = 2_000_000_000
_RETRY_S = 0.1
_POLL_MS = 20
# A node reports its health at this interval.
_HEALTH_S = 0.5
# The first report of a node may take this long more, for the connection.
_JOIN_S = 1.0
# A rig is late where a node reads a command later than this [s]: its loops come round a hundred times in it.
_LATE_S = 0.1
_SUBSCRIBED = b"\x01session/control"
# The most subscriptions that are read in a turn, so that endless ones keep no command from being sent.
_MOST_SUBSCRIPTIONS = 256


def parse_parameters(pairs: Sequence[str]) -> dict[str, Scalar]:
    """Read KEY=VALUE; true and false are flags, numbers are numbers, the rest is text."""
    parameters: dict[str, Scalar] = {}
    for pair in pairs:
        key, sign, text = pair.partition("=")
        if not key or not sign:
            raise ConfigError(f"{pair}: is not of the form KEY=VALUE")
        parameters[key] = _scalar(pair, text)
    return parameters


def _scalar(pair: str, text: str) -> Scalar:
    if text in ("true", "false"):
        return text == "true"
    for kind in (int, float):
        try:
            value = kind(text)
        except ValueError:
            continue
        if not -(2**63) <= value < 2**63 and not (isinstance(value, float) and math.isfinite(value)):
            raise ConfigError(f"{pair}: a finite number is needed, an integer within 64 bits")
        return value
    return text


def addressed(book: AddressBook, target: str, site: Site = "master") -> list[str]:
    """Return the nodes of the site file that a target means at a console; ConfigError names those that there are.

    Commands cross the link forward only: a console at the slave reaches the nodes there.
    """
    # the link's second socket belongs to the same process, which answers under the name of the first
    silent = (f"{LINK}@slave", PAGE)
    nodes = [n for n in book.nodes if not (is_console(n) or is_estop(n) or name_of(n) == "launcher" or n in silent)]
    within = [n for n in nodes if site == "master" or site_of(n) == site]
    meant = [n for n in within if is_meant(n, target)]
    if not meant:
        beyond = [n for n in nodes if is_meant(n, target)]
        hint = f"; {', '.join(beyond)} is commanded from the master's site" if beyond else ""
        raise ConfigError(f"no node is meant by target {target!r}: there are {', '.join(sorted(within))}{hint}")
    return meant


def arm_devices(
    site_file: Path,
    site: Site,
    on_answer: Callable[[SessionEvent], None],
    is_wanted: Callable[[], bool] = lambda: True,
    *,
    parameters: Mapping[str, Scalar] | None = None,
    issued_ns: int | None = None,
    by: str | None = None,
) -> dict[str, SessionEvent]:
    """Arm hand and tip, as far as this site reaches them; as `send_controls`.

    Both stay where they are. `parameters` are for the tip: where it may go, which is then waited for.
    """
    steps = arm_steps(site_file, site, parameters or {})
    return send_controls(steps, site_file, site, on_answer, is_wanted, issued_ns=issued_ns, by=by)


def arm_steps(site_file: Path, site: Site, parameters: Mapping[str, Scalar]) -> list[Command]:
    """Return the commands of `arm_devices`, the one of the tip with parameters."""
    book = AddressBook.load(site_file)
    steps = [step for step in ARM if site == "master" or set(step.expected) <= set(addressed(book, "*", site))]
    return [replace(step, parameters=parameters) if step.target == name_of(TIP) else step for step in steps]


def send_control(
    command: Command,
    site_file: Path,
    site: Site,
    on_answer: Callable[[SessionEvent], None],
    is_wanted: Callable[[], bool] = lambda: True,
    *,
    issued_ns: int | None = None,
    retry_ns: int = 0,
    by: str | None = None,
) -> dict[str, SessionEvent]:
    """Send one command as `send_controls` does; which nodes answer follows from its target and the site file.

    Raises:
        ConfigError: No node is meant, or this site has no console.
        RigError, EndpointError, RefusedError: As of `send_controls`.
    """
    meant = addressed(AddressBook.load(site_file), command.target, site)
    wanted = replace(command, expected=() if is_pattern(command.target) else tuple(meant))
    return send_controls([wanted], site_file, site, on_answer, is_wanted, issued_ns=issued_ns, retry_ns=retry_ns, by=by)


def send_controls(
    commands: Sequence[Command],
    site_file: Path,
    site: Site,
    on_answer: Callable[[SessionEvent], None],
    is_wanted: Callable[[], bool] = lambda: True,
    *,
    issued_ns: int | None = None,
    retry_ns: int = 0,
    by: str | None = None,
) -> dict[str, SessionEvent]:
    """Send commands to a running rig, each after the one before has succeeded.

    A command that has waited since it was given does not move a device that an emergency stop has stopped meanwhile.
    What moves something needs control, which this process has for the time of the command where it is free.

    Args:
        commands: The commands, with the nodes that have to answer, none for a pattern.
        site_file: The site file of the rig.
        site: The site at which the command is typed.
        on_answer: Called with each answer when it comes, and with the report that the tip is placed.
        is_wanted: Called before each sending; once it returns false, nothing more is sent.
        issued_ns: When a person gave the command, on the monotonic clock of this machine [ns]; None means now.
        retry_ns: How long the command is tried again after a refusal [ns].
        by: The name of who gave it, of a page whose lease of the hand was looked at; None for this process.

    Returns:
        The answers by node, refusals included.

    Raises:
        RigError: Nodes do not answer, no rig is there, the tip was not placed, the command is no longer wanted, or an
            emergency stop made it void; the message says which of several commands were carried out.
        EndpointError: Another console is at work.
        RefusedError: Somebody else holds control.
    """
    issued_ns = time.monotonic_ns() if issued_ns is None else issued_ns
    # Of a page whose lease was looked at, and for what may always be asked, control is not taken.
    is_free = by is not None or all(command.name in FREE_COMMANDS for command in commands)
    lease: AbstractContextManager[Hold | None] = nullcontext() if is_free else acting()
    name = os.environ.get(NAME_VARIABLE, "")[:MOST_LETTERS] if by is None else by
    wanted = [replace(command, by=name) for command in commands]
    with lease as hold:
        still = is_wanted if hold is None else (lambda: is_wanted() and hold.is_held())
        return _exchange(wanted, site_file, site, on_answer, still, issued_ns, retry_ns)


def _exchange(
    commands: Sequence[Command],
    site_file: Path,
    site: Site,
    on_answer: Callable[[SessionEvent], None],
    is_wanted: Callable[[], bool],
    issued_ns: int,
    retry_ns: int,
) -> dict[str, SessionEvent]:
    """Bind the console, send commands until all are answered, and return the answers; the rest as `send_controls`."""
    book = AddressBook.load(site_file)
    answers: dict[str, SessionEvent] = {}
    with _at_console(book, site_file, site) as participant:
        require_rig(book, site_file)
        publisher = _bind(participant)
        subscribers = participant.subscribers(book.sources(participant.key, ["session/event", "node/health"]))
        client = participant.command_client(commands, publisher.publish, retry_ns=retry_ns, issued_ns=issued_ns)
        attention, readers = Attention(time.monotonic()), 0
        while not (given_up := not is_wanted()) and not client.advance():
            if new := _new_subscriptions(publisher):
                readers += new
                client.make_due()
            attention.turn(time.monotonic())
            zmq.select([subscriber.socket for subscriber in subscribers], [], [], _POLL_MS * 1e-3)
            participant.network.process_events()
            for received in (message for subscriber in subscribers for message in subscriber.receive()):
                message = received.message
                attention.heard(message, time.monotonic())
                if isinstance(message, SessionEvent) and (client.on_event(message) or client.is_place(message)):
                    answers[message.src] = message
                    on_answer(message)
    names = ", ".join(dict.fromkeys(command.name for command in commands))
    if client.void:
        raise RigError(f"{client.failure}{_half_done(answers, client)}")
    if given_up:
        text = f"{names} was given up before all had answered: a node may have carried it out"
        raise RigError(f"{text}{_half_done(answers, client)}")
    in_force = _in_force(commands, client, readers)
    if not attention.last_s:
        raise RigError(f"{client.failure}; no node reports: {RIG_HINT}{in_force}")
    if not client.answers and not commands[-1].expected:
        meant = addressed(book, commands[-1].target, site)
        why = attention.why(meant, time.monotonic())
        raise RigError(f"{client.failure}: {why}{in_force if attention.is_doubtful(meant) else ''}")
    if client.failure and (len(commands) > 1 or not client.refusals or not client.has_all_answers):
        raise RigError(f"{client.failure}{in_force}{_half_done(answers, client)}")
    return answers


@contextmanager
def _at_console(book: AddressBook, site_file: Path, site: Site) -> Iterator[Participant]:
    with ExitStack() as opened:
        try:
            participant = opened.enter_context(Participant.at_console(book, site))
        except ConfigError as error:
            raise ConfigError(f"{site_file}: {error}") from error
        yield participant


def _in_force(commands: Sequence[Command], client: CommandClient, readers: int) -> str:
    """Return in words that a command without an answer may have been obeyed; empty where no node can have read it."""
    if not client.is_unanswered or not readers:
        return ""
    sent = commands[len(commands) - len(client.unsent) - 1].name
    text = f"; {sent} was sent and may be in force all the same: `telenano status` shows what the devices do"
    return f"{text}, and `telenano estop` stops them"


def _half_done(answers: Mapping[str, SessionEvent], client: CommandClient) -> str:
    """Return in words what several commands have done, and which of them were not sent; empty for one command."""
    if not client.unsent and len(answers) < 2:
        return ""
    told = {node: event for node, event in answers.items() if event.kind != "refused" and node not in client.ended}
    done = [f"{node} {event.kind}: {event.text}" for node, event in told.items()]
    unsent = [f"{command.name} was not sent to {command.target}" for command in client.unsent]
    return "".join(f"; {each}" for each in [*done, *unsent])


class Attention:
    """What a console heard of the nodes while it waited for answers: whether they were late, or do not know a command.

    `last_s` has by node when it was last heard [s].
    """

    def __init__(self, now_s: float) -> None:
        """Begin to listen at a time of the monotonic clock [s]."""
        self.last_s: dict[str, float] = {}
        self._begun_s = self._turn_s = now_s
        # How late each node was at most [s]; the console itself is one of them.
        self._late_s: dict[str, float] = {}

    def turn(self, now_s: float) -> None:
        """Note that the console continues to wait."""
        self._note_late("this command", now_s - self._turn_s - 1e-3 * _POLL_MS)
        self._turn_s = now_s

    def heard(self, message: Message, now_s: float) -> None:
        """Note a message of a node: with a report of its health comes how late it was itself."""
        if isinstance(message, NodeHealth):
            self._note_late(message.src, message.lateness_max_s)
        self._note_silence(message.src, now_s)
        self.last_s[message.src] = now_s

    def why(self, meant: Sequence[str], now_s: float) -> str:
        """Return in words why nobody answered: silence, a rig that is late, or that nobody knows the command."""
        for node in self.last_s:
            self._note_silence(node, now_s)
        silent = sorted(set(meant) - set(self.last_s))
        reasons = [f"nothing was heard of {', '.join(silent)}"] if silent else []
        node, late_s = max(self._late_s.items(), key=lambda row: row[1], default=("", 0.0))
        if late_s > _LATE_S:
            reasons.append(
                f"the rig is late by {late_s:.2g} s ({node}), so that the command may not have been read yet"
            )
        else:
            reasons.append(f"{', '.join(sorted(self.last_s))} do not know it")
        return "; ".join(reasons)

    def is_doubtful(self, meant: Sequence[str]) -> bool:
        """Return whether a node may have read the command without an answer that was heard."""
        return bool(set(meant) - set(self.last_s)) or max(self._late_s.values(), default=0.0) > _LATE_S

    def _note_silence(self, node: str, now_s: float) -> None:
        self._note_late(node, now_s - self.last_s.get(node, self._begun_s + _JOIN_S) - _HEALTH_S)

    def _note_late(self, node: str, late_s: float) -> None:
        self._late_s[node] = max(self._late_s.get(node, 0.0), late_s)


def _new_subscriptions(publisher: ZmqPublisher) -> int:
    """Count the readers of commands that have subscribed since the last call; nothing reaches them before that."""
    count = 0
    for _ in range(_MOST_SUBSCRIPTIONS):
        if not publisher.socket.poll(0):
            break
        count += publisher.socket.recv() == _SUBSCRIBED
    return count


def _bind(participant: Participant) -> ZmqPublisher:
    clock = participant.clock
    deadline = clock.monotonic_ns() + _BIND_PATIENCE_NS
    while True:
        try:
            # the next command comes from a process that counts again
            publisher = participant.bind(participant.key, zmq.XPUB, ends=True)
        except EndpointError:
            if clock.monotonic_ns() >= deadline:
                raise
            time.sleep(_RETRY_S)
        else:
            # every subscription counts, not only the first to a topic
            publisher.socket.set(zmq.XPUB_VERBOSE, 1)
            return publisher
