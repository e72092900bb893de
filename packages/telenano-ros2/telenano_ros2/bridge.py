"""A running rig in ROS 2, without an installation of it: topics that `ros2 topic list` shows, over rmw_zenoh."""

import dataclasses
import importlib
import logging
from collections.abc import Callable, Iterable
from typing import Any, Protocol

from telenano.recording import RecordedMessage
from telenano.wire import ConfigError, RecordingError
from telenano_ros2.crtk import TOPICS_IN, Encoder, definitions

DEFAULT_ROUTER = "127.0.0.1:7447"
_NODE = "telenano"
_SDK = "zenoh_ros2_sdk"


class Publisher(Protocol):
    """What a topic is published by."""

    def publish(self, **fields: Any) -> None:
        """Send a message of these fields."""

    def close(self) -> None:
        """Take the topic out of the graph."""


# topic with a leading /, type, definition and hash
Opens = Callable[[str, str, str, str], Publisher]


class Ros2Bridge:
    """Hands the messages of a rig on."""

    def __init__(self, open_publisher: Opens, namespace: str = "") -> None:
        """Prepare a bridge without topics: each is opened with its first message.

        Args:
            open_publisher: Opens a topic.
            namespace: What stands before the names of the topics.
        """
        self.sent = 0
        self._encoder = Encoder()
        self._open = open_publisher
        self._prefix = f"/{namespace.strip('/')}/" if namespace.strip("/") else "/"
        self._publishers: dict[str, Publisher] = {}

    def run(self, messages: Iterable[RecordedMessage]) -> None:
        """Publish messages until there are no more; what cannot be decoded is left out."""
        for message in messages:
            if message.topic in TOPICS_IN and message.channel_topic == message.topic:
                self._publish(message)

    def close(self) -> None:
        """Take the topics out of the graph."""
        for publisher in self._publishers.values():
            publisher.close()

    def _publish(self, message: RecordedMessage) -> None:
        try:
            messages = list(self._encoder.messages(message.topic, message.topic, message.publish_ns, message.plain()))
        except (RecordingError, KeyError, TypeError, ValueError):
            return
        for made in messages:
            topic = self._prefix + made.topic
            if topic not in self._publishers:
                definition = definitions()[made.kind]
                self._publishers[topic] = self._open(topic, made.kind, definition, self._encoder.type_hash(made.kind))
            parts = {part.name: getattr(made.message, part.name) for part in dataclasses.fields(made.message)}
            self._publishers[topic].publish(**{name: part for name, part in parts.items() if name[0] != "_"})
            self.sent += 1


def zenoh_publishers(router: str, domain: int) -> Opens:
    """Connect to a router of rmw_zenoh, and return what opens a topic there.

    Args:
        router: Its address, host:port. A router that does not answer yet is tried again.
        domain: The domain of ROS.

    Raises:
        ConfigError: The address is none, or a package that is needed is not installed.
    """
    host, _, port = router.rpartition(":")
    if not host or not port.isdigit() or not 0 < int(port) < 65536:
        raise ConfigError(f"--router {router}: must be host:port, as {DEFAULT_ROUTER}")
    try:
        sdk = importlib.import_module(_SDK)
        session = importlib.import_module(f"{_SDK}.session").ZenohSession.get_instance(host, int(port))
    except ImportError as error:
        package = (error.name or _SDK).partition(".")[0].replace("_", "-")
        raise ConfigError(f"the bridge to ROS 2 needs the package {package}: pip install {package}") from error
    logging.getLogger(_SDK).setLevel(logging.WARNING)
    # The library would fetch definitions that it does not know from the network.
    for kind, text in definitions().items():
        session.register_message_type(text, kind)

    def open_publisher(topic: str, kind: str, definition: str, type_hash: str) -> Publisher:
        publisher: Publisher = sdk.ROS2Publisher(
            topic=topic,
            msg_type=kind,
            msg_definition=definition,
            node_name=_NODE,
            domain_id=domain,
            router_ip=host,
            router_port=int(port),
            type_hash=type_hash,
        )
        return publisher

    return open_publisher


def is_connected() -> bool:
    """Return whether a router, or another process of ROS, is connected now."""
    info = importlib.import_module(f"{_SDK}.session").ZenohSession._instance.session.info
    return bool(info.routers_zid() or info.peers_zid())


def close_session() -> None:
    """Close the connection to the router, if there is one; the library keeps one for the process."""
    kept = importlib.import_module(f"{_SDK}.session").ZenohSession
    if kept._instance is not None:
        kept._instance.close()
