"""The player as a node: it binds the endpoints of other nodes and publishes their recorded messages again.

The recorded bytes are sent unchanged, including times and `seq`. Only after a jump (seek, loop) the `seq` of messages
is shifted so that it continues: readers would treat an old number as a repetition and a gap as a loss. Commands get the
time at which they are played, because with their own they would have expired.
"""

import os
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, ClassVar

import msgpack
import zmq

from services.player.plan import ReplayPlan, node_of
from services.player.playback import Playback, PlaybackClock, is_state
from telenano.recording.messages import RecordedChannel, RecordedMessage
from telenano.runtime.bus.publisher import SNDMORE, ZmqPublisher
from telenano.runtime.loop.machine import resident_bytes
from telenano.runtime.loop.node import HEALTH_PERIOD_NS, Node, NodeContext
from telenano.timing.clock import Clock
from telenano.wire.errors import RefusedError
from telenano.wire.messages import Scalar, SessionControl

_TICK_NS = 50_000_000
_PROGRESS_NS = 1_000_000_000
_RETRY_NS = 500_000
# Least free time before the next message for deferred work: reading ahead or publishing a report takes less.
_PIECE_NS = 250_000
_BATCH = 256
# At rate 0 this number of messages is read and then sent together, so that the threads of both ends wake up less often.
_FAST_BATCH = 2048
_LINGER_MS = 10_000
# Least rate; an hour would take a century.
_LEAST_RATE = 1e-6
_SUBSCRIBE = b"\x01"
# Most subscriptions that are read at a time, so that a flood of them does not block the playing of messages.
_MOST_SUBSCRIPTIONS = 256


@dataclass(frozen=True)
class PlaySettings:
    """Initial settings: rate, pause, and the longest wait until every topic has a reader [s]."""

    rate: float = 1.0
    paused: bool = False
    wait_s: float = 1.0


class ReplayPublisher:
    """Publisher at the endpoint of a played node, which drops nothing for slow readers and knows its subscriptions."""

    def __init__(self, publisher: ZmqPublisher) -> None:
        """Configure the socket of a publisher, which must be of the kind `zmq.XPUB`."""
        self.publisher = publisher
        self._send_frame = publisher.send_frame
        self.sent = 0
        self.was_read = False
        self.subscriptions: set[bytes] = set()
        socket = publisher.socket
        # A full queue of a reader raises an error at once, instead of dropping the message silently.
        socket.set(zmq.XPUB_NODROP, 1)
        socket.set(zmq.XPUB_VERBOSE, 1)
        socket.set(zmq.SNDTIMEO, 0)
        socket.set(zmq.LINGER, _LINGER_MS)

    def send(self, topic: bytes, payload: bytes) -> bool:
        """Send a message; return False if the queue of a reader is full, and then send nothing to any reader."""
        try:
            self._send_frame(topic, SNDMORE)
            self._send_frame(payload)
        except zmq.Again:
            return False
        self.sent += 1
        return True

    def read_subscriptions(self) -> bool:
        """Read subscription messages; return whether there was a new subscription since the last call."""
        subscribed = False
        # The option EVENTS is used because `Socket.poll` would create a poller first.
        for _ in range(_MOST_SUBSCRIPTIONS):
            if not int(self.publisher.socket.get(zmq.EVENTS)) & zmq.POLLIN:
                break
            message: bytes = self.publisher.socket.recv()
            if message.startswith(_SUBSCRIBE):
                self.subscriptions.add(message[1:])
                subscribed = self.was_read = True
            else:
                self.subscriptions.discard(message[1:])
        return subscribed

    def has_subscriber(self, topic: str) -> bool:
        name = topic.encode()
        return any(name.startswith(prefix) for prefix in self.subscriptions)


