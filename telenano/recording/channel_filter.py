"""Selection of channels of a recording, or of the bus, by patterns of names."""

import re
from collections.abc import Callable, Collection, Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol, TypeVar

from telenano.recording.recorded_time import RecordedTime
from telenano.wire.errors import ConfigError, RecordingError, known_names
from telenano.wire.nodes import name_of
from telenano.wire.patterns import fault_of_pattern, matches
from telenano.wire.printable import shown

Matcher = Callable[[str], bool]
M = TypeVar("M")


class _Named(Protocol):
    @property
    def channel_topic(self) -> str: ...
    @property
    def src(self) -> str: ...


def matcher(pattern: str) -> Matcher:
    """Return a predicate of names for a glob such as `teleop/*` or a regular expression between slashes, `/^afm/`.

    Raises:
        ConfigError: The pattern is too long or not a regular expression; the message names it.
    """
    if fault := fault_of_pattern(pattern):
        raise ConfigError(fault)
    if len(pattern) > 1 and pattern.startswith("/") and pattern.endswith("/"):
        try:
            expression = re.compile(pattern[1:-1])
        except re.error as error:
            raise ConfigError(f"pattern {pattern}: is not a regular expression: {error}") from error
        return lambda name: expression.search(name) is not None
    return lambda name: matches(name, pattern)


def node_matcher(pattern: str) -> Matcher:
    """Return a predicate of nodes; the pattern matches `node@site`, or `node` at every site."""
    test = matcher(pattern)
    return lambda key: test(key) or test(name_of(key))


@dataclass(frozen=True)
class Selection:
    """Predicate that selects channels by channel name and publisher; without patterns it selects all.

    Channels have the names of the recording: `teleop/forward` at the sender, `teleop/forward@slave` behind the link.
    """

    topics: tuple[Matcher, ...] = ()
    exclude: tuple[Matcher, ...] = ()
    nodes: tuple[Matcher, ...] = ()
    # The patterns of topics and of nodes as the user wrote them, for the error if one selects nothing.
    asked: tuple[str, ...] = ()
    asked_nodes: tuple[str, ...] = ()

    @classmethod
    def of(cls, topics: Iterable[str] = (), exclude: Iterable[str] = (), nodes: Iterable[str] = ()) -> "Selection":
        """Build a selection from patterns; ConfigError names an invalid one."""
        names, publishers = tuple(topics), tuple(nodes)
        return cls(
            tuple(map(matcher, names)),
            tuple(map(matcher, exclude)),
            tuple(map(node_matcher, publishers)),
            names,
            publishers,
        )

    def __call__(self, channel: _Named) -> bool:
        if self.nodes and not any(test(channel.src) for test in self.nodes):
            return False
        return self.names(channel.channel_topic)

    def names(self, channel_topic: str) -> bool:
        """Return whether a channel of this name is selected, no matter which node publishes on it."""
        if any(test(channel_topic) for test in self.exclude):
            return False
        return not self.topics or any(test(channel_topic) for test in self.topics)

    def demand_some_of(self, source: Path, channels: Collection[_Named]) -> None:
        """Raise RecordingError if a pattern of topics or nodes, or all together, select no channel; it says what is."""
        names = sorted({channel.channel_topic for channel in channels})
        nodes = sorted({channel.src for channel in channels})
        for pattern, test in zip(self.asked_nodes, self.nodes, strict=True):
            if not any(map(test, nodes)):
                raise RecordingError(f"{source}: has no message of node {_told(pattern, nodes)}")
        for pattern, test in zip(self.asked, self.topics, strict=True):
            if not any(map(test, names)):
                raise RecordingError(f"{source}: has no channel {_told(pattern, names)}")
        if self != ALL and not any(map(self, channels)):
            raise RecordingError(f"{source}: no channel is left of these: {', '.join(map(shown, names))}")


def some_of(
    source: Path,
    messages: Iterator[M],
    span_ns: tuple[int, int],
    start: float | RecordedTime | None,
    end: float | RecordedTime | None,
) -> Iterator[M]:
    """Yield the messages of a choice of channels and times; RecordingError, which says how long it is, for none.

    Args:
        source: The recording.
        messages: The messages that were chosen.
        span_ns: First and last time of reception in the recording [ns].
        start: Begin of the chosen times; None for that of the recording.
        end: Their end; None for that of the recording.
    """
    first = next(messages, None)
    if first is None:
        lasts_s = (span_ns[1] - span_ns[0]) * 1e-9
        until = "on" if end is None else f"to {_told_time(end)}"
        raise RecordingError(
            f"{source}: lasts {lasts_s:.3f} s, from {span_ns[0]} to {span_ns[1]} ns of the epoch, and has nothing of "
            f"this choice from {_told_time(start)} {until}"
        )
    yield first
    yield from messages


def _told_time(time: float | RecordedTime | None) -> str:
    return "its start" if time is None else f"{time:g} s" if isinstance(time, float) else str(time)


def _told(asked: str, there_are: Collection[str]) -> str:
    """Return the text of an error: the pattern that selects nothing and the names that exist."""
    return f"{shown(asked)}: {known_names(asked, [shown(name) for name in there_are] or ['none'])}"


ALL = Selection()
