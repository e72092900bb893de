"""Settings of the link: every impairment, per direction and per topic, with seed and profile.

A settings file, a profile and a run-time change all end in one frozen `LinkSettings`. Keys are dotted paths
(`backward.loss.probability`); docs/link.md defines each of them. A topic's override holds only the keys it names and
inherits the others from its direction, so relations between keys are checked on the merged result.
"""

from collections.abc import Iterator, Mapping
from typing import Annotated, Any, ClassVar, Literal

from pydantic import BaseModel, BeforeValidator, Field, ValidationError, field_validator, model_validator
from pydantic_core import InitErrorDetails, PydanticCustomError

from telenano.settings.config import Settings, flatten, merge, nested, validate
from telenano.settings.network_profiles import PROFILES, refusal_of
from telenano.wire.codec import MAX_MESSAGE_BYTES
from telenano.wire.messages import MAX_KEYS
from telenano.wire.patterns import fault_of_pattern, matches

Setting = float | int | str | bool
# A dotted key, and the fault of its value.
Problem = tuple[str, str]
Probability = Annotated[float, Field(ge=0.0, le=1.0)]
# A correlation of 1 would freeze the first draw for ever.
Correlation = Annotated[float, Field(ge=0.0, lt=1.0)]
LONGEST_S = 3600.0
Seconds = Annotated[float, Field(ge=0.0, le=LONGEST_S)]
# Below a microsecond, a time-driven model would need thousands of steps per message.
Interval = Annotated[float, Field(ge=1e-6, le=LONGEST_S)]
# The largest integer that link/status can carry.
_MOST = 2**63 - 1
# The room in link/status for each direction [bytes]: the keys that are set and their values, as text.
_MOST_BYTES = MAX_MESSAGE_BYTES // 4

# The name of a network that delays every message by the same time and does nothing else.
CONSTANT_DELAY = "constant delay"
EVEN = ("clean", CONSTANT_DELAY)  # the networks over which every message takes the same time


def _pairs(value: object) -> object:
    """Accept `1.5:0.2, 4:1` for pairs of numbers as well, because a run-time change carries no lists."""
    if isinstance(value, list):
        return tuple(tuple(item) if isinstance(item, list) else item for item in value)
    if not isinstance(value, str):
        return value
    try:
        pairs = [item.split(":") for item in value.split(",") if item.strip()]
        return tuple((float(first), float(second)) for first, second in pairs)
    except ValueError as error:
        raise ValueError(f"{value!r} is not a list of pairs of numbers, such as '1.5:0.2, 4:1'") from error


class Jitter(Settings):
    """Random part of the delay: scale_s times a standardised random number."""

    # Jitter that is correlated over time is drawn this number of times per correlation time.
    DRAWS_IN_CORRELATION_TIME: ClassVar[int] = 8
    # A pause of more draws than this is skipped, not walked through.
    LONGEST_WALK: ClassVar[int] = 10_000

    scale_s: Seconds = Field(
        default=0.0,
        description="half-width (uniform), standard deviation (normal, pareto), "
        "mean of the first part (hyperexponential) or seconds per table unit (table) [s]",
    )
    distribution: Literal["uniform", "normal", "pareto", "hyperexponential", "table"] = Field(
        default="normal", description="law of the random part"
    )
    correlation: Correlation = Field(default=0.0, description="correlation of the normal scores of successive messages")
    correlation_time_s: Seconds = Field(
        default=0.0,
        description="time in which the correlation of the normal scores falls to 1/e [s], regardless of the traffic "
        "and alike for all topics under the same settings; 0: `correlation` of successive messages applies",
    )
    second_correlation_time_s: Seconds = Field(
        default=0.0, description="another such time, for a part of the scores [s]"
    )
    second_correlation_share: Probability = Field(
        default=0.0, description="share of the variance of the normal scores that lasts over second_correlation_time_s"
    )
    pareto_shape: float = Field(
        default=3.0,
        gt=2.0,
        le=100.0,
        description="shape a of the Pareto law; its standard deviation exists for a > 2 only",
    )
    second_share: Probability = Field(
        default=0.0, description="share of the messages whose delay is of the second part (hyperexponential)"
    )
    second_scale_s: Seconds = Field(default=0.0, description="mean of the second part (hyperexponential) [s]")
    table_file: str | None = Field(
        default=None,
        description="file of samples, any count per line, # begins a comment",
    )
    quantiles: Annotated[tuple[tuple[Probability, float], ...], BeforeValidator(_pairs)] = Field(
        default=(), description="a table without a file: pairs (share, value below which that share lies), in order"
    )