class Route:
    """Route of a channel's messages: publisher, topic, and the shift of `seq` that makes it continue after jumps."""

    def __init__(self, publisher: ReplayPublisher, topic: str, *, is_command: bool) -> None:
        self.publisher = publisher
        self.topic = topic.encode()
        # Whether the recorded bytes are sent unchanged.
        self.as_recorded = not is_command
        self._is_command = is_command
        self._offset = 0
        self._jumped = False
        # The `seq` sent last; None before the first message.
        self._last: int | None = None

    def jump(self) -> None:
        """Record a jump: the next message does not follow the last one."""
        self._jumped = self._last is not None
        self.as_recorded = self.as_recorded and not self._jumped

    def payload(self, message: RecordedMessage, clock: Clock) -> bytes:
        """Return the bytes to send: the recorded ones, with a new `seq` after a jump, and a new time for a command."""
        if self._jumped and self._last is not None:
            self._offset = self._last + 1 - message.seq
        if self._offset == 0 and not self._is_command:
            return message.payload
        fields = message.fields()
        fields["seq"] = message.seq + self._offset
        # The number is no longer one of the recorded process.
        fields.pop("run", None)
        if self._is_command:
            fields["t_ns"] = clock.now_ns()
            # The latch refers to an emergency stop of the recorded run, which cannot be released again.
            fields.pop("node_latch", None)
        packed: bytes = msgpack.packb(fields)
        return packed

    def sent(self, message: RecordedMessage) -> None:
        """Record that a message was sent."""
        self._last = message.seq + self._offset
        if not self.as_recorded:
            self._jumped = False
            self.as_recorded = self._offset == 0 and not self._is_command


