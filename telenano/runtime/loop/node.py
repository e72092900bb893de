"""The base of every node: its context, its bus, and the methods that its loop (`node_loop`) calls."""

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
# The default period of the loop, for a rig without `realtime.rate_hz` [s].
LOOP_PERIOD_S = 1e-3
HEALTH_PERIOD_NS = 500_000_000


@dataclass
class NodeContext:
    """The arguments of every node: its name, and all objects through which it reaches the outside world."""

    key: str
    clock: Clock
    bus: Bus
    log: StructuredLog
    stop_requested: bool = False
    # The file that keeps an emergency stop until the node is armed; None if the node has no such file.
    kept_stop: Path | None = None
    # The paths by which other processes reach this one; None without sockets, as in virtual time.
    places: Places | None = None
    # Checks whether publishers on this machine are heard; None without sockets between the nodes.
    hearing: Hearing | None = None
    # The period of the loop, from `realtime.rate_hz` [s].
    period_s: float = LOOP_PERIOD_S
    # The machine: process id, processor time, memory, disk, and random numbers.
    machine: Machine = OWN_MACHINE
    # The tasks that the loop runs in its idle gaps.
    deferred: DeferredTasks = field(init=False)

    def __post_init__(self) -> None:
        self.deferred = DeferredTasks(self.clock)

    def request_stop(self) -> None:
        """Make the loop of the node end after the current turn."""
        self.stop_requested = True

    def event(self, kind: str, level: str, text: str, *, answer_to: str = "", **data: bool | float | str) -> None:
        """Publish a session/event and log it; `answer_to` is the id of the command that it answers, if any."""
        self.publish_event(kind, level, text, data, answer_to)

    def publish_event(self, kind: str, level: str, text: str, data: Mapping[str, Scalar], answer_to: str = "") -> None:
        """Publish and log an event whose data is already a mapping."""
        # The text may quote a peer or a file name, so it is cut to the permitted length and made encodable.
        text = text[:MAX_TEXT].encode(errors="replace").decode()
        self.bus.publish("session/event", id=answer_to, kind=kind, level=level, text=text, data=data)
        self.log.write(level, text, kind=kind, **data)


class Node(ABC):
    """One process of the rig: a state machine that messages and deadlines drive.

    It uses only the sockets and the clock of its context, so that a test can drive it in virtual time.
    """

    inputs: ClassVar[tuple[str, ...]]
    # The commands that the node answers, also if a pattern addresses it.
    commands: ClassVar[tuple[str, ...]] = ()
    # The commands that it answers only if addressed by its name.
    named_commands: ClassVar[tuple[str, ...]] = ()
    replay: ClassVar[bool] = False
    # Whether the inputs of the node are written to node/journal; its clock then stands still during a turn.
    journalled: ClassVar[bool] = False
    # The class of the state that `capture` returns.
    state_kind: ClassVar[type[Any]] = tuple
    # The version of that class, raised with each change in the meaning of its fields.
    state_version: ClassVar[int] = 1
    # Whether node/health of others is an input that the node acts on, beyond `admits`, so that the journal has it.
    acts_on_health: ClassVar[bool] = False
    # The topic of the last message of a tick for this node, after which the idle gap for deferred tasks begins; "" for
    # the node's own deadline, None for a node that takes no part in ticks, and whose tasks need no gap.
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
        # Number of messages ignored because they, or the hand's sample in them, were past their deadline.
        self.stale = 0
        # Tracks the ages of messages and of the hand's samples, and stalls of this process.
        self.freshness = Freshness(context.key, self.clock.now_ns())
        # Number of stops by a switch of the device itself.
        self.own_stops = 0

    def defer(self, task: Task, within_ns: int = PATIENCE_NS) -> None:
        """Defer a task to an idle gap of the loop, where it is a separate turn (`DeferredTasks.add`)."""
        self.context.deferred.add(task, is_turn=True, within_ns=within_ns)

    def begin_turn(self, now_ns: int) -> float:
        """Return the duration of a stall of this process that ends now [s], 0.0 without one; report a stall."""
        stalled_s = self.freshness.stalled_s(now_ns)
        if stalled_s:
            text = f"this process stalled for {stalled_s * 1e3:.0f} ms: messages that waited for it are late"
            self.event("fault", "warning", text, stalled_s=stalled_s)
        return stalled_s

    @abstractmethod
    def on_message(self, received: Received) -> None:
        """Act on a message of one of the inputs; session/control is also passed to `on_control`."""

    def admits(self, received: Received) -> bool:
        """Return whether the node may act on a message; device nodes reject messages from a recording."""
        return True

    @property
    def is_latched(self) -> bool:
        """Whether the node is in emergency stop, until it is armed."""
        return False

    @property
    def kept_stop_for(self) -> str:
        """The device to which an emergency stop in the file of this node (`NodeContext.kept_stop`) applies."""
        return self.context.key

    def has_taken_over(self, identifier: str) -> bool:
        """Return whether this node has already taken over, from its file, a stop with this id for another node."""
        return False

    def capture(self) -> Any:
        """Return the full state of the node as `state_kind`: all that later outputs depend on besides later inputs.

        None for a node that cannot be re-run, because its device is real.

        Raises:
            ValueError: There is no state now; the message has the reason.
        """
        return None

    def restore(self, state: Any, find: FindInput) -> None:
        """Continue from a state; `find` returns the payload of an input that the state only names.

        Raises:
            ValueError: The state is not one of this node; LookupError, TypeError and ConfigError mean the same.
        """
        raise ValueError(f"{self.context.key} keeps none")

    def on_place(self, notice: PlaceNotice) -> None:
        """Publish a notice that a path of this process was removed, or was made again."""
        self.event("fault", notice.level, notice.text, path=notice.path, state=notice.state)

    def device_health(self) -> Mapping[str, Any]:
        """Return the fields of node/health on a real device, for the time since the last call."""
        return {}

    def further_outputs(self) -> Mapping[str, int]:
        """Return the number of the next output on each path besides the node's own bus, for the journal."""
        return {}

    def deadline_ns(self) -> int:
        """Return the monotonic time at which `on_deadline` has to be called [ns]."""
        return NEVER_NS

    @abstractmethod
    def on_deadline(self, now_ns: int) -> None:
        """Act on the deadline that is due; `now_ns` is the monotonic time [ns]."""

    def on_control(self, control: SessionControl) -> str:
        """Execute a command and return a sentence on the result; raise RefusedError with the reason to refuse it."""
        raise RefusedError(f"{self.context.key} does not know {control.command}")

    def interrupt(self) -> None:
        """Act on SIGTERM or SIGINT, within the signal handler."""
        self.context.request_stop()

    @abstractmethod
    def make_safe(self) -> None:
        """Put actuators into their declared safe state; called at the end of the loop, whatever the cause."""

    def publish_end(self, bus: "NodeBus") -> None:
        """Publish the last message, the number of messages sent, by which readers know how many they lack."""
        publish_end(bus, self.context.key)


class NodeBus(Bus, Protocol):
    """The bus of a node, which counts its inputs."""

    def input_health(self) -> tuple[InputHealth, ...]:
        """Return the sequence statistics of every input."""

    def rejections(self) -> tuple[dict[str, int], str]:
        """Return the number of messages refused so far by reason, and the text of the last refusal."""

    def sequence_numbers(self) -> dict[str, int]:
        """Return the seq of the next message on each topic."""

    def process_events(self, *, now: bool = False) -> Sequence[ConnectionEvent]:
        """Process events of network connections if some may be pending, or if `now` is set; return the notices."""

    def has_arrived(self) -> bool:
        """Return whether messages may have arrived since the last wait."""
