"""Commands on the bus: `CommandClient` sends them and collects answers, `CommandHandler` executes them in a node.

A command is a `session/control`; its answers are `session/event`s with the same id. The client sends it again with the
same id until all nodes have answered; a node executes an id once, and answers each time that it receives it.

A command expires: a node refuses it unless it can be shown to be younger than its validity (ADR 0014). Its age follows
from `t_ns` if the clocks of sender and node can agree. If they cannot, or the node itself has stalled, a command is
fresh only if it quotes a recent time of the node's own clock. The refusal contains that time, and a client that still
runs sends the command again with it. Commands that only stop something are obeyed at any age.

An emergency stop voids all earlier commands to move (ADR 0059): after a stop, a node begins a motion only for a command
that quotes the newest stop. The refusal names the stop beside the time, so that both are one quotation. The client
quotes a stop that came before the commands were issued, and gives up at a later one.
"""

import math
from collections import OrderedDict, deque
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal, NamedTuple

from telenano.runtime.loop.estop_latch import EstopLatch, begins_motion
from telenano.runtime.loop.machine import OWN_MACHINE
from telenano.timing.clock import Clock
from telenano.wire import encode
from telenano.wire.answers import parameter_data
from telenano.wire.ends import read_end
from telenano.wire.errors import LaterError, TelenanoError
from telenano.wire.messages import Message, Scalar, SessionControl, SessionEvent
from telenano.wire.nodes import LAUNCHER, is_estop, is_meant, is_pattern, name_of, site_of

CommandName = Literal["start", "stop", "arm", "estop", "set", "mark"]

RESEND_NS = 200_000_000
DEADLINE_NS = 5_000_000_000
_RETRY_PERIOD_NS = 300_000_000
_RELEASE_PERIOD_NS = 1_000_000_000
_REMEMBERED_ANSWERS = 256

DEFAULT_VALIDITY_S = 1.0
_LONGEST_VALIDITY_S = 60.0
# Commands that make a device safe, or end a motion.
_OBEYED_AT_ANY_AGE = ("estop", "stop")
# Greatest difference of two synchronised clocks: if a time stamp is further ahead, the age of its command is unknown.
_CLOCKS_AGREE_S = 0.1
# After a stall of the default validity of a command, messages in the queues may have waited that long.
STALL_NS = round(DEFAULT_VALIDITY_S * 1e9)


@dataclass(frozen=True)
class Command:
    """A command and the `expected` nodes (node@site) that have to answer it.

    Who is asked by a pattern follows from the site file (`telenano.console.send_commands.asked`). After a failed
    command that is not `required`, the next one follows all the same. `by` is the name of the giver of the command.
    With `placed`, the command is over only when the instrument reports, after its answer, that the tip is placed.
    """

    name: CommandName
    target: str
    expected: tuple[str, ...] = ()
    parameters: Mapping[str, Scalar] = field(default_factory=dict)
    required: bool = True
    deadline_ns: int = DEADLINE_NS
    by: str = ""
    placed: bool = False

    @property
    def begins_motion(self) -> bool:
        return begins_motion(self.name, self.parameters)

    def concerns(self, node: str) -> bool:
        return node in self.expected or is_meant(node, self.target)


