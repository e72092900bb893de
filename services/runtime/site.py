"""The site file: where each node binds, and who publishes a topic for a reader at a given site."""

import os
import re
import tempfile
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Annotated, Self

from pydantic import BaseModel, ConfigDict, Field, model_validator

from proto.messages import SOURCE_PATTERN
from proto.topics import TOPICS, Topic

LINK_NODE = "delay_node"
RUNTIME_DIRECTORY_VARIABLE = "TELENANO_RUNTIME_DIR"
_LOOPBACK = re.compile(r"tcp://(127\.[0-9]+\.[0-9]+\.[0-9]+|localhost|\[::1\]):([0-9]+)")
_TCP = re.compile(r"tcp://(\[[0-9a-fA-F:.]+\]|[A-Za-z0-9_.-]+):([0-9]{1,5})")
# sun_path holds 108 bytes on Linux, with its closing zero
_LONGEST_IPC_PATH = 107

NodeKey = Annotated[str, Field(pattern=SOURCE_PATTERN)]


def site_of(node: str) -> str:
    """Give the site of `node@site`."""
    return node.partition("@")[2]


def runtime_directory() -> Path:
    """Give the private folder of ipc sockets: TELENANO_RUNTIME_DIR, or one of this user's own."""
    named = os.environ.get(RUNTIME_DIRECTORY_VARIABLE)
    if named:
        return Path(named)
    user_directory = os.environ.get("XDG_RUNTIME_DIR")
    if user_directory:
        return Path(user_directory) / "telenano"
    return Path(tempfile.gettempdir()) / f"telenano-{os.getuid()}"


class SiteBook(BaseModel):
    """The address book of a rig.

    `{runtime}` in an endpoint stands for the private folder of `runtime_directory`. A reader at one site reaches
    a publisher at the other only through the link, which republishes on a socket of its own at each site.
    """

    model_config = ConfigDict(frozen=True, strict=True, extra="forbid")

    nodes: dict[NodeKey, str] = Field(description="Endpoint that each node binds: ipc://path or tcp://host:port")
    insecure: bool = Field(default=False, description="Allow plain tcp:// beyond the loopback interface")

    @model_validator(mode="after")
    def _check_endpoints(self) -> Self:
        seen: dict[str, str] = {}
        for node, endpoint in self.nodes.items():
            _check_endpoint(node, endpoint, insecure=self.insecure)
            resolved = self.endpoint(node)
            if resolved in seen:
                raise ValueError(f"nodes.{node}: {endpoint} is the endpoint of {seen[resolved]} already")
            seen[resolved] = node
        return self

    def endpoint(self, node: str) -> str:
        """Give the endpoint that `node` binds; KeyError text names the nodes that the book has."""
        if node not in self.nodes:
            raise KeyError(f"{node} is not in the site file, it has {', '.join(sorted(self.nodes))}")
        return self.nodes[node].replace("{runtime}", str(runtime_directory()))

    def sources(self, reader: str, topics: list[str]) -> dict[str, list[str]]:
        """Say which nodes a reader connects to and which topics it asks each for.

        Parameters: reader, node@site; topics, names from the topic table.
        Returns: publisher -> topics, only where the publisher is in the book.
        """
        plan: dict[str, list[str]] = {}
        for name in topics:
            for publisher in self._reachable_publishers(reader, TOPICS[name]):
                if publisher != reader:
                    plan.setdefault(publisher, []).append(name)
        return plan

    def observed(self) -> dict[str, list[str]]:
        """Say what an observer with access to every endpoint connects to: each node, every topic it may send."""
        return {node: self.published_by(node) for node in self.nodes}

    def bridged_from(self, site: str) -> dict[str, list[str]]:
        """Say what the link connects to at a site: each node there, the topics that cross to the other site."""
        away = "slave" if site == "master" else "master"
        plan = {
            node: [name for name, topic in TOPICS.items() if _publishes(topic, node) and _crosses(topic, to_site=away)]
            for node in self.nodes
            if site_of(node) == site and node.partition("@")[0] != LINK_NODE
        }
        return {node: topics for node, topics in plan.items() if topics}

    def published_by(self, node: str) -> list[str]:
        """Give the topics that can be heard at a node's endpoint, the bridged ones included."""
        own = [name for name, topic in TOPICS.items() if _publishes(topic, node)]
        if node.partition("@")[0] == LINK_NODE:
            own += [name for name, topic in TOPICS.items() if _crosses(topic, to_site=site_of(node))]
        return list(dict.fromkeys(own))

    def _reachable_publishers(self, reader: str, topic: Topic) -> list[str]:
        here = site_of(reader)
        found = [node for node in self.nodes if _publishes(topic, node) and site_of(node) == here]
        far = any(_publishes(topic, node) and site_of(node) != here for node in self.nodes)
        link = f"{LINK_NODE}@{here}"
        if far and link in self.nodes and _crosses(topic, to_site=here) and link not in found:
            found.append(link)
        return found


def _publishes(topic: Topic, node: str) -> bool:
    name = node.partition("@")[0]
    return any(fnmatchcase(node, pattern) or name == pattern for pattern in topic.publishers)


def _crosses(topic: Topic, to_site: str) -> bool:
    return topic.bridged in (("forward", "both") if to_site == "slave" else ("backward", "both"))


def _check_endpoint(node: str, endpoint: str, *, insecure: bool) -> None:
    if endpoint.startswith("ipc://"):
        path = endpoint.removeprefix("ipc://").replace("{runtime}", str(runtime_directory()))
        if not path.startswith("/"):
            raise ValueError(f"nodes.{node}: {endpoint} needs an absolute path, such as ipc://{{runtime}}/{node}")
        if len(os.fsencode(path)) > _LONGEST_IPC_PATH:
            raise ValueError(f"nodes.{node}: {path} is longer than the {_LONGEST_IPC_PATH} bytes of a socket path")
        return
    match = _TCP.fullmatch(endpoint)
    if match is None or not 1 <= int(match.group(2)) <= 65535:
        raise ValueError(f"nodes.{node}: {endpoint} is neither ipc:///absolute/path nor tcp://host:port (1-65535)")
    if not insecure and not _LOOPBACK.fullmatch(endpoint):
        raise ValueError(f"nodes.{node}: {endpoint} is plain tcp beyond loopback, which needs insecure: true")
