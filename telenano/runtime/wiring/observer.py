"""`telenano topic`: the messages of a running rig, received from every socket of it."""

import contextlib
import math
import time
from collections.abc import Collection, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Self

import numpy as np
import zmq

from telenano.runtime.bus.absence import RIG_HINT as RIG_HINT
from telenano.runtime.bus.absence import absence_text
from telenano.runtime.bus.address_book import AddressBook
from telenano.runtime.bus.bus import ConnectionEvent
from telenano.runtime.bus.holders import Holder, look
from telenano.runtime.bus.local_endpoint import local_endpoint, path_of
from telenano.runtime.wiring.participant import Participant
from telenano.settings.package_topics import installed_topics, problem_with, row_of
from telenano.wire import TOPICS
from telenano.wire.errors import ConfigError, RigError, known_names, probably_meant
from telenano.wire.nodes import is_visitor, site_of
from telenano.wire.received import Received
from telenano.wire.sequence import SequenceTracker
from telenano.wire.topics import keep_unknown

_WAIT_MS = 100
# A rig makes removed sockets again within this time, even on a busy machine [s].
_BACK_S = 3.0
_RETRY_S = 0.05


@dataclass(frozen=True)
class ObservedMessage:
    """A message as an observer receives it; `name` is the topic, or topic@site for a copy from the link at a site."""

    name: str
    received: Received


def known_name(name: str, *, unknown: bool = False) -> tuple[str, str | None]:
    """Split topic or topic@site into topic and site (None without one).

    With `unknown`, an undeclared topic is accepted unless its name resembles a known one; its messages stay undecoded.

    Raises:
        ConfigError: The topic is unknown, or a site is named although the topic does not cross the link.
    """
    topic, _, site = name.partition("@")
    meant = probably_meant(topic, TOPICS)
    if row_of(topic) is None and not (unknown and not meant and keep_unknown(topic)):
        reason = problem_with(topic) or f"{known_names(topic, TOPICS)}, with @site for what left the link"
        raise ConfigError(f"unknown topic {name!r}: {reason}")
    if site and TOPICS[topic].bridged is None:
        raise ConfigError(f"{name}: {topic} does not cross the link, so there is no copy at {site}")
    return topic, site or None


class Observer:
    """One connection to every socket of the rig, so that originals and copies are counted separately."""

    def __init__(self, book: AddressBook, wanted: Collection[str] | None = None, *, shared: bool = True) -> None:
        """Connect for some topics, or for all if `wanted` is None, as the machine on which this process runs.

        With `shared`, nodes are read through the process that reads them once for all observers, if the rig has one.

        Raises:
            ConfigError: This machine lacks a key that the rig requires.
        """
        self.notices: list[ConnectionEvent] = []
        self._book = book
        self._open = contextlib.ExitStack()
        participant = self._open.enter_context(Participant.observing(book))
        self._network = participant.network
        self.subscribers = participant.observe(lambda topic, node: wanted is None or topic in wanted, shared=shared)
        self._poller = zmq.Poller()
        for subscriber in self.subscribers.values():
            self._poller.register(subscriber.socket, zmq.POLLIN)

    @classmethod
    def of_rig(cls, site_file: Path, wanted: Collection[str] | None = None) -> Self:
        """Connect to the rig of a site file; raise RigError at once if no rig can be running."""
        book = AddressBook.load(site_file)
        require_rig(book, site_file)
        return cls(book, wanted)

    def listen(self, duration_s: float | None) -> Iterator[ObservedMessage]:
        """Yield the messages received within a time [s], or without end if it is None."""
        deadline = math.inf if duration_s is None else time.monotonic() + duration_s
        while time.monotonic() < deadline:
            self._poller.poll(_WAIT_MS)
            self.notices += self._network.process_events()
            for node, subscriber in self.subscribers.items():
                for received in subscriber.receive():
                    yield ObservedMessage(self.name(node, received.topic, received.message.src), received)

    def tracker(self, name: str, src: str) -> SequenceTracker:
        """Return the sequence statistics of a topic, or of its copy at a site, from a source."""
        topic = name.partition("@")[0]
        for node, subscriber in self.subscribers.items():
            if (topic, src) in subscriber.trackers and self.name(node, topic, src) == name:
                return subscriber.trackers[topic, src]
        return SequenceTracker()

    @staticmethod
    def name(node: str, topic: str, src: str) -> str:
        """Return the topic of a message of a node, or topic@site if it is a copy by the link from the other site."""
        return topic if site_of(src) == site_of(node) else f"{topic}@{site_of(node)}"

    def why_silent(self) -> str:
        """Return the known reasons why nothing was received from the rig; its processes may run all the same."""
        if holders := _holders(self._book):
            nodes = ", ".join(dict.fromkeys(f"{one.node} (process {one.process})" for one in holders))
            return f"it runs all the same, and nothing was received of {nodes}; `telenano estop` stops its devices"
        return RIG_HINT if self._book.spans_machines else absence_text(look(), _paths(self._book))

    def close(self) -> None:
        self._open.close()

    @property
    def silent(self) -> bool:
        """Return whether nothing has been received yet."""
        return not any(subscriber.trackers for subscriber in self.subscribers.values())