By = Annotated[
    Literal["time", "number"],
    Field(
        description="meaning of the first column: time [s], or the number of the message in its block, reliable ones "
        "not counted"
    ),
]


class DelayTrace(Settings):
    """A recorded delay, by time or by number; adds to delay_s."""

    file: str | None = Field(
        default=None,
        description="file of lines `time_s delay_s`, times strictly increasing",
    )
    by: By = "time"
    interpolation: Literal["hold", "linear"] = Field(default="linear", description="course between two lines")
    repeat: bool = Field(default=True, description="start again after the last line; otherwise keep its delay")


class LossTrace(Settings):
    """A recorded loss, by time or by number."""

    file: str | None = Field(default=None, description="file of lines `time_s lost`, times strictly increasing")
    by: By = "time"
    repeat: bool = Field(default=True, description="start again after the last line; otherwise keep its value")


class Event(Settings):
    """Something that happens to a message with a probability, in runs if correlated."""

    probability: Probability = Field(default=0.0, description="share of the messages concerned, 0..1")
    correlation: Correlation = Field(default=0.0, description="correlation of successive occurrences, 0..1")


class MarkovLoss(Settings):
    """Four-state loss: 1 received, 2 received inside a burst, 3 lost inside a burst, 4 lost alone."""

    p13: Probability = Field(default=0.0, description="received -> lost in a burst, per message")
    p31: Probability = Field(default=1.0, description="lost in a burst -> received, per message")
    p32: Probability = Field(default=0.0, description="lost in a burst -> received inside the burst, per message")
    p23: Probability = Field(default=1.0, description="received inside a burst -> lost in the burst, per message")
    p14: Probability = Field(default=0.0, description="received -> lost alone, per message")


class GilbertElliott(Settings):
    """Two-state loss: each state has a loss probability of its own."""

    p: Probability = Field(default=0.0, description="good -> bad, per message")
    r: Probability = Field(default=1.0, description="bad -> good, per message")
    loss_in_bad: Probability = Field(default=1.0, description="1-h, share lost in the bad state")
    loss_in_good: Probability = Field(default=0.0, description="1-k, share lost in the good state")


class Corruption(Event):
    """Flipped bits in the payload."""

    bits: int = Field(default=1, ge=1, le=1024, description="different bits flipped in a corrupted message")


class Reordering(Event):
    """Messages sent at once, past the delay of those before them."""

    gap: int = Field(
        default=1,
        ge=1,
        le=_MOST,
        description="at most one message in a gap: between two of them, gap - 1 keep their delay",
    )


class Rate(Settings):
    """Serialisation at a finite rate."""

    rate_bytes_per_s: float | None = Field(
        default=None, ge=1e-3, le=1e12, description="throughput [byte/s], none: unlimited"
    )
    overhead_bytes: int = Field(default=0, ge=0, le=65536, description="bytes added to each message on the line")


class DeliveryTrace(Settings):
    """Throughput given by recorded delivery opportunities; the trace repeats."""

    file: str | None = Field(default=None, description="file of times, one a line, not decreasing")
    unit_s: Interval = Field(default=1e-3, description="seconds per unit of the file")
    bytes_per_opportunity: int | None = Field(
        default=1500, ge=1, le=_MOST, description="bytes, none: one message of any size"
    )


