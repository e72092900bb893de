"""What every node is: its context, its bus, and what its loop (`node_loop`) asks of it."""

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, ClassVar, Literal, Protocol

from telenano.runtime.bus.bus import Bus, ConnectionEvent
from telenano.runtime.bus.hearing import Hearing
from telenano.runtime.bus.places import PlaceNotice, Places
from telenano.runtime.bus.publisher import publish_end
from telenano.runtime.loop.deferred import PATIENCE_NS, DeferredTasks, Task
from telenano.runtime.loop.log import StructuredLog
from telenano.runtime.loop.machine import OWN_MACHINE, Machine
from telenano.timing.clock import NEVER_NS, Clock
from telenano.timing.freshness import Freshness
from telenano.wire.errors import RefusedError
from telenano.wire.messages import MAX_TEXT, InputHealth, Scalar, SessionControl
from telenano.wire.node_state import FindInput
from telenano.wire.received import Received

NodeState = Literal["starting", "ready", "running", "safe", "stopping"]
# This is the period of a rig that gives no `realtime.rate_hz`.
LOOP_PERIOD_S = 1e-3
HEALTH_PERIOD_NS = 500_000_000


@dataclass
class NodeContext:
    """What a node is given: its name and everything that touches the world."""

    key: str
    clock: Clock
    bus: Bus
    log: StructuredLog
    stop_requested: bool = False
    # An emergency stop is kept in this file until the node is armed; None where the node has no such file.
    kept_stop: Path | None = None
    # The paths at which other processes reach this one; None where there is none, as in virtual time.
    places: Places | None = None
    # Whether the publishers on this machine that send are heard; None where nothing is between the nodes.
    hearing: Hearing | None = None
    # The period of the loop, by `realtime.rate_hz` [s].
    period_s: float = LOOP_PERIOD_S
    # What the node takes from its machine besides: process, processor time, memory, disk, and random numbers.
    machine: Machine = OWN_MACHINE
    # The loop runs these tasks in its idle gaps.
    deferred: DeferredTasks = field(init=False)

    def __post_init__(self) -> None:
        self.deferred = DeferredTasks(self.clock)

    def request_stop(self) -> None:
        """End the loop of the node after the step in hand."""
        self.stop_requested = True

    def event(self, kind: str, level: str, text: str, *, answer_to: str = "", **data: bool | float | str) -> None:
        """Publish a session/event and write it to the log."""
        self.publish_event(kind, level, text, data, answer_to)

    def publish_event(self, kind: str, level: str, text: str, data: Mapping[str, Scalar], answer_to: str = "") -> None:
        """Publish and log an event whose data is already a mapping."""
        # the text may quote a peer or a file name: cut to the length that the wire allows, and made encodable
        text = text[:MAX_TEXT].encode(errors="replace").decode()
        self.bus.publish("session/event", id=answer_to, kind=kind, level=level, text=text, data=data)
        self.log.write(level, text, kind=kind, **data)


