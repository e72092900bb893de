"""`telenano session`: a console that sends one command to a running rig and waits for the answers."""

import math
import os
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, ExitStack, contextmanager, nullcontext
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import zmq

from telenano.console.answers import Answer, UnansweredError, kind_of, unacknowledged
from telenano.console.emergency_stop import LocalRig
from telenano.console.lease import FREE_COMMANDS, MOST_LETTERS
from telenano.console.lease_register import NAME_VARIABLE, Hold, acting
from telenano.runtime.bus.address_book import AddressBook
from telenano.runtime.bus.publisher import ZmqPublisher
from telenano.runtime.loop.arming import ARM
from telenano.runtime.loop.commands import Command, CommandClient, CommandName
from telenano.runtime.wiring.observer import RIG_HINT, require_rig
from telenano.runtime.wiring.participant import Participant
from telenano.wire.errors import ConfigError, EndpointError, RigError
from telenano.wire.messages import Message, NodeHealth, Scalar, SessionEvent
from telenano.wire.nodes import LINK, PAGE, TIP, Site, is_console, is_estop, is_meant, is_pattern, name_of, site_of

_BIND_PATIENCE_NS = 2_000_000_000
_RETRY_S = 0.1
_POLL_MS = 20
# Interval of a node's health reports [s].
_HEALTH_S = 0.5
# Additional time for the first report of a node, for the connection [s].
_JOIN_S = 1.0
# A rig is late if a node reads a command later than this [s], a hundred periods of its loops.
_LATE_S = 0.1
_SUBSCRIBED = b"\x01session/control"
# Most subscriptions read at a time, so that a flood of them does not block the sending of a command.
_MOST_SUBSCRIPTIONS = 256


def parse_parameters(pairs: Sequence[str]) -> dict[str, Scalar]:
    """Parse texts KEY=VALUE: true and false become bool, numbers int or float, others stay text; raise ConfigError."""
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


# The nodes that obey a command if a pattern means them, by name; each of them that the site file has must answer.
OBEYED_BY: Mapping[CommandName, tuple[str, ...]] = {
    "start": ("haptic_node",),
    "stop": ("haptic_node",),
    "arm": ("haptic_node", "afm_node"),
    "estop": ("haptic_node", "afm_node"),
    "set": ("controller", "delay_node"),
    "mark": ("recorder",),
}


def addressed(book: AddressBook, target: str, site: Site = "master") -> list[str]:
    """Return the nodes of the site file that a target includes; raise ConfigError, with a list of nodes, if none.

    Commands cross the link only forward, so a console at the slave's site reaches only the nodes there.
    """
    nodes = _commanded(book)
    within = [n for n in nodes if site == "master" or site_of(n) == site]
    meant = [n for n in within if is_meant(n, target)]
    if not meant:
        beyond = [n for n in nodes if is_meant(n, target)]
        hint = f"; {', '.join(beyond)} is commanded from the master's site" if beyond else ""
        raise ConfigError(f"no node is meant by target {target!r}: there are {', '.join(sorted(within))}{hint}")
    return meant


def _commanded(book: AddressBook) -> list[str]:
    """Return the nodes of the site file that take commands."""
    # The link's second endpoint belongs to the same process, which answers under the name of the first.
    silent = (f"{LINK}@slave", PAGE)
    return [n for n in book.nodes if not (is_console(n) or is_estop(n) or name_of(n) == "launcher" or n in silent)]


class Asked(NamedTuple):
    """The nodes that a command asks: those that a console at its site reaches, and those beyond."""

    near: tuple[str, ...]
    far: tuple[str, ...] = ()


def asked(book: AddressBook, command: Command, site: Site = "master") -> Asked:
    """Return the nodes that have to answer a command, which follow from the site file and the target alone.

    Raises:
        ConfigError: The target means no node that this site reaches, or none of those obeys the command by a pattern.
    """
    meant = addressed(book, command.target, site)
    beyond = [n for n in _commanded(book) if is_meant(n, command.target) and n not in meant]
    if not is_pattern(command.target):
        return Asked(tuple(meant), tuple(beyond))
    names = OBEYED_BY[command.name]
    near, far = (tuple(n for n in nodes if name_of(n) in names) for nodes in (meant, beyond))
    if not near:
        raise ConfigError(
            f"no node that {command.target!r} means obeys {command.name} without its name: {', '.join(names)} does, and"
            f" there are {', '.join(sorted(meant))}"
        )
    return Asked(near, far)


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
    """Arm hand and tip, as far as this site reaches them; other arguments, result and errors as in `send_controls`.

    Both stay where they are, unless `parameters` for the tip name a place; the function then waits for its arrival.
    """
    steps = arm_steps(site_file, site, parameters or {})
    reached = {node for step in steps for node in step.expected}
    far = tuple(node for step in ARM for node in step.expected if node not in reached)
    return send_controls(steps, site_file, site, on_answer, is_wanted, issued_ns=issued_ns, by=by, far=far)


