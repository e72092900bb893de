"""A recorder's connection to one publisher, and what it knows of each of its streams."""

from dataclasses import dataclass, field

from telenano.runtime.bus.bus import Subscriber
from telenano.wire.sequence import SequenceTracker
from telenano.wire.topics import Topic


@dataclass(slots=True)
class Stream:
    """What one publisher sends on one topic, received at one site.

    `live`: received at its publisher, with the stamps of this time: no queue is as long as those of a replay are old.
    `channel`: its number in the file, None before its first message there.
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


@dataclass
class Listener:
    """Connection to one publisher: what comes through it was received at that publisher's site.

    A `publisher` without a site represents many, each of which is received at its own. The streams are by topic and
    source.
    """

    publisher: str
    subscriber: Subscriber
    streams: dict[tuple[str, str], Stream] = field(default_factory=dict)
