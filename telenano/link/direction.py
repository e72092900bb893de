"""One direction of the link: messages with arrival times in, messages with release times out.

It uses neither a clock nor a socket. All times are integer nanoseconds of one clock that the caller reads. The fate of
a message depends only on the settings, the seed and the sequence of (arrival time, topic, size), not on the times at
which the caller asks for due messages. Order of the stages: outage, loss, corruption, duplication, queue and rate,
delay, order, slots.
"""

from collections.abc import Iterable, Sequence
from heapq import heappop, heappush
from pathlib import Path
from typing import NamedTuple

from telenano.link.fate import Direction, DirectionStats, Fate, Figures, Release, delayed
from telenano.link.models.jitter import RandomDelay
from telenano.link.models.outages import Outages
from telenano.link.models.queueing import ServedQueue, Waiting
from telenano.link.pipeline import InFlight, Pipeline, PipelineState, SharedModels, TopicPipeline
from telenano.settings.link_files import OWN_TRACES, Files, Traces, read_files
from telenano.settings.link_settings import DirectionSettings, LinkSettings
from telenano.wire.node_state import FindInput

# One day: no setting exceeds an hour, but a heavy-tailed distribution may draw any value.
_LONGEST_DELAY_NS = 86_400_000_000_000


class QueuedMessage(NamedTuple):
    """A message that waits in a queue, with the fields of `InFlight`; `damaged` is the payload if bits were flipped."""

    topic: str
    size_bytes: int
    order: int
    seq: int
    copy: int
    damaged: bytes
    arrived_ns: int
    ready_ns: int
    delay_ns: int
    gated: bool
    duplicated: bool
    corrupted: bool
    src: str


class DirectionState(NamedTuple):
    """The state of a direction.

    topics: the topics of messages so far; in_flight: release time of each message [ns], its rank among equal times, its
    payload if bits were flipped (else empty), and its fate; waiting: queued messages by the pattern of their block.
    """

    now_ns: int
    arrivals: int
    pushed: int
    figures: Figures
    topics: list[str]
    pipeline: PipelineState
    fates: list[Fate]
    in_flight: list[tuple[int, int, bytes, Fate]]
    waiting: dict[str, list[QueuedMessage]]


