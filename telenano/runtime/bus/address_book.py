"""The site file: the endpoints of the nodes, and the publishers of a topic that a reader at a site can reach."""

import contextlib
import ipaddress
import os
import re
import socket
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Self

from pydantic import BeforeValidator, ConfigDict, Field, model_validator

from telenano.runtime.bus.local_endpoint import (
    LONGEST_IPC_PATH,
    estop_endpoint,
    is_in_runtime_directory,
    kept_stop_path,
    local_endpoint,
)
from telenano.runtime.bus.transports import AUTO, check_link
from telenano.settings.config import M, Settings, read_yaml, validate
from telenano.settings.package_topics import row_of
from telenano.wire.errors import EndpointError
from telenano.wire.messages import SOURCE_PATTERN
from telenano.wire.nodes import LINK, name_of, site_of
from telenano.wire.topics import TOPICS, Topic

# The machine on which the link runs, with its endpoints for both sites.
LINK_MACHINE = "master"
BIND_ADDRESS_VARIABLE = "TELENANO_BIND_ADDRESS"
HOST_VARIABLE_PREFIX = "TELENANO_HOST_"
# With a relay, nodes of other machines are reached at local addresses with this prefix, one address per machine.
_RELAYED = "127.77.0."
# With a relay, nodes bind this other address, so that both sites can be tried on one machine.
_RELAYED_BIND = "127.0.0.1"
RELAY_VARIABLE = "TELENANO_RELAY"
MACHINE_PATTERN = r"^[a-z][a-z0-9_]{0,31}$"
_TCP = re.compile(r"tcp://(\[[0-9a-fA-F:.]+\]|[A-Za-z0-9_.-]+):([0-9]{1,5})")
_PLACEHOLDER = re.compile(r"\{([^{}]*)\}")
_NO_ENDPOINT = "is neither ipc:///absolute/path nor tcp://host:port (1-65535)"

NodeKey = Annotated[str, Field(pattern=SOURCE_PATTERN)]
MachineName = Annotated[str, Field(pattern=MACHINE_PATTERN)]


class NodeEntry(Settings):
    """The endpoints of a node: `local` for readers on its machine, `network` for those on other machines."""

    local: str | None = Field(default=None, description="ipc:///absolute/path for readers on the same machine")
    network: str | None = Field(default=None, description="tcp://host:port for readers on other machines")
    machine: MachineName | None = Field(
        default=None,
        description="Machine on which the node runs; default: the node's site, and master for the link",
    )

    @model_validator(mode="after")
    def _check(self) -> Self:
        if self.local is None and self.network is None:
            raise ValueError("local, network or both are needed")
        if self.local is not None and not self.local.startswith("ipc://"):
            raise ValueError(f"local: {self.local} is not of the form ipc:///absolute/path")
        if self.network is not None and not self.network.startswith("tcp://"):
            raise ValueError(f"network: {self.network} is not of the form tcp://host:port")
        return self


class LinkSection(Settings):
    """Transport of the link between two machines; the other keys are those of the transport, which a package brings."""

    model_config = ConfigDict(extra="allow")

    transport: str = Field(
        default=AUTO,
        description="stream: over TCP; auto: by datagrams where the package that has them is installed, and over TCP "
        "while none arrives; else the name of a transport, such as datagram",
    )

    def read(self, model: type[M]) -> M:
        """Return the section as the model of a transport; raise ConfigError, which names an invalid key."""
        return validate(model, {"transport": self.transport, **(self.model_extra or {})}, "site file", "link")


def _as_entry(value: object) -> object:
    """Return an entry as a mapping, even if the file has only one endpoint as text; ValueError for other text."""
    if isinstance(value, str):
        if not value.startswith(("ipc://", "tcp://")):
            raise ValueError(_NO_ENDPOINT)
        return {"network" if value.startswith("tcp://") else "local": value}
    return value


