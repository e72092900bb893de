"""Construction of the models from the settings: the pipeline of each topic, also after a change of settings.

Loss, delay, duplication, corruption and reordering belong to a topic. Queue, slots, outages and the origin of traces
belong to a block of settings and are shared by all topics under it (`carry_over`).
"""

import math
from collections.abc import Callable, Sequence
from typing import NamedTuple

import msgspec

from telenano.link.carry_over import ModelDefinition, ModelTable
from telenano.link.fate import Direction
from telenano.link.models.courses import delay_at, lost_at
from telenano.link.models.events import Corruptor, Overtaking
from telenano.link.models.jitter import JitterSource, RandomDelay
from telenano.link.models.loss import GilbertElliottChain, MarkovLossChain
from telenano.link.models.outages import NO_SESSION_NS, Outages
from telenano.link.models.queueing import DeliveryServer, RateServer, ServedQueue, Server, SlotGate
from telenano.link.random_streams import Occurrence, RandomStream, stream
from telenano.settings.link_files import Files
from telenano.settings.link_settings import DirectionSettings, Impairment, Jitter, LinkSettings, Outage, Slots
from telenano.wire.node_state import Part, part

NS_PER_S = 1_000_000_000


class LatestRelease(msgspec.Struct, eq=False, array_like=True):
    """Latest release time of a topic or of an ordered group [ns], and the order of arrival of that message."""

    latest_ns: int = -1
    order: int = -1


class MessageCount:
    """Number of the next message under a block of settings, for traces that go by message number."""

    __slots__ = ("state",)

    def __init__(self) -> None:
        self.state = 0


class SharedModels(NamedTuple):
    """Models shared by the topics under the same settings; None represents a model that does nothing."""

    settings: Impairment
    files: Files
    latest_release: LatestRelease
    course_origin_ns: int
    losses_origin_ns: int
    counter: "MessageCount | None"
    queue: "ServedQueue[InFlight] | None"
    slot_gate: SlotGate | None
    outages: Outages | None
    lasting_jitter: RandomDelay | None  # one whose correlation is over time belongs to the line


class TopicPipeline(NamedTuple):
    """The models that a topic goes through; None represents a model that does nothing."""

    topic: str
    shared: SharedModels
    reliable: bool
    latest_release: LatestRelease
    ordered: tuple[LatestRelease, ...]  # no message may be released before the latest of these
    fixed_ns: int
    constant_ns: int | None  # the whole effect, if it is a constant delay and nothing else
    applies: Occurrence | None
    losses: tuple[tuple[str, Callable[[], bool]], ...]
    corruptor: Corruptor | None
    duplicates: Occurrence | None
    overtakes: Overtaking | None
    jitter: RandomDelay | None
    copy_jitter: RandomDelay | None

    def next_number(self) -> int:
        """Return the number of a message that arrives now; 0 without a counter. Reliable messages do not count."""
        counter = self.shared.counter
        if counter is None:
            return 0
        number = counter.state
        if not self.reliable:
            counter.state += 1
        return number

    def fixed_delay_ns(self, now_ns: int, number: int) -> int:
        """Return the fixed delay plus that of the trace [ns], for a message with this arrival time [ns] and number."""
        course, trace = self.shared.files.course, self.shared.settings.delay_trace
        if course is None:
            return self.fixed_ns
        elapsed_ns = number * NS_PER_S if trace.by == "number" else now_ns - self.shared.course_origin_ns
        return self.fixed_ns + delay_at(course, elapsed_ns, interpolation=trace.interpolation, repeat=trace.repeat)

    def lost_by(self, now_ns: int, number: int) -> str:
        """Return the name of the first model that loses the message, or empty; every model draws in any case."""
        lost = [cause for cause, loses in self.losses if loses()]
        course = self.shared.files.losses
        if course is not None and not self.reliable and not lost:
            trace = self.shared.settings.loss_trace
            elapsed_ns = number * NS_PER_S if trace.by == "number" else now_ns - self.shared.losses_origin_ns
            if lost_at(course, elapsed_ns, repeat=trace.repeat):
                return "loss_trace"
        return lost[0] if lost else ""