class DirectionEngine:
    """One direction of the link.

    The times passed to it should not decrease: a message with an earlier time than the previous one counts as arriving
    together with that one.
    """

    def __init__(
        self,
        direction: Direction,
        settings: LinkSettings,
        start_ns: int,
        *,
        folder: Path = Path(),
        traces: Traces = OWN_TRACES,
    ) -> None:
        """Start with settings whose files are searched in `folder`; `start_ns` is the origin of their times [ns].

        `traces` reads the files.

        The caller must call `take_fates` regularly, because fates are kept until then.

        Raises:
            ConfigError: A file cannot be used; the message names file and line.
        """
        self._direction: Direction = direction
        self._folder, self._traces = folder, traces
        self._fates: list[Fate] = []
        self._heap: list[tuple[int, int, Release]] = []
        self._now_ns = start_ns
        self._arrivals = 0
        self._pushed = 0
        self._figures = Figures()
        self._pipeline = Pipeline(direction, settings, self.files_of(settings), start_ns)
        self._note_models()

    def submit(
        self, now_ns: int, topic: str, payload: bytes, seq: int, src: str = "", *, at_once: bool = False
    ) -> Sequence[Release]:
        """Accept a message that arrived at `now_ns` [ns], and return all messages that are due now, in order.

        With `at_once` the message is not impaired, held or delayed.
        """
        if now_ns < self._now_ns:
            now_ns = self._now_ns
        self._now_ns = now_ns
        pipeline = self._topics.get(topic) or self._pipeline.open(topic)
        self._figures.messages_in += 1
        self._figures.bytes_in += len(payload)
        self._arrivals += 1
        if self._queues:
            self._advance(now_ns)
        constant_ns = 0 if at_once else pipeline.constant_ns
        if constant_ns is None:
            self._impair(pipeline, now_ns, payload, seq, src)
        elif (release := self._delay(pipeline, constant_ns, now_ns, payload, seq, src)) is not None:
            return (release,)
        heap = self._heap
        return self.due(now_ns) if heap and heap[0][0] <= now_ns else ()

    def leave_out(self, now_ns: int, topic: str, payload: bytes, seq: int, src: str, cause: str) -> None:
        """Drop a message that arrived at `now_ns` [ns] for a cause other than an impairment, and record it as fate."""
        pipeline = self._topics.get(topic) or self._pipeline.open(topic)
        self._figures.messages_in += 1
        self._figures.bytes_in += len(payload)
        self._arrivals += 1
        message = InFlight(
            pipeline=pipeline,
            order=self._arrivals,
            seq=seq,
            copy=0,
            payload=payload,
            arrived_ns=now_ns,
            ready_ns=now_ns,
            src=src,
        )
        self._drop(message, cause)

    @classmethod
    def fates(
        cls,
        settings: LinkSettings,
        direction: Direction,
        topic: str,
        arrivals_ns: Iterable[int],
        size_bytes: int,
        *,
        folder: Path = Path(),
    ) -> list[Fate]:
        """Return the fate of each message of a stream, and of each copy, sorted by seq.

        Simulations use it to know the delays of the link in advance. seq counts from 0; the first arrival is the origin
        of traces and schedules and the start of the session.

        Args:
            settings: The settings of the link.
            direction: The direction of the stream.
            topic: The topic of the messages.
            arrivals_ns: Arrival time of each message at the link, not decreasing [ns].
            size_bytes: Size of each message.
            folder: The folder in which the files of the settings are searched.

        Raises:
            ConfigError: A file cannot be used.
        """
        arrivals = list(arrivals_ns)
        if not arrivals:
            return []
        engine = cls(direction, settings, arrivals[0], folder=folder)
        engine.begin_session(arrivals[0])
        for seq, arrived_ns in enumerate(arrivals):
            engine.submit(arrived_ns, topic, bytes(size_bytes), seq)
        while (next_ns := engine.next_release_ns()) is not None:
            engine.due(next_ns)
        return sorted(engine.take_fates(), key=lambda fate: (fate.seq, fate.copy))

    def draw_losses(self, topic: str, count: int) -> list[bool]:
        """Return the loss of each of the next `count` messages of a topic, under settings with only loss and delay."""
        pipeline = self._topics.get(topic) or self._pipeline.open(topic)
        return [pipeline.lost_by(self._now_ns, 0) != "" for _ in range(count)]

    def due(self, now_ns: int) -> list[Release]:
        """Return the messages whose release time has come by `now_ns`, in order of release."""
        if self._queues:
            self._advance(now_ns)
        heap = self._heap
        released: list[Release] = []
        while heap and heap[0][0] <= now_ns:
            release = heappop(heap)[2]
            self._figures.count_release(release.fate.delay_ns, release.fate.size_bytes)
            released.append(release)
        return released

    def next_release_ns(self) -> int | None:
        """Return the next time at which to call `due` [ns]; None if nothing is in flight. Nothing is due earlier."""
        next_ns = self._heap[0][0] if self._heap else None
        for queue in self._queues:
            leave_ns = queue.leave_ns
            if leave_ns is not None and (next_ns is None or leave_ns < next_ns):
                next_ns = leave_ns
        return next_ns

    def take_fates(self) -> list[Fate]:
        """Return and remove the fates decided since the last call, in the order of decision."""
        taken, self._fates = self._fates, []
        return taken

    def stats(self) -> DirectionStats:
        """Return the live figures; those of the delays are reset by each call."""
        return self._figures.take(sum(len(queue) for queue in self._queues), len(self._heap))

    def files_of(self, settings: LinkSettings) -> dict[str, Files]:
        """Read the files that the settings name; this is the first half of a change, which may fail.

        Raises:
            ConfigError: A file cannot be used; the message names file and line.
            LaterError: A file is being read.
        """
        direction: DirectionSettings = getattr(settings, self._direction)
        return read_files(direction, self._folder, self._direction, self._traces)

    def adopt(self, settings: LinkSettings, files: dict[str, Files], now_ns: int) -> None:
        """Apply settings to the messages that arrive from now on; the second half of a change, which cannot fail.

        Messages in flight keep their fate. A model whose own settings are unchanged continues (`carry_over`); a new or
        changed one begins its course (outage schedule, trace, slots) now.
        """
        now_ns = self._now_ns = max(self._now_ns, now_ns)
        self._advance(now_ns)
        before = self._pipeline.shared_models
        self._pipeline.adopt(settings, files, now_ns)
        self._note_models()
        # Queued messages move to the new queue of their block, unless topics may have moved between blocks.
        next_of = self._pipeline.shared_models
        may_wait_on = tuple(before) == tuple(next_of)
        for pattern, shared in before.items():
            if shared.queue is not None:
                self._hand_over(shared.queue, next_of.get(pattern), now_ns, may_wait_on=may_wait_on)

    def _hand_over(
        self, queue: ServedQueue[InFlight], block: SharedModels | None, now_ns: int, *, may_wait_on: bool
    ) -> None:
        """Take over the messages that wait in a queue of the previous settings, unless the queue continues.

        Messages that only wait for the end of an outage wait on in the queue of the same block. Other messages are sent
        by the old server, and the new one begins after them.

        Args:
            queue: The queue under the previous settings.
            block: The present models of the same block; None for a block that no longer exists.
            now_ns: Time at which the settings come into force [ns].
            may_wait_on: Whether each block still has the same topics.
        """
        _hold_again(queue, None if block is None else block.outages, now_ns)
        successor = None if block is None else block.queue
        if any(queue is kept for kept in self._queues):
            return
        if queue.is_instant and successor is not None and may_wait_on:
            successor.refill(queue.waiting)
            return
        while queue.leave_ns is not None:
            message, sent_ns = queue.pop()
            self._schedule(message, sent_ns, now_ns)
        if successor is not None:
            successor.wait_until(queue.free_ns)

    def begin_session(self, now_ns: int) -> None:
        """Begin a session at `now_ns` [ns], the origin of schedules that are given in session time."""
        self._pipeline.begin_session(now_ns)
        for shared in self._pipeline.shared_models.values():
            if shared.queue is not None:
                _hold_again(shared.queue, shared.outages, now_ns)

    def capture(self) -> DirectionState:
        """Return the state; raise ValueError while a message waits under an order or slots no longer in force."""
        return DirectionState(
            now_ns=self._now_ns,
            arrivals=self._arrivals,
            pushed=self._pushed,
            figures=self._figures,
            topics=list(self._topics),
            pipeline=self._pipeline.capture(),
            fates=self._fates,
            in_flight=[
                (release_ns, pushed, release.payload if release.fate.corrupted else b"", release.fate)
                for release_ns, pushed, release in self._heap
            ],
            waiting={
                pattern: [self._captured(entry.item) for entry in shared.queue.waiting]
                for pattern, shared in self._pipeline.shared_models.items()
                if shared.queue is not None
            },
        )

    def restore(self, state: DirectionState, settings: LinkSettings, find: FindInput) -> None:
        """Continue from a state that was captured under these settings; `find` returns payloads from a recording.

        Raises:
            ConfigError: A file cannot be used.
            KeyError: The state does not fit this engine; ValueError and TypeError mean the same.
        """
        files = self.files_of(settings)
        pipeline = self._pipeline = Pipeline(self._direction, settings, files, 0)
        for topic in state.topics:
            pipeline.open(topic)
        pipeline.restore(state.pipeline, settings, files)
        self._note_models()
        self._now_ns, self._arrivals, self._pushed = state.now_ns, state.arrivals, state.pushed
        self._figures, self._fates = state.figures, state.fates
        # The entries are in the order of the heap, so the list is a heap again.
        self._heap = []
        for release_ns, pushed, damaged, fate in state.in_flight:
            payload = damaged or find(fate.topic, fate.src, fate.seq, fate.arrived_ns, fate.size_bytes)
            self._heap.append((release_ns, pushed, Release(fate.topic, payload, fate)))
        for pattern, waiting in state.waiting.items():
            queue = pipeline.shared_models[pattern].queue
            if queue is None:
                raise ValueError(
                    f"{pattern or 'the direction'}: messages waited in a queue, and the settings have none"
                )
            queue.refill(_waiting(self._restored(message, find)) for message in waiting)

    def _captured(self, message: InFlight) -> QueuedMessage:
        pipeline, order, seq, copy, payload, *rest = message
        topic, now = pipeline.topic, self._topics[pipeline.topic]
        # The processing of a message after the queue depends only on these settings.
        if (pipeline.ordered, pipeline.shared.slot_gate) != (now.ordered, now.shared.slot_gate):
            raise ValueError(f"a message on {topic} waits under an order or slots that are no longer in force")
        damaged = payload if message.corrupted else b""
        return QueuedMessage._make((topic, len(payload), order, seq, copy, damaged, *rest))

    def _restored(self, queued: QueuedMessage, find: FindInput) -> InFlight:
        topic, size_bytes, *rest = queued
        message = InFlight._make((self._topics[topic], *rest))
        payload = message.payload or find(topic, message.src, message.seq, message.arrived_ns, size_bytes)
        return message._replace(payload=payload)

    def _note_models(self) -> None:
        """Cache the open topics and the queues after either may have changed."""
        self._topics = self._pipeline.topics
        shared_models = self._pipeline.shared_models.values()
        self._queues = [shared.queue for shared in shared_models if shared.queue is not None]

    def _delay(
        self, pipeline: TopicPipeline, delay_ns: int, now_ns: int, payload: bytes, seq: int, src: str
    ) -> Release | None:
        """Pass a message through a constant delay; return it if the delay is zero and nothing is due before it.

        This case of a plain bridge is kept short, because it must carry 6000 messages a second.
        """
        release_ns = now_ns + delay_ns
        latest_release = pipeline.latest_release
        # The delay may have been shortened while messages are in flight.
        reordered = release_ns < latest_release.latest_ns
        if reordered:
            self._figures.reordered += 1
        else:
            latest_release.latest_ns = release_ns
            latest_release.order = self._arrivals
        size_bytes = len(payload)
        fate = delayed(
            direction=self._direction,
            topic=pipeline.topic,
            seq=seq,
            size_bytes=size_bytes,
            arrived_ns=now_ns,
            release_ns=release_ns,
            delay_ns=delay_ns,
            reordered=reordered,
            src=src,
        )
        self._fates.append(fate)
        release = Release(pipeline.topic, payload, fate)
        heap = self._heap
        if delay_ns == 0 and not (heap and heap[0][0] <= now_ns):
            self._figures.count_release(0, size_bytes)
            return release
        self._pushed += 1
        heappush(heap, (release_ns, self._pushed, release))
        return None

    def _impair(self, pipeline: TopicPipeline, now_ns: int, payload: bytes, seq: int, src: str) -> None:
        # All draws come first, because whether one model draws must not depend on the decision of another.
        applies = pipeline.applies is None or pipeline.applies()
        number = pipeline.next_number()
        lost_by = pipeline.lost_by(now_ns, number)
        corrupted = pipeline.corruptor is not None and pipeline.corruptor.happens() and len(payload) > 0
        duplicated = pipeline.duplicates is not None and pipeline.duplicates()
        overtakes = pipeline.overtakes is not None and pipeline.overtakes()
        fixed_ns = pipeline.fixed_delay_ns(now_ns, number)
        delay_ns = _random_delay_ns(fixed_ns, pipeline.jitter, now_ns)
        copy_ns = _random_delay_ns(fixed_ns, pipeline.copy_jitter, now_ns)

        shared = pipeline.shared
        message = InFlight(
            pipeline=pipeline,
            order=self._arrivals,
            seq=seq,
            copy=0,
            payload=payload,
            arrived_ns=now_ns,
            ready_ns=now_ns,
            src=src,
        )
        if not applies:
            self._enqueue(message, bypass=True)
            return
        end_ns = None if shared.outages is None else shared.outages.end_ns(now_ns)
        if end_ns is not None and shared.settings.outage.mode == "drop" and not pipeline.reliable:
            lost_by = "outage"
        if lost_by:
            self._drop(message, lost_by)
            return
        if corrupted and pipeline.corruptor is not None:
            payload = pipeline.corruptor.corrupt(payload)
        message = message._replace(
            payload=payload,
            ready_ns=now_ns if end_ns is None else end_ns,
            delay_ns=0 if overtakes else delay_ns,
            gated=True,
            duplicated=duplicated,
            corrupted=corrupted,
        )
        self._figures.corrupted += corrupted
        self._figures.duplicated += duplicated
        # During an outage no message overtakes, so that the queue bounds all messages that are held.
        self._enqueue(message, bypass=overtakes and end_ns is None)
        if duplicated:
            self._enqueue(message._replace(copy=1, delay_ns=copy_ns, duplicated=False), bypass=False)

    def _enqueue(self, message: InFlight, *, bypass: bool) -> None:
        """Put a message into the queue, or schedule it at once if there is no queue or the message bypasses it."""
        pipeline = message.pipeline
        queue = pipeline.shared.queue
        # If messages are ordered, none bypasses the queue, not even one that is not impaired.
        ready_ns = message.ready_ns
        if (
            queue is None
            or (bypass and not pipeline.ordered)
            or (ready_ns == message.arrived_ns and queue.is_open(ready_ns))
        ):
            past_queue = queue is not None and queue.holds_before(pipeline.topic, message.order)
            self._schedule(message, ready_ns, message.arrived_ns, past_queue=past_queue)
            return
        for dropped in queue.push(_waiting(message)):
            self._drop(dropped, "queue")
        self._advance(message.arrived_ns)

    def _advance(self, now_ns: int) -> None:
        """Decide the fate of every message that has left its queue by `now_ns`, in order of leaving."""
        while True:
            # The earliest of all queues first, so that the result does not depend on how often this is called.
            foremost, reached_ns = None, now_ns
            for queue in self._queues:
                leave_ns = queue.leave_ns
                if leave_ns is not None and (leave_ns < reached_ns or (leave_ns == reached_ns and foremost is None)):
                    foremost, reached_ns = queue, leave_ns
            if foremost is None:
                return
            message, sent_ns = foremost.pop()
            self._schedule(message, sent_ns, reached_ns)

    def _schedule(self, message: InFlight, sent_ns: int, reached_ns: int, *, past_queue: bool = False) -> None:
        """Determine the release time of a message sent at `sent_ns`; no later message is sent before `reached_ns`.

        `past_queue`: the message has overtaken messages of its topic in the queue.
        """
        pipeline = message.pipeline
        release_ns = sent_ns + message.delay_ns
        for before in pipeline.ordered:
            release_ns = max(release_ns, before.latest_ns)
        if pipeline.shared.slot_gate is not None and message.gated:
            release_ns = pipeline.shared.slot_gate.slot_ns(reached_ns, release_ns, len(message.payload))
        reordered = past_queue or (
            release_ns < pipeline.latest_release.latest_ns and pipeline.latest_release.order < message.order
        )
        self._figures.reordered += reordered
        if release_ns > pipeline.latest_release.latest_ns:
            pipeline.latest_release.latest_ns, pipeline.latest_release.order = release_ns, message.order
        for before in pipeline.ordered:
            before.latest_ns = release_ns
        fate = _fate(self._direction, message)._replace(
            release_ns=release_ns,
            delay_ns=release_ns - message.arrived_ns,
            queue_ns=sent_ns - message.ready_ns,
            held_ns=message.ready_ns - message.arrived_ns,
            reordered=reordered,
        )
        self._fates.append(fate)
        self._pushed += 1
        heappush(self._heap, (release_ns, self._pushed, Release(pipeline.topic, message.payload, fate)))

    def _drop(self, message: InFlight, cause: str) -> None:
        self._figures.dropped[cause] = self._figures.dropped.get(cause, 0) + 1
        self._fates.append(_fate(self._direction, message)._replace(dropped=cause))