class CommandClient:
    """Sends commands one after the other, each until it is answered, refused for good, or out of time.

    `failure` is the reason why a required command failed; `tolerated_failures` has those of the other commands by
    target. `answers` are the answers to the last command by node, including refusals; `ids` has the id of each answered
    command. `ended` are nodes whose process ended while it was being placed, so that its answer no longer holds.
    `void`: the failure is an emergency stop, which has made the commands void. `latched` is a node in an earlier
    emergency stop, which a person has to release: until then, the command is tried again.
    """

    def __init__(
        self,
        clock: Clock,
        publish: Callable[..., Any],
        commands: Iterable[Command],
        *,
        retry_ns: int = 0,
        issued_ns: int | None = None,
        releases_stops: bool = True,
        token: Callable[[int], str] = OWN_MACHINE.token,
    ) -> None:
        """Prepare to send `commands`.

        Args:
            clock: The clock of the sender.
            publish: Publishes a session/control.
            commands: The commands, in their order.
            retry_ns: Time for which a required command is tried again after a refusal [ns].
            issued_ns: Time at which the commands were issued, on the monotonic clock [ns]; None for now. A later
                emergency stop makes them void.
            releases_stops: False if the commands do not come from a person who knows of earlier stops; the client then
                waits until a person releases a node in emergency stop.
            token: Returns a random number of this many bytes, as hexadecimal text, unique to this sender.

        Raises:
            ValueError: No node is expected to answer one of the commands.
        """
        self.failure = ""
        self.void = False
        self.latched = ""
        self.tolerated_failures: dict[str, str] = {}
        self.ids: dict[str, str] = {}
        self.answers: dict[str, SessionEvent] = {}
        self.ended: set[str] = set()
        self._clock = clock
        self._publish = publish
        self._commands = deque(commands)
        if silent := [command.name for command in self._commands if not command.expected]:
            raise ValueError(f"{', '.join(silent)}: no node is expected to answer")
        self._motions = [command for command in self._commands if command.begins_motion]
        self._retry_ns = retry_ns
        # Random and without a time, so that ids of two senders differ whatever their clocks show.
        self._sender = token(8)
        self._issued = 0
        self._command: Command | None = None
        self._id = ""
        # Newest report of each node to be placed since the command was issued.
        self._on_the_way: dict[str, SessionEvent] = {}
        # Seq and t_ns of the newest event of such a node, which reveal a new process of the node.
        self._newest: dict[str, tuple[int, int]] = {}
        # Nodes that have reported that they are placed.
        self._placed: set[str] = set()
        # Nodes whose motion to their place was ended by another cause.
        self._ended: set[str] = set()
        self._expected: set[str] = set()
        self._begun_ns = self._issued_ns = self._next_ns = self._deadline_ns = 0
        self._wished_ns = clock.monotonic_ns() if issued_ns is None else issued_ns
        self._releases_stops = releases_stops
        # Refusals that the current command quotes, by node, and their shortest round trip.
        self._quoted: dict[str, SessionEvent] = {}
        self._round_trip_s = math.inf

    def advance(self) -> bool:
        """Send the command that is due; return whether every command is over, or a required one has failed."""
        while not self.failure:
            command = self._command
            if command is None:
                if not self._commands:
                    return True
                self._begun_ns = self._clock.monotonic_ns()
                command = self._commands.popleft()
                self._quoted, self._round_trip_s = {}, math.inf
                self._issue(command)
            if not self._advance(command):
                return False
        return True

    def on_event(self, event: Message) -> bool:
        """Record a message; return whether it is a node's first answer to the current command (a session/event)."""
        if not isinstance(event, SessionEvent):
            return False
        if event.kind == "ack" and event.data.get("command") == "estop" and self._would_move(event.src):
            self._give_up(f"{event.src} was stopped by an emergency stop")
            return False
        if self._command is not None and self._command.placed:
            self._record_end(event)
            if event.kind == "mode":
                self._record_way(self._command, event)
        if event.id != self._id or event.kind not in ("ack", "refused") or event.src in self.answers:
            return False
        if event.kind == "refused" and (event.data.get("expired") is True or "latch" in event.data):
            self._record_quotation(event)
            return False
        self.answers[event.src] = event
        if self._command is not None and self._command.placed:
            # The tip may still wait for the first command of an armed hand, or may already have set a later deadline by
            # the time that it needs.
            self._deadline_ns = max(self._deadline_ns, self._clock.monotonic_ns() + self._command.deadline_ns)
        return True

    def _record_way(self, command: Command, event: SessionEvent) -> None:
        """Record the progress of a node to be placed; set the deadline by twice the time that it says it needs."""
        if event.src not in command.expected or event.src in self._ended:
            return
        self._on_the_way[event.src] = event
        now_ns, needs_s = self._clock.monotonic_ns(), event.data.get("placing_s")
        if event.data.get("placed") is True:
            self._placed.add(event.src)
        elif event.src in self.answers and "ended" in event.data:
            # The motion of the node was ended, and it stays where it is.
            self._ended.add(event.src)
            self._deadline_ns = now_ns
        elif isinstance(needs_s, int | float):
            self._deadline_ns = now_ns + command.deadline_ns + round(2e9 * needs_s)
        elif event.src in self.answers and event.data.get("mode") == "estop":
            self._give_up(f"{event.src} was stopped by an emergency stop")
        elif event.src in self.answers and event.data.get("mode") == "retracting":
            self._deadline_ns = now_ns

    def note_end(self, node: str, text: str = "") -> None:
        """Forget the reports of a node whose process has ended; the command fails if the node was being placed.

        Args:
            node: The node as node@site.
            text: A sentence on the end; empty if none is known.
        """
        command = self._command
        if command is None or not command.placed or node not in command.expected:
            return
        for noted in (self._on_the_way, self._newest):
            noted.pop(node, None)
        self._placed.discard(node)
        # The armed process no longer exists, and the next one is not armed.
        if node in self.answers and not self.failure:
            self.ended.add(node)
            self.failure = f"{node} ended while it was being placed{text and ': '}{text}; arm it again"

    def _record_end(self, event: SessionEvent) -> None:
        """Note the end of a process: reported by its launcher or itself, or shown by a restart of its seq."""
        if event.kind == "node" and name_of(event.src) == name_of(LAUNCHER) and "exit_code" in event.data:
            self.note_end(str(event.data.get("about_node", "")), event.text)
        elif read_end({"kind": event.kind, "data": event.data}) is not None:
            self.note_end(event.src, event.text)
        else:
            seq, t_ns = self._newest.get(event.src, (event.seq, event.t_ns))
            if event.seq < seq and event.t_ns > t_ns:
                self.note_end(event.src)
            if event.seq >= seq or event.t_ns > t_ns:
                self._newest[event.src] = (event.seq, event.t_ns)

    def is_place(self, event: SessionEvent) -> bool:
        """Return whether this event is the report that a node, for which these commands wait, is placed."""
        return event.src in self._placed and self._on_the_way.get(event.src) is event and "placed" in event.data

    def make_due(self) -> None:
        """Make `advance` send the current command again at once, because a new reader has connected."""
        self._next_ns = self._clock.monotonic_ns()

    @property
    def unsent(self) -> tuple[Command, ...]:
        """The commands that were not sent, because an earlier one has failed."""
        return tuple(self._commands)

    @property
    def is_unanswered(self) -> bool:
        """Whether an expected node has neither answered nor refused."""
        return not self._expected <= {*self.answers, *self._quoted}

    @property
    def has_all_answers(self) -> bool:
        """Whether every expected node has answered the current or last command."""
        return self._expected <= set(self.answers)

    @property
    def refusals(self) -> list[SessionEvent]:
        return [event for event in self.answers.values() if event.kind == "refused"]

    def _issue(self, command: Command) -> None:
        self._command, self._id, self.answers = command, f"{self._sender}-{self._issued}", {}
        self.latched = ""
        self._on_the_way, self._placed, self._expected = {}, set(), set(command.expected)
        self._ended = set()
        self._issued += 1
        self._issued_ns = self._next_ns = self._clock.monotonic_ns()
        self._deadline_ns = self._issued_ns + command.deadline_ns

    def _would_move(self, node: str) -> bool:
        """Return whether these commands are not over and one of them lets a node move."""
        is_over = self._command is None and not self._commands
        return not is_over and any(command.concerns(node) for command in self._motions)

    def _give_up(self, reason: str) -> None:
        """End all commands as void, because they are older than an emergency stop."""
        self.failure, self.void = self.failure or reason, True

    def _record_quotation(self, event: SessionEvent) -> None:
        """Quote a refusal from now on, its time and emergency stop; give up if that stop voids the commands."""
        if reason := self._void_by(event):
            self._give_up(reason)
            return
        if event.data.get("latched") is True and not self._releases_stops:
            self.answers[event.src], self.latched = event, event.src
            return
        now_ns = self._clock.monotonic_ns()
        if not self._quoted and self._command is not None:
            # The node is alive, and may need the full time again to answer.
            self._deadline_ns = now_ns + self._command.deadline_ns
        if event.src not in self._quoted and event.data.get("expired") is not True:
            self._next_ns = now_ns
        self._quoted[event.src] = event
        sent_t_ns = event.data.get("sent_t_ns")
        if isinstance(sent_t_ns, int):
            self._round_trip_s = min(self._round_trip_s, (self._clock.now_ns() - sent_t_ns) * 1e-9)

    def _void_by(self, event: SessionEvent) -> str:
        """Return a sentence why the stops in a refusal make the commands void; empty if they do not.

        A stop counts as older than the commands only if its age at the node exceeds the age of the commands when the
        refusal arrives; this needs no common clock. The transit time of the refusal counts against the commands.
        """
        data, name = event.data, "" if self._command is None else self._command.name
        quoted = self._quoted.get(event.src)
        waited_s = (self._clock.monotonic_ns() - self._wished_ns) * 1e-9
        age_s = data.get("estop_age_s")
        if isinstance(age_s, int | float) and age_s <= waited_s:
            return f"{name} is void: an emergency stop came to {event.src} after it; give it again to release the stop"
        if quoted is not None and quoted.data.get("latch", "") != data.get("latch", ""):
            return f"{name} is void: {event.src} was started again meanwhile; give it again"
        return ""

    def _quotations(self) -> dict[str, Any]:
        """Return the fields of a session/control that quote the refusals so far; empty without a refusal."""
        if not self._quoted:
            return {}
        round_trip_s = self._round_trip_s if math.isfinite(self._round_trip_s) else 0.0
        latches = {node: event.data["latch"] for node, event in self._quoted.items() if "latch" in event.data}
        return {
            "validity_s": DEFAULT_VALIDITY_S + max(0.0, round_trip_s),
            "node_t_ns": {node: event.t_ns for node, event in self._quoted.items()},
            **({"node_latch": latches} if latches else {}),
        }

    def _advance(self, command: Command) -> bool:
        """Return whether the current command is over."""
        now = self._clock.monotonic_ns()
        if self._answered(command) or now >= self._deadline_ns:
            return self._conclude(command, now)
        if now >= self._next_ns and not self.has_all_answers:
            self._next_ns = now + RESEND_NS
            self._publish(
                "session/control",
                id=self._id,
                command=command.name,
                target=command.target,
                parameters=dict(command.parameters),
                **({"by": command.by} if command.by else {}),
                **self._quotations(),
            )
        return False

    def _answered(self, command: Command) -> bool:
        is_placed = not command.placed or bool(self.refusals) or self._expected <= self._placed
        return self.has_all_answers and is_placed

    def _conclude(self, command: Command, now_ns: int) -> bool:
        """Record the outcome of a command; return whether it is over, False if it will be tried again."""
        failure = self._reason(command)
        if not failure:
            self.ids[command.name] = self._id
        elif not command.required:
            self.tolerated_failures[command.target] = failure
        elif self.refusals and (self.latched or now_ns - self._begun_ns < self._retry_ns):
            # The first fresh command for a device may still be under way; for a release by a person there is no limit.
            if now_ns - self._issued_ns >= (_RELEASE_PERIOD_NS if self.latched else _RETRY_PERIOD_NS):
                if self.latched:
                    self._begun_ns = now_ns
                self._issue(command)
            return False
        else:
            self.failure = failure
        self._command = None
        return True

    def _reason(self, command: Command) -> str:
        """Return the reasons why a command failed, as a sentence; empty if it succeeded."""
        quoted = {node: event for node, event in self._quoted.items() if node not in self.answers}
        missing = sorted(set(command.expected) - {*self.answers, *quoted})
        refusals = [*self.refusals, *quoted.values()]
        reasons = [f"{event.src} refused {command.name}: {event.text}" for event in refusals]
        if missing:
            reasons.append(f"{', '.join(missing)} did not answer {command.name} in time")
        elif command.placed and not reasons:
            waited_s = 1e-9 * (self._clock.monotonic_ns() - self._issued_ns)
            for node in sorted(set(command.expected) - self._placed):
                newest = self._on_the_way.get(node, self.answers[node])
                reasons.append(f"{node} was not placed within {waited_s:.3g} s of arming: {newest.text}")
        return "; ".join(reasons)