class InFlight(NamedTuple):
    """A message, or a copy, whose release is still to be decided."""

    pipeline: TopicPipeline
    order: int  # of arrival
    seq: int
    copy: int
    payload: bytes
    arrived_ns: int
    ready_ns: int  # after an outage
    delay_ns: int = 0
    gated: bool = False
    duplicated: bool = False
    corrupted: bool = False
    src: str = ""


class PipelineState(NamedTuple):
    """State of a pipeline, by key: count of numbers drawn from each stream, states of the models, latest releases.

    session_ns: start of the newest session [ns].
    """

    drawn: list[tuple[tuple[str, ...], int]]
    models: list[tuple[tuple[str, ...], Part]]
    latest_release: list[tuple[tuple[str, str], LatestRelease]]
    session_ns: int


class Pipeline:
    """Builds the models of one direction: those of the topics that have had messages, and those that they share."""

    def __init__(self, direction: Direction, settings: LinkSettings, files: dict[str, Files], now_ns: int) -> None:
        self._direction: Direction = direction
        self._streams: dict[tuple[str, ...], RandomStream] = {}
        self._progress: dict[tuple[str, str], LatestRelease] = {}
        self.shared_models: dict[str, SharedModels] = {}
        self.topics: dict[str, TopicPipeline] = {}
        self._session_ns = NO_SESSION_NS
        self._build(settings, files, now_ns, ModelTable())

    def adopt(self, settings: LinkSettings, files: dict[str, Files], now_ns: int) -> None:
        """Build the models for new settings; `carry_over` says which continue. New ones have their origin at `now_ns`.

        All topics are rebuilt at once, so that their state follows from the settings and their previous state.
        """
        before = self._table.models
        if settings.seed != self._seed:
            self._streams.clear()
            before = {}
        if tuple(files) != tuple(self.shared_models):
            # Topics may move between queues, so all queues are rebuilt.
            before = {key: model for key, model in before.items() if key[:2] != ("shared", "queue")}
        self._build(settings, files, now_ns, ModelTable(before))

    def begin_session(self, now_ns: int) -> None:
        """Begin a session at `now_ns` [ns], the origin of schedules that are given in session time."""
        self._session_ns = now_ns
        for shared in self.shared_models.values():
            if shared.outages is not None:
                shared.outages.begin_session(now_ns)

    def capture(self) -> PipelineState:
        """Return the state."""
        return PipelineState(
            [(names, stream.drawn) for names, stream in self._streams.items() if stream.drawn],
            [(key, part(getattr(model, "state", model))) for key, (_, model) in self._table.models.items()],
            list(self._progress.items()),
            self._session_ns,
        )

    def restore(self, state: PipelineState, settings: LinkSettings, files: dict[str, Files]) -> None:
        """Continue from a state; the topics that were open then must be open.

        Raises:
            KeyError: The state does not fit a pipeline with these settings and topics; ValueError and TypeError mean
                the same.
        """
        self._session_ns = state.session_ns
        for names, drawn in state.drawn:
            self._stream(*names).advance_to(drawn)
        models = self._table.models
        for key, kept in state.models:
            definition, model = models[key]
            if isinstance(model, int):
                models[key] = ModelDefinition(definition, kept.like(model))
            else:
                model.state = kept.like(model.state)
        self._progress.update(state.latest_release)
        # Rebuild blocks and topics, because they copy some values of their models.
        self._build(settings, files, 0, ModelTable(models))

    def _build(self, settings: LinkSettings, files: dict[str, Files], now_ns: int, table: ModelTable) -> None:
        self._seed, self._table = settings.seed, table
        self._settings: DirectionSettings = getattr(settings, self._direction)
        self.shared_models = {pattern: self._shared_models_of(pattern, held, now_ns) for pattern, held in files.items()}
        self.topics = {topic: self._models_of(topic) for topic in self.topics}
        table.close()

    def open(self, topic: str) -> TopicPipeline:
        """Build and return the pipeline of a topic, at its first message."""
        pipeline = self.topics[topic] = self._models_of(topic)
        return pipeline

    def _models_of(self, topic: str) -> TopicPipeline:
        shared = self.shared_models[self._settings.pattern_of(topic)]
        s, reliable = shared.settings, self._settings.is_reliable(topic)
        latest_release = self._progress.setdefault(("topic", topic), LatestRelease())
        order = "topic" if reliable and s.order == "any" else s.order
        lossy = Impairment() if reliable else s
        duplicates = self._event(topic, "duplication", lossy.duplication.probability, lossy.duplication.correlation)
        pipeline = TopicPipeline(
            topic,
            shared,
            reliable,
            latest_release,
            ordered={"any": (), "topic": (latest_release,), "link": (latest_release, shared.latest_release)}[order],
            fixed_ns=round(s.delay_s * NS_PER_S),
            constant_ns=None,
            applies=None if s.apply_probability == 1.0 else self._applies(topic, s.apply_probability),
            losses=tuple(self._losses(topic, lossy)),
            corruptor=self._corruptor(topic, lossy),
            duplicates=duplicates,
            overtakes=self._overtaking(topic, lossy),
            jitter=self._jitter(topic, "original", shared),
            copy_jitter=None if duplicates is None else self._jitter(topic, "copy", shared),
        )
        return pipeline._replace(constant_ns=pipeline.fixed_ns) if _is_constant(pipeline) else pipeline

    def _stream(self, *names: str) -> RandomStream:
        if names not in self._streams:
            self._streams[names] = stream(self._seed, self._direction, *names)
        return self._streams[names]

    def _shared_models_of(self, pattern: str, files: Files, now_ns: int) -> SharedModels:
        s = self._settings.block(pattern)
        return SharedModels(
            s,
            files,
            latest_release=self._progress.setdefault(("block", pattern), LatestRelease()),
            course_origin_ns=self._table.take(
                ("shared", "course", pattern), (s.delay_trace, files.course), lambda: now_ns
            ),
            counter=self._counter(pattern, s, files),
            losses_origin_ns=self._table.take(
                ("shared", "losses", pattern), (s.loss_trace, files.losses), lambda: now_ns
            ),
            queue=self._queue(pattern, s, files.delivery_ns, now_ns),
            slot_gate=self._gate(pattern, s.slots, now_ns),
            outages=self._outages(pattern, s.outage, now_ns),
            lasting_jitter=self._lasting_jitter(pattern, s, files, now_ns),
        )

    def _counter(self, pattern: str, s: Impairment, files: Files) -> MessageCount | None:
        if "number" not in (s.delay_trace.by, s.loss_trace.by):
            return None
        definition = (s.delay_trace, files.course, s.loss_trace, files.losses)
        return self._table.take(("shared", "count", pattern), definition, MessageCount)

    def _queue(
        self, pattern: str, s: Impairment, delivery_ns: Sequence[int] | None, now_ns: int
    ) -> ServedQueue[InFlight] | None:
        rate_bytes_per_s = s.rate.rate_bytes_per_s
        server: Server
        if delivery_ns is not None:
            server = DeliveryServer(delivery_ns, s.delivery_trace.bytes_per_opportunity, now_ns)
        elif rate_bytes_per_s is not None:
            server = RateServer(rate_bytes_per_s, s.rate.overhead_bytes)
        elif s.outage.is_on:
            # A line without a rate limit also needs a queue, which bounds the messages held during an outage.
            server = RateServer(math.inf, 0)
        else:
            return None
        definition = (s.rate, s.delivery_trace, delivery_ns, s.queue)
        draw = self._stream("shared", "queue", pattern)
        return self._table.take(("shared", "queue", pattern), definition, lambda: ServedQueue(s.queue, server, draw))

    def _gate(self, pattern: str, slots: Slots, now_ns: int) -> SlotGate | None:
        if slots.min_interval_s is None:
            return None
        longest_s = slots.min_interval_s if slots.max_interval_s is None else slots.max_interval_s
        interval_ns = round(slots.min_interval_s * NS_PER_S), round(longest_s * NS_PER_S)
        draw = self._stream("shared", "slots", pattern)
        return self._table.take(
            ("shared", "slots", pattern),
            slots,
            lambda: SlotGate(interval_ns, slots.max_messages, slots.max_bytes, now_ns, draw),
        )

    def _outages(self, pattern: str, outage: Outage, now_ns: int) -> Outages | None:
        if not outage.is_on:
            return None
        draw = self._stream("shared", "outage", pattern)
        # The mode (drop or hold) does not change the times of outages.
        definition = outage.model_copy(update={"mode": "drop"})
        session_ns = self._session_ns
        return self._table.take(
            ("shared", "outage", pattern), definition, lambda: Outages(outage, now_ns, draw, session_ns)
        )

    def _event(self, topic: str, name: str, probability: float, correlation: float) -> Occurrence | None:
        if probability == 0.0:
            return None
        draw = self._stream(topic, name)
        return self._table.take(
            (topic, name), (probability, correlation), lambda: Occurrence(probability, correlation, draw)
        )

    def _applies(self, topic: str, probability: float) -> Occurrence:
        # Not through `_event`, because a probability of 0 needs a model here, one that never applies.
        draw = self._stream(topic, "apply")
        return self._table.take((topic, "apply"), probability, lambda: Occurrence(probability, 0.0, draw))

    def _losses(self, topic: str, s: Impairment) -> list[tuple[str, Callable[[], bool]]]:
        losses: list[tuple[str, Callable[[], bool] | None]] = [
            ("loss", self._event(topic, "loss", s.loss.probability, s.loss.correlation)),
            ("markov_loss", self._markov(topic, s)),
            ("gilbert_elliott", self._gilbert_elliott(topic, s)),
        ]
        return [(cause, loses) for cause, loses in losses if loses is not None]

    def _markov(self, topic: str, s: Impairment) -> MarkovLossChain | None:
        chain, draw = s.markov_loss, self._stream(topic, "markov_loss")
        if chain.p13 == 0.0 and chain.p14 == 0.0:
            return None
        return self._table.take((topic, "markov_loss"), chain, lambda: MarkovLossChain(chain, draw))

    def _gilbert_elliott(self, topic: str, s: Impairment) -> GilbertElliottChain | None:
        chain = s.gilbert_elliott
        if chain.p == 0.0 and chain.loss_in_good == 0.0:
            return None
        step, decide = self._stream(topic, "gilbert_elliott/step"), self._stream(topic, "gilbert_elliott/loss")
        return self._table.take((topic, "gilbert_elliott"), chain, lambda: GilbertElliottChain(chain, step, decide))

    def _corruptor(self, topic: str, s: Impairment) -> Corruptor | None:
        happens = self._event(topic, "corruption", s.corruption.probability, s.corruption.correlation)
        places = self._stream(topic, "corruption/bits")
        return None if happens is None else Corruptor(happens, s.corruption.bits, places)

    def _overtaking(self, topic: str, s: Impairment) -> Overtaking | None:
        happens = self._event(topic, "reordering", s.reordering.probability, s.reordering.correlation)
        if happens is None:
            return None
        return self._table.take((topic, "overtaking"), s.reordering, lambda: Overtaking(happens, s.reordering.gap))

    def _lasting_jitter(self, pattern: str, s: Impairment, files: Files, now_ns: int) -> RandomDelay | None:
        if s.jitter.scale_s == 0.0 or s.jitter.correlation_time_s == 0.0:
            return None
        share, time_s = s.jitter.second_correlation_share, s.jitter.second_correlation_time_s

        def source(name: str, settings: Jitter) -> JitterSource:
            draw = self._stream("shared", name, pattern)
            definition = (settings, files.samples)
            return self._table.take(
                ("shared", name, pattern), definition, lambda: JitterSource(*definition, draw, now_ns)
            )

        first = source("jitter", s.jitter)
        if share == 0.0:
            return first
        return first.beside(source("second jitter", s.jitter.model_copy(update={"correlation_time_s": time_s})), share)

    def _jitter(self, topic: str, which: str, shared: SharedModels) -> RandomDelay | None:
        settings, samples = shared.settings.jitter, shared.files.samples
        if settings.scale_s == 0.0 or shared.lasting_jitter is not None:
            return shared.lasting_jitter
        draw = self._stream(topic, which, "jitter")
        return self._table.take(
            (topic, "jitter", which), (settings, samples), lambda: JitterSource(settings, samples, draw)
        )


def _is_constant(pipeline: TopicPipeline) -> bool:
    models = (pipeline.applies, pipeline.corruptor, pipeline.duplicates, pipeline.overtakes, pipeline.jitter)
    files = pipeline.shared.files
    shared = (files.course, files.losses, pipeline.shared.queue, pipeline.shared.slot_gate, pipeline.shared.outages)
    return not pipeline.losses and not pipeline.ordered and all(model is None for model in (*models, *shared))