class PlayerNode(Node):
    """Plays a recording through publishers of its nodes, controlled by session/control and by method calls."""

    inputs: ClassVar[tuple[str, ...]] = ("session/control",)
    named_commands: ClassVar[tuple[str, ...]] = ("start", "stop", "set")
    replay = True

    def __init__(
        self,
        context: NodeContext,
        playback: Playback,
        plan: ReplayPlan,
        publishers: Mapping[str, ReplayPublisher],
        settings: PlaySettings,
        *,
        observe: Callable[["PlayerNode"], None] = lambda player: None,
        warnings: Sequence[str] = (),
    ) -> None:
        """Prepare to play.

        Args:
            context: The clock, bus and machine of the node.
            playback: The recording and the position in it.
            plan: The nodes to play, and the channels to publish.
            publishers: The publisher for each played node.
            settings: The initial settings.
            observe: Called twenty times a second, for a status line and keys.
            warnings: Sentences to publish at the start.
        """
        super().__init__(context)
        self.playback = playback
        self.finished = False
        self.started = False
        self.blocked = False
        self.sent = 0
        now = self.clock.monotonic_ns()
        self.playback_clock = PlaybackClock(now, playback.position_ns, settings.rate, paused=settings.paused)
        self._plan = plan
        self._publishers = publishers
        self._routes = {channel: self._route(channel) for channel in plan.channels}
        # Routes by the `id` of a channel, which is kept alive: hashing a channel takes longer than sending a message.
        self._known: dict[int, tuple[RecordedChannel, Route]] = {}
        self._observe = observe
        self._warnings = warnings
        # Work that is done in the gaps between messages, at the latest with the next tick.
        self._deferred: deque[Callable[[], None]] = deque()
        self._pending_state: deque[RecordedMessage] = deque()
        self._steps = 0
        self._wait_until_ns = now + round(settings.wait_s * 1e9)
        self._tick_ns = now
        self._retry_ns = 0
        self._health_ns = now
        self._progress_ns = now
        self._reported = dict.fromkeys(publishers, 0)

    def on_message(self, received: object) -> None:
        """Do nothing: commands come through `on_control`."""

    def deadline_ns(self) -> int:
        if not self.started or self.finished:
            return self._tick_ns
        if self.blocked:
            return min(self._tick_ns, self._retry_ns)
        due = self._due_ns()
        return self._tick_ns if due is None else min(self._tick_ns, due)

    def on_deadline(self, now_ns: int) -> None:
        if now_ns >= self._tick_ns:
            self._tick(now_ns)
        if self.started and not self.finished:
            self._play(now_ns)

    def make_safe(self) -> None:
        """Publish the state `stopping` at each endpoint, so that readers know that the replay is over."""
        for publisher in self._publishers.values():
            self._publish_health(publisher, 0.0, "stopping")

    def on_control(self, control: SessionControl) -> str:
        """Carry out `start` (continue), `stop` (end) or `set` (player.rate, .pause, .step, .seek_s and so on)."""
        if control.command == "start":
            self.pause(False)
        elif control.command == "stop":
            self.end()
        elif control.command == "set":
            self._set(control.parameters)
        else:
            return super().on_control(control)
        return self.status()

    def status(self) -> str:
        span = f"replay at {self.playback.time_s:.3f} of {self.playback.length_s:.3f} s"
        rate = "as fast as possible" if self.playback_clock.rate == 0.0 else f"rate {self.playback_clock.rate:g}"
        parts = [span, rate, f"{self.sent} messages"]
        parts += ["loop"] * self.playback.loop + ["paused"] * self.playback_clock.paused
        parts += ["waiting for readers"] * (not self.started) + ["waiting for a slow reader"] * self.blocked
        return ", ".join(parts)

    def pause(self, paused: bool) -> None:
        self.playback_clock.change(self.clock.monotonic_ns(), self.playback.position_ns, paused=paused)

    def set_rate(self, rate: float) -> None:
        """Set the rate: 1 as recorded, 0 as fast as readers keep up; raise RefusedError if negative or nearly 0."""
        self._check_rate(rate)
        self.playback_clock.change(self.clock.monotonic_ns(), self.playback.position_ns, rate=rate)

    def step(self, count: int = 1) -> None:
        """Send the next `count` messages at once, then pause; raise RefusedError if `count` is below 1."""
        self._check_step(count)
        self.pause(True)
        self._steps = count

    def seek(self, time_s: float) -> None:
        """Jump to a time [s] from the start of the recording, and publish the state there."""
        self._jump(self.playback.seek(self.playback.at(time_s)))

    def seek_event(self) -> None:
        """Jump to the next session/event; raise RefusedError if there is none."""
        self._jump(self.playback.seek(self._next_event_ns()))

    def end(self) -> None:
        if not self.finished:
            self.finished = True
            self._publish_status("finished")
            self.context.request_stop()

    def _set(self, parameters: Mapping[str, Scalar]) -> None:
        unknown = sorted(set(parameters) - set(SETTERS))
        if unknown or not parameters:
            problem = f"{', '.join(unknown)} is unknown" if unknown else "set needs parameters"
            raise RefusedError(f"{problem}: known are {', '.join(SETTERS)}")
        for name, value in parameters.items():
            kinds = SETTERS[name][0]
            if type(value) not in kinds:
                raise RefusedError(f"{name} is {value!r}, a {kinds[0].__name__} is needed")
        # Do all checks first, so that a command is carried out as a whole or not at all.
        self._check_rate(float(parameters.get("player.rate", 1.0)))
        self._check_step(int(parameters.get("player.step", 1)))
        if parameters.get("player.next_event"):
            if parameters.keys() & {"player.seek_s", "player.skip_s"}:
                raise RefusedError("player.next_event and another place: give one of them")
            self._next_event_ns()
        ends = (parameters.get(name) for name in ("player.a_s", "player.b_s"))
        self.playback.limit(*(None if end is None else self.playback.at(float(end)) for end in ends))
        for name, (_, change) in SETTERS.items():
            if change is not None and name in parameters:
                change(self, parameters[name])

    def _check_rate(self, rate: float) -> None:
        if rate != 0.0 and not rate >= _LEAST_RATE:
            raise RefusedError(f"player.rate is {rate}, it must be 0 (as fast as possible), or {_LEAST_RATE:g} or more")

    def _check_step(self, count: int) -> None:
        if count < 1:
            raise RefusedError(f"player.step is {count}, it must be 1 or more")

    def _next_event_ns(self) -> int:
        next_ns = self.playback.next_event_ns()
        if next_ns is None:
            raise RefusedError(f"there is no event after {self.playback.time_s:.3f} s")
        return next_ns

    def _set_loop(self, loop: bool) -> None:
        self.playback.loop = loop

    def _due_ns(self) -> int | None:
        if self._pending_state or self._steps:
            return self.clock.monotonic_ns()
        return self.playback_clock.due_ns(self.playback.next_ns)

    def _play(self, now_ns: int) -> None:
        batch = _BATCH
        if self.playback_clock.rate == 0.0 and not self.playback_clock.paused:
            batch = _FAST_BATCH
            self.playback.read_ahead(batch)
        for _ in range(batch):
            if self._pending_state:
                if not self._send(self._pending_state[0]):
                    return
                self._pending_state.popleft()
                continue
            sent = self.playback.next()
            if sent is None:
                self._handle_end()
                return
            due = now_ns if self._steps else self.playback_clock.due_ns(sent.time_ns)
            if due is not None and due > now_ns:
                self._use_gap(due)
            if due is None or due > now_ns or not self._send(sent.message):
                return
            self.playback.advance(sent)
            if self._steps:
                self._steps -= 1

    def _use_gap(self, due_ns: int) -> None:
        """Do deferred work, piece by piece, while there is time before the next message is due."""
        while due_ns - self.clock.monotonic_ns() > _PIECE_NS:
            if self._deferred:
                self._deferred.popleft()()
            elif not self.playback.read_ahead():
                return

    def _send(self, message: RecordedMessage) -> bool:
        channel = message[0]
        route_of_channel = self._known.get(id(channel))
        if route_of_channel is None:
            route_of_channel = self._known[id(channel)] = channel, self._routes[channel]
        route = route_of_channel[1]
        payload = message.payload if route.as_recorded else route.payload(message, self.clock)
        self.blocked = not route.publisher.send(route.topic, payload)
        if self.blocked:
            self._retry_ns = self.clock.monotonic_ns() + _RETRY_NS
            return False
        route.sent(message)
        self.sent += 1
        self.steps += 1
        return True

    def _route(self, channel: RecordedChannel) -> Route:
        return Route(self._publishers[node_of(channel)], channel.topic, is_command=channel.topic == "session/control")

    def _handle_end(self) -> None:
        self._steps = 0
        if self.playback.loop:
            self._jump(self.playback.rewind())
        elif not self.playback_clock.paused:
            self.end()

    def _jump(self, state: Sequence[RecordedMessage]) -> None:
        self._note_jump()
        self._pending_state = deque(state)
        self.playback_clock.change(self.clock.monotonic_ns(), self.playback.position_ns)
        self._publish_status("moved")

    def _note_jump(self) -> None:
        # Reading from another position may create new channel objects, equal to the old ones.
        self._known.clear()
        for route in self._routes.values():
            route.jump()

    def _tick(self, now_ns: int) -> None:
        self._tick_ns = now_ns + _TICK_NS
        self._run_deferred()
        # A list, because `any` would stop before reading the subscriptions of all publishers.
        subscribed = [key for key, publisher in self._publishers.items() if publisher.read_subscriptions()]
        if not self.started:
            self._start_when_subscribed(now_ns)
        for key in subscribed:
            # Tell a new reader that this is a replay before it receives anything else.
            self._publish_health(self._publishers[key], 0.0, "running")
        if now_ns - self._health_ns >= HEALTH_PERIOD_NS:
            elapsed_s = (now_ns - self._health_ns) * 1e-9
            self._health_ns = now_ns
            self._deferred.extend(partial(self._publish_rate, key, elapsed_s) for key in self._publishers)
        if now_ns - self._progress_ns >= _PROGRESS_NS:
            self._progress_ns = now_ns
            self._deferred.append(partial(self._publish_status, "playing"))
        self._deferred.append(partial(self._observe, self))
        if not self.started or self.playback_clock.paused or self.playback_clock.rate == 0.0:
            self._run_deferred()

    def _run_deferred(self) -> None:
        """Do the work that found no gap between messages since the last tick."""
        while self._deferred:
            self._deferred.popleft()()

    def _start_when_subscribed(self, now_ns: int) -> None:
        unsubscribed = sorted(
            {
                channel.channel_topic
                for channel in self._plan.channels
                if is_state(channel) and not self._publishers[node_of(channel)].has_subscriber(channel.topic)
            }
        )
        if unsubscribed and now_ns < self._wait_until_ns:
            return
        self.started = True
        self.state = "running"
        for publisher in self._publishers.values():
            self._publish_health(publisher, 0.0, "running")
        self._pending_state.extend(self.playback.state())
        self._note_jump()
        self.playback_clock.change(self.clock.monotonic_ns(), self.playback.position_ns)
        if unsubscribed:
            self.event(
                "recording", "warning", f"no reader has subscribed to {', '.join(unsubscribed)}", state="unsubscribed"
            )
        for text in self._warnings:
            self.event("recording", "warning", text, state="warning")
        self._publish_status("started")

    def _publish_status(self, state: str) -> None:
        """Publish the position of the replay, the time of the recording, for nodes that follow it."""
        self.publish(
            "session/event",
            id="",
            kind="recording",
            level="info",
            text=self.status(),
            data={
                "state": state,
                "path": str(self.playback.recording.path),
                "time_s": self.playback.time_s,
                "time_ns": self.playback.position_ns,
                "rate": self.playback_clock.rate,
                "paused": self.playback_clock.paused,
            },
        )

    def _publish_rate(self, key: str, elapsed_s: float) -> None:
        publisher = self._publishers[key]
        rate_hz = (publisher.sent - self._reported[key]) / elapsed_s
        self._reported[key] = publisher.sent
        self._publish_health(publisher, rate_hz, "running")

    def _publish_health(self, publisher: ReplayPublisher, rate_hz: float, state: str) -> None:
        try:
            publisher.publisher.publish("node/health", **_health(state, rate_hz, self.clock, self._wait_until_ns))
        except zmq.Again:
            # The queue of a reader is full; it will get the next report.
            return