class _Answer(NamedTuple):
    kind: Literal["ack", "refused"]
    level: str
    text: str
    begins_motion: bool


class CommandHandler:
    """Executes session/control for a node, once per id; a command that is sent again gets the same answer again.

    An emergency stop is executed each time that it comes, and voids every earlier command that begins a motion: one
    that was not executed yet is refused, and the stored answer to an executed one is dropped.
    """

    def __init__(
        self,
        node: str,
        known: Sequence[str],
        execute: Callable[[SessionControl], str],
        event: Callable[..., None],
        *,
        is_latched: Callable[[], bool] = lambda: False,
        kept: Path | None = None,
        obstacle: Callable[[], str] = lambda: "",
        token: Callable[[int], str] = OWN_MACHINE.token,
    ) -> None:
        """Take commands for `node` (node@site).

        Args:
            node: The node as node@site.
            known: The commands that the node answers when a pattern matches it.
            execute: Returns a sentence for the answer, or raises RefusedError.
            event: Publishes a session/event.
            is_latched: Returns whether the node is in emergency stop.
            kept: The file that keeps the newest emergency stop until the node is armed.
            obstacle: Returns the reason why an emergency stop might not reach the node now, else "". While there is
                one, no command may begin a motion.
            token: Returns a random number of this many bytes, as hexadecimal text, unique to this run of a node.
        """
        self.latch = EstopLatch(kept, token)
        self._token = token
        self._node = node
        self._known = frozenset(known)
        self._execute = execute
        self._event = event
        self._is_latched = is_latched
        self._obstacle = obstacle
        self._answers: OrderedDict[str, _Answer] = OrderedDict()
        self._stalled_s = 0.0
        self._distrust_until_ns = 0

    def note_stall(self, now_ns: int, duration_ns: int) -> None:
        """Record that the node did nothing for `duration_ns` until `now_ns`, both on the clock of `handle` [ns].

        Messages that waited meanwhile are read within the next second, and may be stamped by a clock that is ahead.
        """
        self._stalled_s = duration_ns * 1e-9
        self._distrust_until_ns = now_ns + STALL_NS

    def note_own_stop(self, now_ns: int) -> None:
        """Record that a switch of the device has stopped it, at `now_ns` on the clock of `handle` [ns]."""
        self._note_stop(stop_of(self._node, now_ns, self._token), now_ns)

    def handle(self, control: SessionControl, now_ns: int) -> bool:
        """Execute a command if it concerns this node, and answer with a session/event of the same id.

        Args:
            control: The command.
            now_ns: The time on the clock that stamps the node's messages [ns].

        Returns:
            Whether the node executed the command now; False if it repeated an answer, refused, prepares or ignored the
            command.
        """
        if not is_meant(self._node, control.target):
            return False
        if is_pattern(control.target) and control.command not in self._known:
            return False
        if is_estop(control.src) and control.command != "estop":
            # Clients at the inlet for emergency stops may only stop the node.
            return False
        is_new = control.id not in self._answers or control.command == "estop"
        if is_new:
            if refusal := self._refusal(control, now_ns):
                text, facts = refusal
                self._event("refused", "warning", text, answer_to=control.id, **facts, **answer_data(control))
                return False
            try:
                answer = self._answers[control.id] = self._answer(control)
            except LaterError:
                # Its sender sends it again until it is answered.
                return False
            if len(self._answers) > _REMEMBERED_ANSWERS:
                self._answers.popitem(last=False)
            if answer.kind == "ack" and control.command == "estop":
                self._note_stop(control, now_ns)
            elif answer.kind == "ack" and control.command == "arm":
                self.latch.release()
        kind, level, text, _ = self._answers[control.id]
        self._event(kind, level, text, answer_to=control.id, **answer_data(control))
        return is_new

    def _note_stop(self, control: SessionControl, now_ns: int) -> None:
        for identifier in [
            identifier_found for identifier_found, answer in self._answers.items() if answer.begins_motion
        ]:
            del self._answers[identifier]
        if fault := self.latch.record(control.id, encode(control), now_ns):
            self._event("fault", "warning", fault)

    def _refusal(self, control: SessionControl, now_ns: int) -> tuple[str, dict[str, Scalar]] | None:
        """Return the reason why a command is refused before it reaches the node, and its data; None if it may run."""
        facts: dict[str, Scalar] = {}
        if begins_motion(control.command, control.parameters):
            facts = {**self.latch.facts(now_ns), "latched": self._is_latched()}
            if obstacle := self._obstacle():
                return f"{control.command} is refused: an emergency stop might not reach this node: {obstacle}", facts
            # The latch is checked before the age: a client of an older version sends an expired command again, but
            # gives up at any other refusal.
            if reason := self.latch.reason_against((control.node_latch or {}).get(self._node), now_ns):
                return f"{control.command} is refused: {reason}", facts
        if expiry := self._expiry(control, now_ns):
            return expiry, {"expired": True, **facts}
        return None

    def _expiry(self, control: SessionControl, now_ns: int) -> str:
        """Return the reason why a command is too old, or may be too old, to be executed; empty if it is fresh."""
        if control.command in _OBEYED_AT_ANY_AGE:
            return ""
        valid_s = DEFAULT_VALIDITY_S if control.validity_s is None else min(control.validity_s, _LONGEST_VALIDITY_S)
        quoted_ns = (control.node_t_ns or {}).get(self._node)
        if quoted_ns is not None and 0.0 <= (now_ns - quoted_ns) * 1e-9 <= valid_s:
            return ""
        age_s = (now_ns - control.t_ns) * 1e-9
        if age_s > valid_s:
            return f"{control.command} expired: it was sent {age_s:.1f} s ago and valid for {valid_s:.1f} s"
        if age_s < -_CLOCKS_AGREE_S:
            return f"{control.command} cannot be shown to be fresh: the clock of {control.src} is {-age_s:.1f} s ahead"
        if now_ns < self._distrust_until_ns:
            stall = f"this node stalled for {self._stalled_s:.1f} s"
            return f"{control.command} cannot be shown to be fresh: {stall}, during which it may have waited"
        return ""

    def _answer(self, control: SessionControl) -> _Answer:
        begins = begins_motion(control.command, control.parameters)
        try:
            return _Answer("ack", "info", self._execute(control), begins)
        except LaterError:
            raise
        except TelenanoError as error:
            return _Answer("refused", "warning", str(error), begins)


