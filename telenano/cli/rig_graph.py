"""The graph of a rig: which node publishes a topic, who reads it, and how often it is sent."""

from collections.abc import Mapping
from typing import NamedTuple

from proto import TOPICS
from proto.nodes import LINK, START_ORDER, VIEW, name_of, site_of
from proto.topics import Topic
from services.afm_node.node import INPUTS as AFM_INPUTS
from services.controller.__main__ import HALVES
from services.haptic_node.node import INPUTS as HAPTIC_INPUTS

# Every node sends these topics, and only people and the launcher read them; they would hide the loop.
_EVERYBODY = ("node/health", "session/event", "node/journal", "session/control")
_INPUTS = {
    "haptic_node@master": HAPTIC_INPUTS,
    "controller@master": HALVES["master"].inputs,
    "controller@slave": HALVES["slave"].inputs,
    "afm_node@slave": AFM_INPUTS,
}


class Edge(NamedTuple):
    """A topic from its publisher to a reader; rate_hz is None for one that is sent on change."""

    source: str
    reader: str
    topic: str
    rate_hz: float | None


def edges(measured_hz: Mapping[str, float] | None = None) -> list[Edge]:
    """Return the graph of the loop; with measured rates by topic in the place of the declared ones."""
    found = []
    for topic in TOPICS.values():
        if topic.name in _EVERYBODY:
            continue
        rate = topic.rate_hz if measured_hz is None else measured_hz.get(topic.name)
        for reader, inputs in _INPUTS.items():
            if topic.name in inputs:
                found += [
                    Edge(*pair, topic.name, rate) for source in _sources(topic) for pair in _way(topic, source, reader)
                ]
    # a node that reads its own topic means the same topic of the other site
    return [edge for edge in dict.fromkeys(found) if edge.source != edge.reader]


def _sources(topic: Topic) -> list[str]:
    nodes = [*START_ORDER, f"{LINK}@slave", VIEW]
    return [node for node in nodes if any(node == name or name_of(node) == name for name in topic.publishers)]


def _way(topic: Topic, source: str, reader: str) -> list[tuple[str, str]]:
    """Return the pairs that a topic passes from its source to a reader: through the link to the other site."""
    link = f"{LINK}@master"
    if name_of(source) == LINK:
        # the link has an endpoint at each site, which is the same process
        return [(link, reader)] if source == f"{LINK}@{site_of(reader)}" else []
    if site_of(source) == site_of(reader):
        return [(source, reader)]
    if topic.bridged is None or (topic.bridged == "forward") != (site_of(reader) == "slave"):
        return []
    return [(source, link), (link, reader)]


def mermaid(found: list[Edge]) -> str:
    """Return the graph as a Mermaid flowchart, one box a site."""
    lines = ["flowchart LR"]
    nodes = sorted({node for edge in found for node in edge[:2]})
    for site in ("master", "slave"):
        lines.append(f"  subgraph {site}")
        lines += [
            f'    {_name(node)}["{name_of(node)}"]' for node in nodes if site_of(node) == site and not _is_link(node)
        ]
        lines.append("  end")
    lines += [f'  {_name(node)}(["{name_of(node)}: the link"])' for node in nodes if _is_link(node)]
    lines += [f'  {_name(source)} -->|"{words}"| {_name(reader)}' for (source, reader), words in _labels(found).items()]
    return "\n".join(lines)


def dot(found: list[Edge]) -> str:
    """Return the graph in the language of Graphviz."""
    lines = ["digraph telenano {", "  rankdir=LR;", "  node [shape=box];"]
    for (source, reader), words in _labels(found).items():
        lines.append(f'  "{source}" -> "{reader}" [label="{words}"];')
    return "\n".join([*lines, "}"])


def _labels(found: list[Edge]) -> dict[tuple[str, str], str]:
    labels: dict[tuple[str, str], list[str]] = {}
    for edge in found:
        rate = "" if edge.rate_hz is None else f" {edge.rate_hz:.4g} Hz"
        labels.setdefault((edge.source, edge.reader), []).append(f"{edge.topic}{rate}")
    return {pair: ", ".join(words) for pair, words in labels.items()}


def _is_link(node: str) -> bool:
    return name_of(node) == LINK


def _name(node: str) -> str:
    return node.replace("@", "_")
