"""The player: takes the place of nodes on their own endpoints and says once more what they said.

The bytes go out as they were recorded, times and numbers included. Only after a jump (seek, loop) the `seq` of each
message is moved, so that it goes on counting: readers would take an old number for a repetition and a gap for a loss.
"""

import os
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import msgpack
import zmq

from proto.errors import ConfigError, RefusedError
from proto.messages import Scalar, SessionControl
from proto.nodes import LINK
from recording.channel_filter import Selection
from recording.reader import RecordedChannel, RecordedMessage, Source
from services.player.playback import Playback, PlaybackClock, Span, is_state
from services.runtime.address_book import AddressBook
from services.runtime.bus import Publisher
from services.runtime.clock import Clock
from services.runtime.node import HEALTH_PERIOD_NS, Node, NodeContext, resident_bytes

# an observer of the rig and the player itself are no part of what is played
_NEVER_PLAYED = ("recorder", "player", "record")
_OWN_TOPICS = ("node/health", "node/journal")
_TICK_NS = 50_000_000
_PROGRESS_NS = 1_000_000_000
_RETRY_NS = 500_000
_BATCH = 256
_LINGER_MS = 10_000
_SUBSCRIBE = b"\x01"


@dataclass(frozen=True)
class PlaySettings:
    """How it is played; `wait_s` is how long to wait until every topic has a reader [s]."""

    rate: float = 1.0
    paused: bool = False
    wait_s: float = 1.0


def node_of(channel: RecordedChannel) -> str:
    """Give the node at whose endpoint a channel was heard; a recording that is not ours has none."""
    return f"{LINK}@{channel.site}" if channel.via == "link" else channel.src


class ReplayPlan:
    """Which nodes of the address book are played, and on which topic each channel goes out."""

    def __init__(
        self,
        recording: Source,
        book: AddressBook,
        selection: Selection,
        remap: Mapping[str, str] | None = None,
    ) -> None:
        """Choose; ConfigError names nodes that are not in the book, RecordingError follows from an empty choice.

        `remap` renames topics (channel name to topic) and moves nodes (node@site to node@site).
        """
        self._selection = selection
        self._remap = dict(remap or {})
        chosen = [channel for channel in recording.channels if self.plays(channel)]
        self.nodes = sorted({self.node(channel) for channel in chosen})
        absent = [node for node in self.nodes if node not in book.nodes]
        if absent:
            known = ", ".join(sorted(book.nodes))
            raise ConfigError(f"{recording.path}: {', '.join(absent)} is not in the site file, which has {known}")
        self.topics = {channel: self._topic(channel) for channel in chosen}

    def plays(self, channel: RecordedChannel) -> bool:
        """Say whether a channel is played.

        Health is not, because the player has its own to tell, nor a journal, because nobody takes those turns now.
        """
        node = node_of(channel)
        name = node.partition("@")[0]
        if not node or name in _NEVER_PLAYED or channel.topic in _OWN_TOPICS:
            return False
        by_node = not self._selection.nodes or any(test(node) for test in self._selection.nodes)
        return by_node and self._selection.names(channel.channel_topic)

    def node(self, channel: RecordedChannel) -> str:
        """Give the node whose endpoint a channel goes out on."""
        found = node_of(channel)
        return self._remap.get(found, found)

    def _topic(self, channel: RecordedChannel) -> str:
        return self._remap.get(channel.channel_topic, channel.topic)


class ReplayPublisher:
    """The endpoint of a node that is played: waits for slow readers instead of dropping, and knows its readers."""

    def __init__(self, publisher: Publisher) -> None:
        """Take a publisher made with `kind=zmq.XPUB`."""
        self.publisher = publisher
        self.sent = 0
        self.subscribed: set[bytes] = set()
        socket = publisher.socket
        # a full queue of a reader is then an error at once, and not a message that is silently dropped
        socket.set(zmq.XPUB_NODROP, 1)
        socket.set(zmq.XPUB_VERBOSE, 1)
        socket.set(zmq.SNDTIMEO, 0)
        socket.set(zmq.LINGER, _LINGER_MS)

    def send(self, topic: str, payload: bytes) -> bool:
        """Send bytes; False when a reader has no room for them, and nothing is sent to anybody."""
        try:
            self.publisher.send(topic, payload)
        except zmq.Again:
            return False
        self.sent += 1
        return True

    def newcomers(self) -> bool:
        """Take note of who listens to what; True when somebody has come since the last call."""
        came = False
        while self.publisher.socket.poll(0):
            message: bytes = self.publisher.socket.recv()
            if message.startswith(_SUBSCRIBE):
                self.subscribed.add(message[1:])
                came = True
            else:
                self.subscribed.discard(message[1:])
        return came

    def hears(self, topic: str) -> bool:
        """Say whether somebody listens to a topic."""
        name = topic.encode()
        return any(name.startswith(prefix) for prefix in self.subscribed)