def arm_steps(site_file: Path, site: Site, parameters: Mapping[str, Scalar]) -> list[Command]:
    """Return the commands of `arm_devices`; that of the tip has the parameters."""
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
    """Send one command as `send_controls` does; its target and the site file determine the nodes that must answer.

    Raises:
        ConfigError: The target includes no node, or this site has no console.
        RigError, EndpointError, RefusedError: As in `send_controls`.
    """
    near, far = asked(AddressBook.load(site_file), command, site)
    return send_controls(
        [replace(command, expected=near)],
        site_file,
        site,
        on_answer,
        is_wanted,
        issued_ns=issued_ns,
        retry_ns=retry_ns,
        by=by,
        far=far,
    )


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
    far: Sequence[str] = (),
) -> dict[str, SessionEvent]:
    """Send commands to a running rig, each after the previous one has succeeded.

    A command that was given before an emergency stop does not move a device that was stopped meanwhile. Commands that
    move something need control; if it is free, this process holds it while they run.

    Args:
        commands: The commands, each with the nodes that must answer.
        site_file: The site file of the rig.
        site: The site at which the command is given.
        on_answer: Called with each answer, and with the report that the tip is placed.
        is_wanted: Called before each sending; once it returns False, nothing more is sent.
        issued_ns: Time at which a person gave the command, by the monotonic clock of this machine [ns]; None for now.
        retry_ns: Time for which a refused command is repeated [ns].
        by: Name of the person, for a page whose lease was checked already; None makes this process acquire control.
        far: Further nodes that are asked, and which this site does not reach.

    Returns:
        The answers by node, refusals included; all who were asked have answered.

    Raises:
        UnansweredError: Not all who were asked have answered, or the tip was not placed; it has a row for each of them,
            and the message says which of several commands were carried out.
        RigError: There is no rig, the command is no longer wanted, or an emergency stop made it void.
        EndpointError: Another console is in use.
        RefusedError: Another party holds control.
    """
    issued_ns = time.monotonic_ns() if issued_ns is None else issued_ns
    # A page has checked its lease already, and some commands need none.
    is_free = by is not None or all(command.name in FREE_COMMANDS for command in commands)
    lease: AbstractContextManager[Hold | None] = nullcontext() if is_free else acting()
    name = os.environ.get(NAME_VARIABLE, "")[:MOST_LETTERS] if by is None else by
    wanted = [replace(command, by=name) for command in commands]
    with lease as hold:
        still = is_wanted if hold is None else (lambda: is_wanted() and hold.is_held())
        return _exchange(wanted, site_file, site, on_answer, still, issued_ns, retry_ns, far)


def _exchange(
    commands: Sequence[Command],
    site_file: Path,
    site: Site,
    on_answer: Callable[[SessionEvent], None],
    is_wanted: Callable[[], bool],
    issued_ns: int,
    retry_ns: int,
    far: Sequence[str],
) -> dict[str, SessionEvent]:
    """Bind the console, send commands until all are answered, and return the answers; raise as `send_controls`."""
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
    text = client.failure if len(commands) > 1 or not client.refusals or not client.has_all_answers else ""
    if not attention.last_s:
        text = f"{client.failure}; no node reports: {RIG_HINT}"
    if text or far:
        # Imported here, because it loads what reads recordings, which takes longer.
        from telenano.console.last_seen import with_last_seen

        whereabouts = _Whereabouts(LocalRig.read(site_file), attention, commands, client)
        rows = with_last_seen(whereabouts.rig, whereabouts.rows(answers, far))
        texts = [f"{text}{in_force}{_half_done(answers, client)}"] if text else []
        raise UnansweredError("; ".join([*texts, unacknowledged(rows)]).removesuffix("; "), rows)
    return answers