class AddressBook(Settings):
    """The address book of a rig.

    `{runtime}` in an ipc endpoint stands for the private folder of `runtime_directory`, and `{NAME}` in a tcp endpoint
    for the address of the machine NAME. A reader at one site reaches a publisher at the other only through the link,
    which republishes on a socket of its own at each site.
    """

    machines: dict[MachineName, str] = Field(
        default={}, description="Address of each machine; TELENANO_HOST_NAME in the environment replaces that of NAME"
    )
    bind: dict[MachineName, str] = Field(
        default={},
        description="Address that a machine binds instead of its own, such as 0.0.0.0 behind a router; "
        "TELENANO_BIND_ADDRESS in the environment replaces it",
    )
    nodes: dict[NodeKey, Annotated[NodeEntry, BeforeValidator(_as_entry)]] = Field(
        description="Endpoint that each node binds: ipc://path or tcp://host:port, or both as local and network"
    )
    link: LinkSection = Field(default=LinkSection(), description="Transport of the link between two machines")
    relay: str | None = Field(
        default_factory=lambda: os.environ.get(RELAY_VARIABLE) or None,
        description="host:port of a relay (`telenano relay`) between machines that can only dial out, instead of the "
        "addresses in `machines`; default: TELENANO_RELAY in the environment",
    )
    insecure: bool = Field(
        default=False, description="Plain tcp:// without keys: every process that reaches a port can read it"
    )

    @model_validator(mode="after")
    def _check_endpoints(self) -> Self:
        unused = sorted(set(self.bind) - {self.machine_of(node) for node in self.nodes})
        if unused:
            raise ValueError(f"bind.{unused[0]}: no node runs on this machine")
        if self.relay is not None and self.insecure:
            raise ValueError("relay: a relay carries encrypted connections only; remove `insecure: true`")
        if self.relay is not None and not _is_tcp(f"tcp://{self.relay}"):
            raise ValueError(f"relay: {self.relay} is not of the form host:port (1-65535), such as 198.51.100.7:5750")
        seen: dict[str, str] = {}
        for node in self.nodes:
            for endpoint in (self.local_endpoint(node), self.network_endpoint(node)):
                if endpoint is None:
                    continue
                _check_endpoint(node, endpoint)
                if endpoint in seen:
                    raise ValueError(f"nodes.{node}: {endpoint} is already the endpoint of {seen[endpoint]}")
                seen[endpoint] = node
        return self

    @property
    def spans_machines(self) -> bool:
        """Whether some node is reached over a network."""
        return any(self.network_endpoint(node) for node in self.nodes)

    @property
    def uses_runtime_directory(self) -> bool:
        """Whether some node has its socket in the private folder."""
        return any(is_in_runtime_directory(entry.local or "") for entry in self.nodes.values())

    @property
    def requires_keys(self) -> bool:
        """Whether machines authenticate to one another: over a network, unless the file has `insecure: true`."""
        return self.spans_machines and not self.insecure

    def machine_of(self, node: str) -> str:
        """Return the machine on which a node runs; both endpoints of the link are on the same machine by default."""
        named = self._entry(node).machine
        if named is not None:
            return named
        return LINK_MACHINE if name_of(node) == LINK else site_of(node)

    def local_endpoint(self, node: str) -> str | None:
        """Return the ipc endpoint of a node, None if it has none."""
        local = self._entry(node).local
        return None if local is None else local_endpoint(local)

    def estop_endpoint(self, node: str) -> str | None:
        """Return the endpoint for emergency stops of a node; None if it has no ipc endpoint or the path is too long."""
        local = self.local_endpoint(node)
        endpoint = "" if local is None else estop_endpoint(local)
        return endpoint if 0 < len(os.fsencode(endpoint.removeprefix("ipc://"))) <= LONGEST_IPC_PATH else None

    def kept_stop(self, node: str) -> Path | None:
        """Return the file that keeps an emergency stop for a node; None if the node has no endpoint for such stops."""
        local = self.local_endpoint(node)
        return None if local is None or self.estop_endpoint(node) is None else kept_stop_path(local)

    def network_endpoint(self, node: str) -> str | None:
        """Return the tcp endpoint at which other machines reach a node, None if it has none.

        Raises:
            ValueError: The endpoint names a machine that is not in `machines`.
        """
        network = self._entry(node).network
        if network is None:
            return None
        port = network.rpartition(":")[2]
        if self.relay is not None and port.isdecimal():
            machines = sorted({self.machine_of(other) for other in self.nodes})
            return f"tcp://{_RELAYED}{machines.index(self.machine_of(node)) + 1}:{port}"
        named = {name: os.environ.get(HOST_VARIABLE_PREFIX + name.upper()) for name in self.machines}
        hosts = {name: named[name] or host for name, host in self.machines.items()}
        for name in _PLACEHOLDER.findall(network):
            if name not in hosts:
                shown = ", ".join(hosts) or "none"
                raise ValueError(f"nodes.{node}: {network}: {{{name}}} is not in `machines`, which has {shown}")
        return _PLACEHOLDER.sub(lambda found: hosts[found.group(1)], network)

    def bind_endpoint(self, node: str) -> str | None:
        """Return the tcp endpoint that a node itself binds; raise EndpointError if its host name cannot be resolved."""
        endpoint = self.network_endpoint(node)
        match = _TCP.fullmatch(endpoint or "")
        if endpoint is None or match is None:
            return endpoint
        if self.relay is not None:
            return f"tcp://{_RELAYED_BIND}:{match.group(2)}"
        named = os.environ.get(BIND_ADDRESS_VARIABLE) or self.bind.get(self.machine_of(node))
        return f"tcp://{named or _numeric(node, match.group(1))}:{match.group(2)}"

    def endpoint(self, node: str, reader: str | None = None) -> str:
        """Return the endpoint at which a reader reaches `node`; raise KeyError, which lists the nodes, if unknown.

        Args:
            node: The node.
            reader: The machine of the reader; None for the machine of the node.
        """
        local, network = self.local_endpoint(node), self.network_endpoint(node)
        if local is not None and (network is None or reader in (None, self.machine_of(node))):
            return local
        return network or ""

    def connect_endpoint(self, node: str, reader: str) -> str:
        """Return the endpoint at which a reader reaches `node`, with its host name resolved if that is possible now.

        libzmq would resolve the name before each attempt, in the thread that moves all messages of a process, which may
        take many seconds while a network is down.
        """
        endpoint = self.endpoint(node, reader)
        match = _TCP.fullmatch(endpoint)
        if match is None:
            return endpoint
        with contextlib.suppress(EndpointError):
            return f"tcp://{_numeric(node, match.group(1))}:{match.group(2)}"
        return endpoint

    def reaches(self, reader: str | None, node: str) -> bool:
        """Return whether a reader on a machine can connect to a node: ipc does not cross machines."""
        near = reader in (None, self.machine_of(node)) or not self.spans_machines
        return near or self.network_endpoint(node) is not None

    def sources(self, reader: str, topics: Sequence[str]) -> dict[str, list[str]]:
        """Return the nodes to which a reader connects, each with the topics to subscribe to there.

        Args:
            reader: The reader as node@site.
            topics: Topics of the topic table.

        Returns:
            The topics by publisher, only for publishers in the book.
        """
        plan: dict[str, list[str]] = {}
        for name in topics:
            for publisher in self._reachable_publishers(reader, row_of(name) or TOPICS[name]):
                if publisher != reader:
                    plan.setdefault(publisher, []).append(name)
        return plan

    def observed(self, reader: str | None = None, sites: Sequence[str] = ("master", "slave")) -> dict[str, list[str]]:
        """Return the nodes to which an observer connects: all at `sites` that its machine reaches, with their topics.

        Args:
            reader: The machine of the observer; None if every node can be reached.
            sites: The sites of the nodes.
        """
        reached = [node for node in self.nodes if site_of(node) in sites and self.reaches(reader, node)]
        return {node: self.published_by(node) for node in reached}

    def bridged_from(self, site: str) -> dict[str, list[str]]:
        """Return the nodes to which the link connects at a site, each with its topics that cross to the other site."""
        away = "slave" if site == "master" else "master"
        link = f"{LINK}@{site}"
        reader = self.machine_of(link) if link in self.nodes else None
        plan = {
            node: [
                name for name, topic in TOPICS.items() if topic.is_published_by(node) and _crosses(topic, to_site=away)
            ]
            for node in self.nodes
            if site_of(node) == site and name_of(node) != LINK and self.reaches(reader, node)
        }
        return {node: topics for node, topics in plan.items() if topics}

    def published_by(self, node: str) -> list[str]:
        """Return the topics published at a node's endpoint, including the bridged ones."""
        own = [name for name, topic in TOPICS.items() if topic.is_published_by(node)]
        if name_of(node) == LINK:
            own += [name for name, topic in TOPICS.items() if _crosses(topic, to_site=site_of(node))]
        return list(dict.fromkeys(own))

    def _entry(self, node: str) -> NodeEntry:
        if node not in self.nodes:
            raise KeyError(f"{node} is not in the site file, which has {', '.join(sorted(self.nodes))}")
        return self.nodes[node]

    def _reachable_publishers(self, reader: str, topic: Topic) -> list[str]:
        here = site_of(reader)
        machine = self.machine_of(reader) if reader in self.nodes else here
        reachable = [
            node
            for node in self.nodes
            if topic.is_published_by(node) and site_of(node) == here and self.reaches(machine, node)
        ]
        # Senders of emergency stops have no endpoint, and so are in no site file.
        far = topic.is_published_by(f"estop@{here}") or any(
            topic.is_published_by(node) and site_of(node) != here for node in self.nodes
        )
        link = f"{LINK}@{here}"
        if far and link in self.nodes and _crosses(topic, to_site=here) and link not in reachable:
            reachable.append(link)
        return reachable

    @classmethod
    def load(cls, path: Path) -> "AddressBook":
        """Read a site file; raise ConfigError, which names file and key, if it is invalid."""
        book = validate(AddressBook, read_yaml(path), str(path))
        if book.spans_machines:
            relayed = book.relay is not None
            check_link(book.link.transport, book.link.model_extra or {}, str(path), relayed=relayed)
        return book