class Queue(Settings):
    """The queue in front of a rate limit, a delivery trace or a stalled line."""

    limit_messages: int | None = Field(
        default=1000, ge=0, le=_MOST, description="messages that may wait, none: unlimited"
    )
    limit_bytes: int | None = Field(default=None, ge=0, le=_MOST, description="bytes that may wait, none: unlimited")
    drop: Literal["tail", "head", "random", "same_topic"] = Field(
        default="tail",
        description="message that is dropped when the queue is full: the arriving one, the oldest, any of those "
        "waiting, the oldest of the same topic",
    )


class Slots(Settings):
    """Release in bursts: messages leave only when a slot opens."""

    min_interval_s: Interval | None = Field(default=None, description="shortest time between slots [s], none: off")
    max_interval_s: Interval | None = Field(
        default=None, description="longest time between slots [s], none: as min_interval_s"
    )
    max_messages: int | None = Field(
        default=None, ge=1, le=_MOST, description="messages a slot carries, none: unlimited"
    )
    max_bytes: int | None = Field(default=None, ge=1, le=_MOST, description="bytes a slot carries, none: unlimited")


def _names(value: object) -> object:
    if isinstance(value, str):
        return tuple(name.strip() for name in value.split(",") if name.strip())
    return tuple(value) if isinstance(value, list) else value


class Outage(Settings):
    """Times without any connection, by schedule, at random, or both."""

    schedule: Annotated[tuple[tuple[Seconds, Interval], ...], BeforeValidator(_pairs)] = Field(
        default=(), description="pairs (start_s after the origin, duration_s), in order"
    )
    origin: Literal["settings", "session"] = Field(
        default="settings",
        description="origin of the schedule: the time at which the settings came into force, or the start of the "
        "session",
    )
    period_s: Interval | None = Field(default=None, description="the schedule repeats after this time [s], none: once")
    mean_up_s: Interval | None = Field(default=None, description="mean of the exponential time between random outages")
    mean_down_s: Interval | None = Field(default=None, description="mean length of random outages [s]")
    down_spread: Annotated[float, Field(ge=0.0, le=5.0)] | None = Field(
        default=None, description="standard deviation of the logarithm of that length (log-normal), none: exponential"
    )
    mode: Literal["drop", "hold"] = Field(
        default="drop", description="fate of messages that arrive in an outage: lost, or in the queue until it ends"
    )

    @property
    def is_on(self) -> bool:
        return bool(self.schedule) or self.mean_up_s is not None