class Numbering:
    """Keeps the numbers of each channel growing by one over the jumps of a replay."""

    def __init__(self) -> None:
        self._offsets: dict[RecordedChannel, int] = {}
        self._last: dict[RecordedChannel, int] = {}
        self._jumped: set[RecordedChannel] = set()

    def jump(self) -> None:
        """Take note that what comes next does not follow what came last."""
        self._jumped = set(self._last)

    def payload(self, message: RecordedMessage) -> bytes:
        """Give the bytes to send: the recorded ones, unless there was a jump."""
        channel = message.channel
        if channel in self._jumped:
            self._offsets[channel] = self._last[channel] + 1 - message.seq
        offset = self._offsets.get(channel, 0)
        if offset == 0:
            return message.payload
        fields = message.fields()
        fields["seq"] = message.seq + offset
        packed: bytes = msgpack.packb(fields)
        return packed

    def sent(self, message: RecordedMessage) -> None:
        """Take note that a message went out."""
        channel = message.channel
        self._jumped.discard(channel)
        self._last[channel] = message.seq + self._offsets.get(channel, 0)


class PlayerNode(Node):
    """Plays a tape through the outlets, at the command of session/control and of whoever holds it."""

    inputs: ClassVar[tuple[str, ...]] = ("session/control",)
    replay = True

    def __init__(
        self,
        context: NodeContext,
        tape: Playback,
        parts: ReplayPlan,
        outlets: Mapping[str, ReplayPublisher],
        settings: PlaySettings,
        *,
        observe: Callable[["PlayerNode"], None] = lambda player: None,
    ) -> None:
        """Prepare to play; `observe` is called twenty times a second, for a status line and keys."""
        super().__init__(context)
        self.tape = tape
        self.finish: Callable[[], None] = lambda: None
        self.finished = False
        self.started = False
        self.blocked = False
        self.sent = 0
        now = self.clock.monotonic_ns()
        self.transport = PlaybackClock(now, tape.position_ns, settings.rate, paused=settings.paused)
        self._cast = parts
        self._outlets = outlets
        self._observe = observe
        self._numbering = Numbering()
        self._first: deque[RecordedMessage] = deque()
        self._steps = 0
        self._step_topic = ""
        self._wait_until_ns = now + round(settings.wait_s * 1e9)
        self._tick_ns = now
        self._retry_ns = 0
        self._health_ns = now
        self._progress_ns = now
        self._reported = dict.fromkeys(outlets, 0)

    def on_message(self, received: object) -> None:
        """Nothing is left to do: commands come through `on_control`."""

    def deadline_ns(self) -> int:
        """Give the time of the next message or of the next look at keys and readers [ns]."""
        if not self.started or self.finished:
            return self._tick_ns
        if self.blocked:
            return min(self._tick_ns, self._retry_ns)
        due = self._due_ns()
        return self._tick_ns if due is None else min(self._tick_ns, due)

    def on_deadline(self, now_ns: int) -> None:
        """Send what is due."""
        if now_ns >= self._tick_ns:
            self._tick(now_ns)
        if self.started and not self.finished:
            self._play(now_ns)

    def make_safe(self) -> None:
        """Tell those who listened that the replay is over."""
        for outlet in self._outlets.values():
            self._publish_health(outlet, 0.0, "stopping")

    def on_control(self, control: SessionControl) -> str:
        """Play on, end, or change what `set` names: player.rate, .pause, .step, .seek_s and so on."""
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
        """Say in a line where the replay stands."""
        span = f"replay at {self.tape.time_s:.3f} of {self.tape.length_s:.3f} s"
        rate = "as fast as possible" if self.transport.rate == 0.0 else f"rate {self.transport.rate:g}"
        words = [span, rate, f"{self.sent} messages"]
        words += ["loop"] * self.tape.loop + ["paused"] * self.transport.paused
        words += ["waiting for readers"] * (not self.started) + ["waiting for a slow reader"] * self.blocked
        return ", ".join(words)

    def pause(self, paused: bool) -> None:
        """Stop or go on."""
        self.transport.change(self.clock.monotonic_ns(), self.tape.position_ns, paused=paused)

    def set_rate(self, rate: float) -> None:
        """Play at a rate from now on: 1 as recorded, 0 as fast as readers keep up; RefusedError when negative."""
        if not rate >= 0.0:
            raise RefusedError(f"player.rate is {rate}, it must be 0 (as fast as possible) or more")
        self.transport.change(self.clock.monotonic_ns(), self.tape.position_ns, rate=rate)

    def step(self, count: int = 1, topic: str = "") -> None:
        """Send the next messages at once and be paused: so many, or up to the next one on a topic."""
        if count < 1:
            raise RefusedError(f"player.step is {count}, it must be 1 or more")
        if topic and topic not in {channel.channel_topic for channel in self._cast.topics}:
            raise RefusedError(f"player.step_topic: {topic} is not played")
        self.pause(True)
        self._steps, self._step_topic = count, topic

    def seek(self, time_s: float) -> None:
        """Go to a time [s] from the start of the recording, and tell readers the state there."""
        self._jump(self.tape.seek(self.tape.at(time_s)))

    def seek_event(self) -> None:
        """Go to the next session/event; RefusedError when there is none."""
        found = self.tape.next_event_ns()
        if found is None:
            raise RefusedError(f"there is no event after {self.tape.time_s:.3f} s")
        self._jump(self.tape.seek(found))

    def end(self) -> None:
        """End the replay."""
        if not self.finished:
            self.finished = True
            self._tell("finished")
            self.finish()

    def _set(self, parameters: Mapping[str, Scalar]) -> None:
        unknown = sorted(set(parameters) - set(_SETTERS))
        if unknown or not parameters:
            named = f"{', '.join(unknown)} is unknown" if unknown else "set needs parameters"
            raise RefusedError(f"{named}: known are {', '.join(_SETTERS)}")
        for name, setter in _SETTERS.items():
            if name in parameters:
                kinds, change = setter
                value = parameters[name]
                if type(value) not in kinds:
                    raise RefusedError(f"{name} is {value!r}, a {kinds[0].__name__} is needed")
                change(self, value)

    def _set_bounds(self, start_s: float | None = None, end_s: float | None = None) -> None:
        start, end = (None if value is None else self.tape.at(value) for value in (start_s, end_s))
        self.tape.limit(start, end)

    def _set_loop(self, loop: bool) -> None:
        self.tape.loop = loop

    def _due_ns(self) -> int | None:
        if self._first or self._steps:
            return self.clock.monotonic_ns()
        message = self.tape.peek()
        return self.transport.due_ns(self.tape.end_ns if message is None else message.log_ns)

    def _play(self, now_ns: int) -> None:
        for _ in range(_BATCH):
            if self._first:
                if not self._send(self._first[0]):
                    return
                self._first.popleft()
                continue
            message = self.tape.peek()
            if message is None:
                self._at_the_end()
                return
            due = now_ns if self._steps else self.transport.due_ns(message.log_ns)
            if due is None or due > now_ns or not self._send(message):
                return
            self.tape.take()
            self._count_step(message)

    def _count_step(self, message: RecordedMessage) -> None:
        if self._steps and self._step_topic in ("", message.channel_topic):
            self._steps -= 1

    def _send(self, message: RecordedMessage) -> bool:
        channel = message.channel
        outlet = self._outlets[self._cast.node(channel)]
        payload = self._numbering.payload(message)
        self.blocked = not outlet.send(self._cast.topics[channel], payload)
        if self.blocked:
            self._retry_ns = self.clock.monotonic_ns() + _RETRY_NS
            return False
        self._numbering.sent(message)
        self.sent += 1
        self.steps += 1
        return True

    def _at_the_end(self) -> None:
        self._steps = 0
        if self.tape.loop:
            self._jump(self.tape.rewind())
        elif not self.transport.paused:
            self.end()

    def _jump(self, state: Sequence[RecordedMessage]) -> None:
        self._numbering.jump()
        self._first = deque(state)
        self.transport.change(self.clock.monotonic_ns(), self.tape.position_ns)
        self._tell("moved")

    def _tick(self, now_ns: int) -> None:
        self._tick_ns = now_ns + _TICK_NS
        # an empty list first: `any` would leave the others unread
        came = [key for key, outlet in self._outlets.items() if outlet.newcomers()]
        if not self.started:
            self._start_when_heard(now_ns)
        elapsed_s = (now_ns - self._health_ns) * 1e-9
        if now_ns - self._health_ns >= HEALTH_PERIOD_NS:
            self._health_ns = now_ns
            self._health_of_all(elapsed_s)
        for key in came:
            # whoever comes learns what it is before it hears anything else
            self._publish_health(self._outlets[key], 0.0, "running")
        if now_ns - self._progress_ns >= _PROGRESS_NS:
            self._progress_ns = now_ns
            self._tell("playing")
        self._observe(self)

    def _start_when_heard(self, now_ns: int) -> None:
        unheard = sorted(
            {
                channel.channel_topic
                for channel, topic in self._cast.topics.items()
                if is_state(channel) and not self._outlets[self._cast.node(channel)].hears(topic)
            }
        )
        if unheard and now_ns < self._wait_until_ns:
            return
        self.started = True
        self.state = "running"
        for outlet in self._outlets.values():
            self._publish_health(outlet, 0.0, "running")
        self._first.extend(self.tape.state_at(self.tape.start_ns))
        self._numbering.jump()
        self.transport.change(self.clock.monotonic_ns(), self.tape.position_ns)
        if unheard:
            self.event("recording", "warning", f"nobody listens to {', '.join(unheard)}", state="unheard")
        self._tell("started")

    def _tell(self, what: str) -> None:
        """Publish where the replay stands: the clock of the recording, for whoever follows it."""
        self.publish(
            "session/event",
            id="",
            kind="recording",
            level="info",
            text=self.status(),
            data={
                "state": what,
                "path": str(self.tape.recording.path),
                "time_s": self.tape.time_s,
                "time_ns": self.tape.position_ns,
                "rate": self.transport.rate,
                "paused": self.transport.paused,
            },
        )

    def _health_of_all(self, elapsed_s: float) -> None:
        for key, outlet in self._outlets.items():
            rate = (outlet.sent - self._reported[key]) / elapsed_s
            self._reported[key] = outlet.sent
            self._publish_health(outlet, rate, "running")

    def _publish_health(self, outlet: ReplayPublisher, rate_hz: float, state: str) -> None:
        try:
            outlet.publisher.publish("node/health", **_health(state, rate_hz, self.clock, self._wait_until_ns))
        except zmq.Again:
            # a reader is behind: it gets the next one
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
# in the order in which they are carried out when one command names several
_SETTERS: dict[str, tuple[tuple[type, ...], Callable[[PlayerNode, Any], None]]] = {
    "player.rate": (_NUMBER, lambda player, value: player.set_rate(float(value))),
    "player.loop": ((bool,), lambda player, value: player._set_loop(value)),
    "player.a_s": (_NUMBER, lambda player, value: player._set_bounds(start_s=value)),
    "player.b_s": (_NUMBER, lambda player, value: player._set_bounds(end_s=value)),
    "player.seek_s": (_NUMBER, lambda player, value: player.seek(value)),
    "player.skip_s": (_NUMBER, lambda player, value: player.seek(player.tape.time_s + value)),
    "player.next_event": ((bool,), lambda player, value: player.seek_event() if value else None),
    "player.step": ((int,), lambda player, value: player.step(value)),
    "player.step_topic": ((str,), lambda player, value: player.step(topic=value)),
    "player.pause": ((bool,), lambda player, value: player.pause(value)),
}


def open_tape(recording: Source, parts: ReplayPlan, span: Span) -> Playback:
    """Give the tape of what the cast plays."""
    return Playback(recording, parts.plays, span)