def _health(state: str, rate_hz: float, clock: Clock, begun_ns: int) -> dict[str, Any]:
    return {
        "pid": os.getpid(),
        "state": state,
        "uptime_s": max(0, clock.monotonic_ns() - begun_ns) * 1e-9,
        "rate_hz": rate_hz,
        "period_s": 0.0,
        "lateness_p50_s": 0.0,
        "lateness_p99_s": 0.0,
        "lateness_max_s": 0.0,
        "overruns": 0,
        "rejected": {},
        "cpu_percent": 0.0,
        "memory_bytes": resident_bytes(),
        "realtime": False,
        "memory_locked": False,
        "replay": True,
        "inputs": (),
    }


_NUMBER = (float, int)
# In the order in which the settings of one command are applied.
SETTERS: dict[str, tuple[tuple[type, ...], Callable[[PlayerNode, Any], None] | None]] = {
    "player.rate": (_NUMBER, lambda player, value: player.set_rate(float(value))),
    "player.loop": ((bool,), lambda player, value: player._set_loop(value)),
    # `_set` sets both ends of the loop together, before all others.
    "player.a_s": (_NUMBER, None),
    "player.b_s": (_NUMBER, None),
    "player.seek_s": (_NUMBER, lambda player, value: player.seek(value)),
    "player.skip_s": (_NUMBER, lambda player, value: player.seek(player.playback.time_s + value)),
    "player.next_event": ((bool,), lambda player, value: player.seek_event() if value else None),
    "player.step": ((int,), lambda player, value: player.step(value)),
    "player.pause": ((bool,), lambda player, value: player.pause(value)),
}