class Impairment(Settings):
    """Everything that can happen to a message in transit in one direction."""

    delay_s: Seconds = Field(default=0.0, description="fixed delay [s]")
    jitter: Jitter = Field(default=Jitter(), description="random part of the delay")
    delay_trace: DelayTrace = Field(default=DelayTrace(), description="recorded part of the delay")
    loss: Event = Field(default=Event(), description="random loss")
    loss_trace: LossTrace = Field(default=LossTrace(), description="recorded loss")
    markov_loss: MarkovLoss = Field(default=MarkovLoss(), description="four-state loss")
    gilbert_elliott: GilbertElliott = Field(default=GilbertElliott(), description="two-state loss")
    corruption: Corruption = Field(default=Corruption(), description="flipped bits")
    duplication: Event = Field(default=Event(), description="a second copy with a delay of its own")
    reordering: Reordering = Field(default=Reordering(), description="messages sent past their delay")
    order: Literal["any", "topic", "link"] = Field(
        default="any",
        description="any: overtaking allowed; topic: none within a topic; link: none among all topics "
        "under the same settings",
    )
    rate: Rate = Field(default=Rate(), description="rate limit")
    delivery_trace: DeliveryTrace = Field(default=DeliveryTrace(), description="recorded throughput")
    queue: Queue = Field(default=Queue(), description="queue before rate limit, delivery trace or stall")
    slots: Slots = Field(default=Slots(), description="release in bursts")
    outage: Outage = Field(default=Outage(), description="times without connection")
    apply_probability: Probability = Field(
        default=1.0, description="share of the messages that these settings apply to; the others pass untouched"
    )

    def problems(self) -> Iterator[Problem]:
        """Yield each contradiction between keys, with the key at fault."""
        yield from self._shape_problems()
        yield from self._chain_problems()
        yield from _outage_problems(self.outage)

    def _shape_problems(self) -> Iterator[Problem]:
        shares = [share for share, _ in self.jitter.quantiles]
        values = [value for _, value in self.jitter.quantiles]
        if shares and (shares != sorted(set(shares)) or (shares[0], shares[-1]) != (0.0, 1.0)):
            yield "jitter.quantiles", "the shares have to rise from 0 to 1"
        if values != sorted(values):
            yield "jitter.quantiles", "a larger share has a smaller value than the one before it"
        if self.jitter.distribution == "table" and (self.jitter.table_file is None) == (not shares):
            yield "jitter.table_file", "distribution 'table' needs a file of samples or jitter.quantiles, and not both"
        if self.jitter.correlation > 0.0 and self.jitter.correlation_time_s > 0.0:
            yield "jitter.correlation", "is per message, jitter.correlation_time_s over time; set one of them"
        times = (self.jitter.correlation_time_s, self.jitter.second_correlation_time_s)
        if self.jitter.second_correlation_share > 0.0 and 0.0 in times:
            yield "jitter.second_correlation_share", "needs correlation_time_s and second_correlation_time_s above 0"
        if self.jitter.distribution == "table" and self.jitter.scale_s == 0.0:
            yield "jitter.scale_s", "is 0, by which every sample of the table is multiplied; 1 where they are seconds"
        if self.jitter.second_share > 0.0 and self.jitter.second_scale_s == 0.0:
            yield "jitter.second_scale_s", "0 s is not a mean of a second part; give one, or jitter.second_share = 0"
        if self.order != "any" and self.reordering.probability > 0.0:
            yield "order", f"{self.order!r} forbids overtaking, but reordering.probability asks for it; set one of them"
        if self.rate.rate_bytes_per_s is not None and self.delivery_trace.file is not None:
            yield "rate.rate_bytes_per_s", "delivery_trace.file limits the throughput as well; set one of them"
        shortest, longest = self.slots.min_interval_s, self.slots.max_interval_s
        if longest is not None and (shortest is None or longest < shortest):
            yield "slots.max_interval_s", f"{longest} s needs a slots.min_interval_s that is not longer, got {shortest}"

    def _chain_problems(self) -> Iterator[Problem]:
        m, g = self.markov_loss, self.gilbert_elliott
        if m.p13 + m.p14 > 1.0:
            yield "markov_loss.p13", f"p13 + p14 is {m.p13 + m.p14}, more than 1"
        if m.p31 + m.p32 > 1.0:
            # The default leaves a burst at once, so a chain that uses p32 needs p31 too.
            yield "markov_loss.p31", f"p31 + p32 is {m.p31 + m.p32}, more than 1 (p31 is 1 unless set)"
        if m.p13 > 0.0 and m.p31 + m.p32 == 0.0:
            yield "markov_loss.p31", "p31 + p32 is 0, a burst would never end; use loss.probability = 1 for that"
        if g.p > 0.0 and g.r == 0.0:
            yield "gilbert_elliott.r", "0 never leaves the bad state; use loss.probability for a lasting loss"


def _outage_problems(outage: Outage) -> Iterator[Problem]:
    end_s = 0.0
    for start_s, duration_s in outage.schedule:
        if start_s < end_s:
            yield "outage.schedule", f"the outage at {start_s} s begins before the one in front of it ends at {end_s} s"
        end_s = start_s + duration_s
    # A schedule that fills its period would never let anything through.
    if outage.period_s is not None and outage.period_s <= end_s:
        yield "outage.period_s", f"{outage.period_s} s must be longer than the schedule, which ends at {end_s} s"
    if (outage.mean_up_s is None) != (outage.mean_down_s is None):
        yield "outage.mean_up_s", "random outages need both mean_up_s and mean_down_s"