class _Whereabouts(NamedTuple):
    """What is known of nodes that have not answered: the rig here, what was heard of it, and the commands."""

    rig: LocalRig
    attention: "Attention"
    commands: Sequence[Command]
    client: CommandClient

    def rows(self, answers: Mapping[str, SessionEvent], far: Sequence[str]) -> dict[str, Answer]:
        """Return a row for each node that was asked."""
        unsent = {node for command in self.client.unsent for node in command.expected}
        near = dict.fromkeys(node for command in self.commands for node in command.expected)
        rows = {}
        for node in near:
            event = answers.get(node)
            if event is not None and node not in self.client.ended:
                rows[node] = Answer(node, kind_of(event.kind), event.text)
            elif node in unsent:
                rows[node] = Answer(node, "unreached", "was not sent the command, because an earlier one failed")
            elif self.rig.state_of(node) == "absent":
                rows[node] = Answer(node, "absent", "is not running")
            else:
                rows[node] = Answer(
                    node, "unreached", f"has not answered: {self.attention.why(node, time.monotonic())}"
                )
        beyond = "belongs to the other site, to which commands do not cross from here"
        return rows | {node: Answer(node, "unreached", beyond) for node in far}


@contextmanager
def _at_console(book: AddressBook, site_file: Path, site: Site) -> Iterator[Participant]:
    with ExitStack() as opened:
        try:
            participant = opened.enter_context(Participant.at_console(book, site))
        except ConfigError as error:
            raise ConfigError(f"{site_file}: {error}") from error
        yield participant


def _in_force(commands: Sequence[Command], client: CommandClient, readers: int) -> str:
    """Return a warning that an unanswered command may have been obeyed; empty if no node can have read it."""
    if not client.is_unanswered or not readers:
        return ""
    sent = commands[len(commands) - len(client.unsent) - 1].name
    text = f"; {sent} was sent and may be in force all the same: `telenano status` shows what the devices do"
    return f"{text}, and `telenano estop` stops them"


def _half_done(answers: Mapping[str, SessionEvent], client: CommandClient) -> str:
    """Return a text on the commands that were carried out and those that were not sent; empty for a single command."""
    if not client.unsent and len(answers) < 2:
        return ""
    told = {node: event for node, event in answers.items() if event.kind != "refused" and node not in client.ended}
    done = [f"{node} {event.kind}: {event.text}" for node, event in told.items()]
    unsent = [f"{command.name} was not sent to {command.target}" for command in client.unsent]
    return "".join(f"; {each}" for each in [*done, *unsent])


class Attention:
    """Diagnosis of missing answers: records whether nodes are silent or late.

    `last_s` has the time at which each node was last heard [s].
    """

    def __init__(self, now_s: float) -> None:
        """Begin at a time of the monotonic clock [s]."""
        self.last_s: dict[str, float] = {}
        self._begun_s = self._turn_s = now_s
        # Greatest lateness of each node [s], the console included.
        self._late_s: dict[str, float] = {}

    def turn(self, now_s: float) -> None:
        """Record a turn of the waiting console, and its own lateness."""
        self._note_late("this command", now_s - self._turn_s - 1e-3 * _POLL_MS)
        self._turn_s = now_s

    def heard(self, message: Message, now_s: float) -> None:
        """Record a message of a node; a health report also states the node's own lateness."""
        if isinstance(message, NodeHealth):
            self._note_late(message.src, message.lateness_max_s)
        self._note_silence(message.src, now_s)
        self.last_s[message.src] = now_s

    def why(self, node: str, now_s: float) -> str:
        """Return why a node may not have answered: it is silent, or the rig is late; else that it runs."""
        if node not in self.last_s:
            return "nothing was heard of it"
        for known in self.last_s:
            self._note_silence(known, now_s)
        late, late_s = max(self._late_s.items(), key=lambda row: row[1], default=("", 0.0))
        if late_s > _LATE_S:
            return f"the rig is late by {late_s:.2g} s ({late}), so that the command may not have been read yet"
        return "it runs, and reports in time"

    def _note_silence(self, node: str, now_s: float) -> None:
        self._note_late(node, now_s - self.last_s.get(node, self._begun_s + _JOIN_S) - _HEALTH_S)

    def _note_late(self, node: str, late_s: float) -> None:
        self._late_s[node] = max(self._late_s.get(node, 0.0), late_s)


def _new_subscriptions(publisher: ZmqPublisher) -> int:
    """Count the nodes that subscribed to commands since the last call; earlier messages did not reach them."""
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
            # End the stream, because the next command comes from a new process, whose numbers restart.
            publisher = participant.bind(participant.key, zmq.XPUB, ends=True)
        except EndpointError:
            if clock.monotonic_ns() >= deadline:
                raise
            time.sleep(_RETRY_S)
        else:
            # Report every subscription, not only the first one to a topic.
            publisher.socket.set(zmq.XPUB_VERBOSE, 1)
            return publisher