class Node(ABC):
    """One process of the rig: a state machine that messages and deadlines drive.

    It holds no socket and reads no clock but those of its context, so that a test drives it in virtual time.
    """

    inputs: ClassVar[tuple[str, ...]]
    # The node answers these commands, and those below only when it is named, so that no pattern reaches it.
    commands: ClassVar[tuple[str, ...]] = ()
    named_commands: ClassVar[tuple[str, ...]] = ()
    replay: ClassVar[bool] = False
    # The inputs of the node are written to node/journal, and its clock stands still during a turn.
    journalled: ClassVar[bool] = False
    # `capture` returns an instance of this class; its version counts the changes in the meaning of the fields.
    state_kind: ClassVar[type[Any]] = tuple
    state_version: ClassVar[int] = 1
    # node/health of others is a turn as well, and not only for `admits`
    acts_on_health: ClassVar[bool] = False
    # A tick of the control loop comes to the node with this topic before the idle gap in which deferred tasks are run;
    # "" is the node's own deadline. None is for a node that carries no ticks on and defers nothing.
    idle_after: ClassVar[str | None] = None
    period_s: float = 0.0
    state: NodeState = "ready"

    def __init__(self, context: NodeContext) -> None:
        self.context = context
        self.clock: Clock = context.clock
        self.publish = context.bus.publish
        self.event = context.event
        self.steps = 0
        self.overruns = 0
        # messages that were not acted on because they, or the hand's sample behind them, were past their deadline
        self.stale = 0
        # It knows the age of the messages and of the hand's samples, and whether this process stalled.
        self.freshness = Freshness(context.key, self.clock.now_ns())
        # A switch of the device itself has stopped it this number of times.
        self.own_stops = 0

    def defer(self, task: Task, within_ns: int = PATIENCE_NS) -> None:
        """Have a task run in an idle gap of the loop, as a turn of its own (`DeferredTasks.add`)."""
        self.context.deferred.add(task, is_turn=True, within_ns=within_ns)

    def begin_turn(self, now_ns: int) -> float:
        """Return for how long this process has stalled until now [s], 0.0 if it has not; report a stall."""
        stalled_s = self.freshness.stalled_s(now_ns)
        if stalled_s:
            text = f"this process stalled for {stalled_s * 1e3:.0f} ms: what waited for it meanwhile is late"
            self.event("fault", "warning", text, stalled_s=stalled_s)
        return stalled_s

    @abstractmethod
    def on_message(self, received: Received) -> None:
        """Act on a message of one of the inputs; session/control goes to `on_control` as well."""

    def admits(self, received: Received) -> bool:
        """Return whether a message may be acted on; device nodes keep out what comes from a recording."""
        return True

    @property
    def is_latched(self) -> bool:
        """Whether the node is in emergency stop, until it is armed."""
        return False

    @property
    def kept_stop_for(self) -> str:
        """The device that an emergency stop in the file of this node (`NodeContext.kept_stop`) is for."""
        return self.context.key

    def has_taken_over(self, identifier: str) -> bool:
        """Return whether this node has taken over a stop of this id, which is for another one, from its file."""
        return False

    def capture(self) -> Any:
        """Return, as `state_kind`, all that the outputs depend on besides the inputs to come.

        None of a node that cannot be run again, because its device is a real one. ValueError says why there is no state
        now.
        """
        return None

    def restore(self, state: Any, find: FindInput) -> None:
        """Continue from a state; `find` returns the payload of an input that the state only names.

        Raises:
            ValueError: It is not a state of this node; LookupError, TypeError and ConfigError mean the same.
        """
        raise ValueError(f"{self.context.key} keeps none")

    def on_place(self, notice: PlaceNotice) -> None:
        """Report that a path of this process was removed, or is there again."""
        self.event("fault", notice.level, notice.text, path=notice.path, state=notice.state)

    def device_health(self) -> Mapping[str, float | str]:
        """Return what node/health has of a real device since the last call."""
        return {}

    def further_outputs(self) -> Mapping[str, int]:
        """Return the number of the next output by each way past the node's own bus, for the journal."""
        return {}

    def deadline_ns(self) -> int:
        """Return the monotonic time [ns] at which `on_deadline` is wanted."""
        return NEVER_NS

    @abstractmethod
    def on_deadline(self, now_ns: int) -> None:
        """Act on a deadline that has come."""

    def on_control(self, control: SessionControl) -> str:
        """Execute a command and return a sentence about the result; RefusedError gives the reason if it cannot."""
        raise RefusedError(f"{self.context.key} does not know {control.command}")

    def interrupt(self) -> None:
        """Act on SIGTERM or SIGINT, within the signal handler."""
        self.context.request_stop()

    @abstractmethod
    def make_safe(self) -> None:
        """Put actuators in their declared safe state; called whatever ends the loop."""

    def publish_end(self, bus: "NodeBus") -> None:
        """Publish the last message: how many were sent, for readers to know what they lack at the end."""
        publish_end(bus, self.context.key)


class NodeBus(Bus, Protocol):
    """The bus of a node, which counts its inputs."""

    def input_health(self) -> tuple[InputHealth, ...]:
        """Return the sequence statistics of every input."""

    def rejections(self) -> tuple[dict[str, int], str]:
        """Return the frames refused so far by reason, and the text of the last refusal."""

    def sequence_numbers(self) -> dict[str, int]:
        """Return the seq of the next message on each topic."""

    def process_events(self, *, now: bool = False) -> Sequence[ConnectionEvent]:
        """Process events of network connections, if there may be any or `now`; return what happened to them."""

    def has_arrived(self) -> bool:
        """Return whether something may have arrived since the last wait, for `receive`."""