class DirectionSettings(Impairment):
    """Impairment of one direction, with overrides by topic."""

    topics: dict[str, Impairment] = Field(
        default={},
        description="topic or pattern (* and ?) -> the keys that differ for it; an exact name wins, then "
        "the first pattern that fits",
    )
    reliable: Annotated[tuple[str, ...], BeforeValidator(_names)] = Field(
        default=("session/*",),
        description="topics carried as by a retransmitting connection: delayed and queued, but "
        "never lost, duplicated, corrupted or overtaken, and held instead of dropped in an outage",
    )

    @model_validator(mode="after")
    def _consistent(self) -> "DirectionSettings":
        section = self.model_dump()
        faults = [
            # Each error names the key at fault; a plain ValueError would name the section.
            InitErrorDetails(type=PydanticCustomError("value_error", "{text}", {"text": text}), loc=path, input=section)
            for path, text in self._problems()
        ]
        if faults:
            raise ValidationError.from_exception_data(type(self).__name__, faults)
        return self

    def _problems(self) -> Iterator[tuple[tuple[str, ...], str]]:
        """Yield the path to each wrong key, and what is wrong, for the direction's own settings and each override."""
        inherited = list(self.problems())
        for key, text in inherited:
            yield tuple(key.split(".")), text
        for key, pattern in [*(("topics", key) for key in self.topics), *(("reliable", key) for key in self.reliable)]:
            if fault := fault_of_pattern(pattern):
                yield (key,), fault
        for pattern, override in self.topics.items():
            if pattern.count(".") or pattern != pattern.strip():
                yield ("topics",), f"{pattern!r} is not a topic pattern: no dots, no spaces around it"
            if not override.model_dump(exclude_unset=True):
                yield ("topics", pattern), "changes nothing; name a key that differs, or repeat one, such as delay_s"
            for problem in self.block(pattern).problems():
                if problem not in inherited:
                    yield ("topics", pattern, *problem[0].split(".")), problem[1]

    def pattern_of(self, topic: str) -> str:
        """Return the key in `topics` that applies to a topic, or the empty string for the direction's own settings."""
        if topic in self.topics:
            return topic
        return next((pattern for pattern in self.topics if matches(topic, pattern)), "")

    def is_reliable(self, topic: str) -> bool:
        return any(matches(topic, pattern) for pattern in self.reliable)

    def block(self, pattern: str) -> Impairment:
        """Return the settings for one key in `topics`: its own over those of the direction; '' for the latter alone."""
        own = self.model_dump(exclude={"topics", "reliable"}, exclude_unset=True)
        if pattern:
            own = merge(own, self.topics[pattern].model_dump(exclude_unset=True))
        return Impairment.model_validate(own)


