"""The graph of a rig: the publisher of each topic, its readers, and its rate."""

from typing import NamedTuple

from services.afm_node.node import INPUTS as AFM_INPUTS
from services.controller.__main__ import HALVES
from services.haptic_node.node import INPUTS as HAPTIC_INPUTS
from telenano.wire.nodes import LINK, START_ORDER, VIEW, name_of, site_of
from telenano.wire.topics import OWN_TOPICS as TOPICS
from telenano.wire.topics import Topic

# Topics that every node sends, and only people and the launcher read; they would hide the loop.
_EVERYBODY = ("node/health", "session/event", "node/journal", "session/control")
_INPUTS = {
    "haptic_node@master": HAPTIC_INPUTS,
    "controller@master": HALVES["master"].inputs,
    "controller@slave": HALVES["slave"].inputs,
    "afm_node@slave": AFM_INPUTS,
}


class Edge(NamedTuple):
    """A topic from its publisher to a reader; rate_hz is None for a topic that is sent on change."""

    source: str
    reader: str
    topic: str
    rate_hz: float | None


def edges() -> list[Edge]:
    """Return the graph of the loop."""
    found = []
    for topic in TOPICS.values():
        if topic.name in _EVERYBODY:
            continue
        for reader, inputs in _INPUTS.items():
            if topic.name in inputs:
                found += [
                    Edge(*pair, topic.name, topic.rate_hz)
                    for source in _sources(topic)
                    for pair in _way(topic, source, reader)
                ]
    # A node that reads a topic that it also publishes reads that of the other site.
    return [edge for edge in dict.fromkeys(found) if edge.source != edge.reader]


def _sources(topic: Topic) -> list[str]:
    nodes = [*START_ORDER, f"{LINK}@slave", VIEW]
    return [node for node in nodes if any(node == name or name_of(node) == name for name in topic.publishers)]


def _way(topic: Topic, source: str, reader: str) -> list[tuple[str, str]]:
    """Return the hops of a topic from its source to a reader; to the other site it passes through the link."""
    link = f"{LINK}@master"
    if name_of(source) == LINK:
        # The link has an endpoint at each site, but is one process.
        return [(link, reader)] if source == f"{LINK}@{site_of(reader)}" else []
    if site_of(source) == site_of(reader):
        return [(source, reader)]
    if topic.bridged is None or (topic.bridged == "forward") != (site_of(reader) == "slave"):
        return []
    return [(source, link), (link, reader)]
