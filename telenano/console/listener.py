"""A recorder's connection to one publisher, and the state of each of its streams."""

from dataclasses import dataclass, field

from telenano.runtime.bus.bus import Subscriber
from telenano.wire.sequence import SequenceTracker
from telenano.wire.topics import Topic


@dataclass(slots=True)
class Stream:
    """Stream of messages from one publisher on one topic, received at one site.

    `live`: received at its publisher, with current stamps rather than the old ones of a replay.
    `channel`: its number in the file, None before its first message there. `kept`: the newest number of its present
    process that a recording is known to have. `unwritten`: ranges of numbers of earlier processes that it has not.
    """

    topic: Topic
    channel_topic: str
    src: str
    site: str
    channel: int | None
    direct: bool
    live: bool
    wanted: bool
    tracker: SequenceTracker
    kept: int
    unwritten: list[tuple[int, int]] = field(default_factory=list)


@dataclass
class Listener:
    """Connection to one publisher, at whose site its messages count as received.

    A `publisher` without a site represents many, each of which is received at its own site. The keys of `streams` are
    topic and source.
    """

    publisher: str
    subscriber: Subscriber
    streams: dict[tuple[str, str], Stream] = field(default_factory=dict)