class LinkSettings(Settings):
    """Settings of the whole link. `forward` runs from the master site to the slave site, `backward` the other way."""

    profile: str = Field(default="clean", description="named settings that the keys below change")
    seed: int = Field(default=0, ge=0, le=_MOST, description="seed of all random streams; another seed restarts them")
    forward: DirectionSettings = Field(default=DirectionSettings(), description="master to slave")
    backward: DirectionSettings = Field(default=DirectionSettings(), description="slave to master")

    @field_validator("profile")
    @classmethod
    def _known(cls, name: str) -> str:
        if name not in PROFILES:
            raise ValueError(refusal_of(name))
        return name

    @model_validator(mode="before")
    @classmethod
    def _on_profile(cls, data: object) -> object:
        """Merge the given keys over those of the profile; doing so again changes nothing."""
        if not isinstance(data, Mapping) or not isinstance(name := data.get("profile"), str):
            return data
        profile = PROFILES.get(name.lower())
        if profile is None:
            return data
        settings = {
            key: value.model_dump(exclude_unset=True) if isinstance(value, BaseModel) else value
            for key, value in data.items()
        }
        return merge(profile.settings, settings, {"profile": name.lower()})

    @model_validator(mode="after")
    def _reportable(self) -> "LinkSettings":
        # The settings are reported ten times a second, so they have to fit.
        settings = self.flattened(only_set=True)
        for way in ("forward", "backward"):
            texts = [f"{key}{value}".encode() for key, value in settings.items() if key.startswith(f"{way}.")]
            if len(texts) > MAX_KEYS or sum(map(len, texts)) > _MOST_BYTES:
                raise ValueError(
                    f"{way} has {len(texts)} keys and {sum(map(len, texts))} bytes of text, "
                    f"at most {MAX_KEYS} and {_MOST_BYTES} can be reported"
                )
        return self

    def changed(self, flat: Mapping[str, Setting]) -> "LinkSettings":
        """Return the settings with dotted keys changed, as a run-time request carries them.

        `profile` drops everything but the seed and starts from the named profile; the other keys of the same request
        are laid over it. The text `none` represents a missing value. `forward.topics.afm/state.delay_s` addresses a
        topic.

        Raises:
            ConfigError: A key is wrong, which the message names; the settings given stay as they were.
        """
        kept: dict[str, Any] = {"seed": self.seed} if "profile" in flat else self.model_dump(exclude_unset=True)
        change = nested({key: None if value == "none" else value for key, value in flat.items()}, "session/control")
        return LinkSettings.of(merge(kept, change), "session/control")

    def flattened(self, *, only_set: bool = False) -> dict[str, Setting]:
        """Return the settings as dotted keys, in the form that `changed` takes; `only_set` leaves defaults out."""
        tree = self.model_dump(exclude_unset=only_set)
        for name in ("forward", "backward"):
            direction: DirectionSettings = getattr(self, name)
            # An override names only what differs: its defaults are the direction's values, not the model's.
            overrides = {pattern: block.model_dump(exclude_unset=True) for pattern, block in direction.topics.items()}
            if name in tree and overrides:
                tree[name]["topics"] = overrides
        return {key: _as_setting(value) for key, value in flatten(tree).items()}

    @property
    def network_name(self) -> str:
        """The name of the network in force: that of the profile, or one that says that keys differ from the profile.

        `clean` with a constant delay and nothing else is `constant delay`, with other keys `custom`. Another profile
        with changed keys has a name such as `lte, changed`. The seed does not count as a change.
        """
        named = LinkSettings(profile=self.profile, seed=self.seed).flattened()
        differing = {key for key, value in self.flattened().items() if named.get(key) != value}
        if not differing or self.profile != "clean":
            return f"{self.profile}, changed" if differing else self.profile
        return CONSTANT_DELAY if differing <= {"forward.delay_s", "backward.delay_s"} else "custom"

    @classmethod
    def of(cls, tree: Mapping[str, Any], origin: str = "link settings") -> "LinkSettings":
        """Validate a nested mapping, such as the section `delay_node` of a scenario.

        Raises:
            ConfigError: Keys are wrong; the message has a line for each, with origin, dotted key, fault and value.
        """
        return validate(cls, tree, origin)


def profile_changes(settings: LinkSettings) -> dict[str, tuple[Setting, Setting]]:
    """Return the values of the profile that the settings replace: dotted key -> (value of the profile, value now)."""
    of_profile = {key: _as_setting(value) for key, value in flatten(PROFILES[settings.profile].settings).items()}
    in_force = settings.flattened()
    return {key: (value, in_force[key]) for key, value in of_profile.items() if in_force[key] != value}


def changes_text(settings: LinkSettings) -> str:
    """Return a sentence on the values of the profile that the settings replace; empty where they replace none."""
    changed_keys = [f"{key} is {actual}, not {named}" for key, (named, actual) in profile_changes(settings).items()]
    return f"the profile {settings.profile} is changed: {', '.join(changed_keys)}" if changed_keys else ""


def _as_setting(value: Any) -> Setting:
    """Return a value as a message carries it: lists as text, a missing value as `none`."""
    if isinstance(value, tuple):
        return ",".join(item if isinstance(item, str) else f"{item[0]}:{item[1]}" for item in value)
    setting: Setting = "none" if value is None else value
    return setting