def runs_no_node(book: AddressBook) -> bool:
    """Return whether no rig is found: all its sockets would be on this machine, but none exists or is held.

    Sockets of consoles, players and pages do not count, because they remain if such a process is killed.
    """
    return not _has_sockets(book) and not _holders(book)


def _has_sockets(book: AddressBook) -> bool:
    return book.spans_machines or any(path.exists() for path in _paths(book))


def _paths(book: AddressBook) -> list[Path]:
    """Return the paths of the sockets of a rig's nodes, without visitors such as consoles."""
    endpoints = [entry.local for node, entry in book.nodes.items() if not is_visitor(node)]
    return [path_of(local_endpoint(text)) for text in endpoints if text is not None]


def _holders(book: AddressBook) -> list[Holder]:
    """Return the processes that hold the sockets of a rig, whether or not the socket files still exist."""
    seen = look()
    return [holder for path in _paths(book) for holder in seen.at(str(path))]


def require_rig(book: AddressBook, site_file: Path) -> None:
    """Raise RigError if no rig is found, instead of waiting for messages that cannot come.

    If a rig runs but its sockets were removed, wait until it has made them again, for at most 3 s.
    """
    if _has_sockets(book):
        return
    if not (holders := _holders(book)):
        raise RigError(f"{site_file}: no rig of this site file was found here: {absence_text(look(), _paths(book))}")
    end_s = time.monotonic() + _BACK_S
    while not _has_sockets(book):
        if time.monotonic() >= end_s:
            text = f"the rig of {site_file} runs (process {holders[0].process} is {holders[0].node})"
            missing = f"its sockets are not in {holders[0].folder}, and were not made again within {_BACK_S:g} s"
            raise RigError(f"{text}, but {missing}: `telenano estop` stops its devices all the same")
        time.sleep(_RETRY_S)


def list_topics(observer: Observer, duration_s: float) -> list[dict[str, Any]]:
    """Listen for a time [s]; return one row for each topic and source received, and for each silent topic."""
    counts: dict[tuple[str, str], int] = {}
    for observed in observer.listen(duration_s):
        key = (observed.name, observed.received.message.src)
        counts[key] = counts.get(key, 0) + 1
    rows = [_topic_row(name, src, count) for (name, src), count in counts.items()]
    for name in installed_topics():
        row_of(name)
    silent = [name for name in TOPICS if not any(row["topic"] == name for row in rows)]
    rows += [_topic_row(name, ", ".join(TOPICS[name].publishers), 0) for name in silent]
    return sorted(rows, key=lambda row: (list(TOPICS).index(row["topic"].partition("@")[0]), row["topic"], row["src"]))


def _topic_row(name: str, src: str, count: int) -> dict[str, Any]:
    row = TOPICS[name.partition("@")[0]]
    return {"topic": name, "src": src, "rate_hz": row.rate_hz, "delivery": row.delivery, "heard": count}


def messages_of(observer: Observer, name: str, duration_s: float | None, count: int | None) -> Iterator[Received]:
    """Yield the messages of a topic (topic@site: of its copy) until a number of messages or a time [s] is reached."""
    yielded = 0
    for observed in observer.listen(duration_s):
        if observed.name == name:
            yield observed.received
            yielded += 1
            if count is not None and yielded >= count:
                return


def measure(observer: Observer, name: str, duration_s: float | None, count: int | None) -> list[dict[str, Any]]:
    """Return a row for each source of a topic: rate [Hz], gaps, and age on arrival [ms] and size [bytes] of messages.

    Listens for a time [s] or a number of messages, None for no limit, or until interrupted.

    Raises:
        RigError: No source sent two messages.
    """
    samples: dict[str, list[tuple[int, int, int]]] = {}
    with contextlib.suppress(KeyboardInterrupt):
        for received in messages_of(observer, name, duration_s, count):
            age_ns = received.received_ns - received.message.t_ns
            samples.setdefault(received.message.src, []).append((received.received_ns, age_ns, len(received.payload)))
    if max(map(len, samples.values()), default=0) < 2:
        raise RigError(f"fewer than 2 messages were received on {name}: is the rig running with this site file?")
    return [_measured(src, one, observer.tracker(name, src)) for src, one in sorted(samples.items())]


def _measured(src: str, samples: list[tuple[int, int, int]], tracker: SequenceTracker) -> dict[str, Any]:
    arrivals_ns, ages_ns, sizes = zip(*samples, strict=True)
    intervals_s = np.diff(arrivals_ns) * 1e-9
    span_s = float(intervals_s.sum())
    p50, p99 = np.percentile(np.array(ages_ns) * 1e-6, [50.0, 99.0])
    return {
        "src": src,
        "messages": len(sizes),
        "rate_hz": len(intervals_s) / span_s if span_s > 0.0 else None,
        "interval_std_ms": float(intervals_s.std() * 1e3) if len(intervals_s) else None,
        "gaps": tracker.gaps,
        "lost": tracker.lost,
        "age_p50_ms": float(p50),
        "age_p99_ms": float(p99),
        "age_max_ms": max(ages_ns) * 1e-6,
        "mean_bytes": sum(sizes) / len(sizes),
        "most_bytes": max(sizes),
        "bytes_per_s": sum(sizes[1:]) / span_s if span_s > 0.0 else None,
    }