def _random_delay_ns(fixed_ns: int, jitter: RandomDelay | None, now_ns: int) -> int:
    # A delay that a wide jitter makes negative is limited to zero: no network delivers before it has received.
    return fixed_ns if jitter is None else min(max(0, round(fixed_ns + jitter(now_ns))), _LONGEST_DELAY_NS)


def _hold_again(queue: ServedQueue[InFlight], outages: Outages | None, now_ns: int) -> None:
    """Let the messages that wait for the end of an outage wait for the end of the present outage, if there is one."""
    if any(entry.ready_ns > now_ns for entry in queue.waiting):
        end_ns = (None if outages is None else outages.end_ns(now_ns)) or now_ns
        queue.refill(
            entry if entry.ready_ns <= now_ns else _waiting(entry.item._replace(ready_ns=end_ns))
            for entry in queue.waiting
        )


def _waiting(message: InFlight) -> Waiting[InFlight]:
    topic, reliable = message.pipeline.topic, message.pipeline.reliable
    return Waiting(
        ready_ns=message.ready_ns,
        size_bytes=len(message.payload),
        topic=topic,
        reliable=reliable,
        order=message.order,
        item=message,
    )


def _fate(direction: Direction, message: InFlight) -> Fate:
    """Return the fate of a message as far as it is known before its release is decided."""
    return Fate(
        direction=direction,
        topic=message.pipeline.topic,
        seq=message.seq,
        copy=message.copy,
        size_bytes=len(message.payload),
        arrived_ns=message.arrived_ns,
        duplicated=message.duplicated,
        corrupted=message.corrupted,
        src=message.src,
    )