def answer_data(control: SessionControl) -> dict[str, Scalar]:
    """Return the data of an answer that repeat the command: a recorder may not have received the command itself.

    Its sender comes and goes, while the node that answers is connected for the whole session.
    """
    giver: dict[str, Scalar] = {} if control.by is None else {"by": control.by}
    facts: dict[str, Scalar] = {
        "command": control.command,
        "target": control.target,
        "giver": control.src,
        "sent_t_ns": control.t_ns,
    }
    return {**facts, **giver, **parameter_data(control.parameters)}


def author_of(control: SessionControl) -> tuple[str, dict[str, Scalar]]:
    """Return who gave a command and why, as a clause and as facts for the event of the act that it causes.

    The reason is the parameter `because`, which a program states that commands by itself, for nobody in person.
    """
    why = control.parameters.get("because", "")
    person = f" ({control.by})" if control.by else ""
    facts: dict[str, Scalar] = {"author": control.src}
    facts |= {"by": control.by} if control.by else {}
    facts |= {"because": why} if why else {}
    return f"asked by {control.src}{person}{f': {why}' if why else ''}", facts


def stop_of(node: str, now_ns: int, token: Callable[[int], str] = OWN_MACHINE.token) -> SessionControl:
    """Return an emergency stop for a node (node@site) that no sender has sent, stamped `now_ns` [ns]."""
    src, number = f"estop@{site_of(node)}", token(12)
    return SessionControl(seq=0, t_ns=now_ns, src=src, v=1, id=number, command="estop", target=node, parameters={})