def is_relayed(endpoint: str) -> bool:
    """Return whether an endpoint is a local address at which a relay makes another machine reachable."""
    return endpoint.startswith(f"tcp://{_RELAYED}")


def may_carry(node: str, src: str) -> bool:
    """Return whether the socket of `node` may send a message of `src`: its own, or one that the link bridges there."""
    name, _, site = node.partition("@")
    if name != LINK:
        return src == node
    return name_of(src) == LINK or site_of(src) != site


def _crosses(topic: Topic, to_site: str) -> bool:
    return topic.bridged in (("forward", "both") if to_site == "slave" else ("backward", "both"))


def _numeric(node: str, host: str) -> str:
    """Return the numeric address of a host, because libzmq binds no names; EndpointError if it cannot be resolved."""
    try:
        ipaddress.ip_address(host.strip("[]"))
    except ValueError:
        try:
            return str(socket.getaddrinfo(host, None, socket.AF_INET)[0][4][0])
        except OSError as error:
            raise EndpointError(
                f"{node} cannot bind {host}: the name cannot be resolved ({error.strerror}): give an address, or "
                f"{BIND_ADDRESS_VARIABLE}=0.0.0.0 to bind every interface"
            ) from error
    return host


def _check_endpoint(node: str, endpoint: str) -> None:
    if endpoint.startswith("ipc://"):
        path = endpoint.removeprefix("ipc://")
        if not path.startswith("/"):
            raise ValueError(f"nodes.{node}: {endpoint} needs an absolute path, such as ipc://{{runtime}}/{node}")
        if len(os.fsencode(path)) > LONGEST_IPC_PATH:
            raise ValueError(f"nodes.{node}: {path} is longer than the {LONGEST_IPC_PATH} bytes of a socket path")
        return
    if not _is_tcp(endpoint):
        raise ValueError(f"nodes.{node}: {endpoint} {_NO_ENDPOINT}{_bracket_hint(endpoint)}")


def _is_tcp(endpoint: str) -> bool:
    match = _TCP.fullmatch(endpoint)
    return match is not None and 1 <= int(match.group(2)) <= 65535


def _bracket_hint(endpoint: str) -> str:
    """Return a hint if an endpoint is an IPv6 address without brackets, whose colons hide that of the port, else ""."""
    host, _, port = endpoint.removeprefix("tcp://").rpartition(":")
    try:
        ipaddress.IPv6Address(host.partition("%")[0])
    except ValueError:
        return ""
    return f"; write an IPv6 address in brackets, in `machines` and in the environment too: tcp://[{host}]:{port}"
