"""Publishes a running rig in ROS 2 over rmw_zenoh, as topics that `ros2 topic list` shows; ROS is not needed here."""

import contextlib
import dataclasses
import importlib
import json
import logging
from collections.abc import Callable, Iterable, Iterator, Mapping
from pathlib import Path
from typing import Annotated, Any, NamedTuple, Protocol

import typer
from rosbags import typesys

from telenano.cli import DurationOption, SiteFileOption, report_errors, say
from telenano.console import LiveRecording, hand_on, live_rig
from telenano.recording import (
    CopyResult,
    RecordedChannel,
    RecordedMessage,
    Recording,
    Selection,
    write_mcap,
)
from telenano.settings import DEFAULT_SITE_FILE
from telenano.wire import ConfigError, RecordingError

# Message types of the package geometry_msgs.
POSE = "PoseStamped"
TWIST = "TwistStamped"
WRENCH = "WrenchStamped"
# The definitions of the messages used here, unchanged since the first release of ROS 2.
_DEFINITIONS = {
    "builtin_interfaces/msg/Time": "int32 sec\nuint32 nanosec",
    "std_msgs/msg/Header": "builtin_interfaces/Time stamp\nstring frame_id",
    "std_msgs/msg/String": "string data",
    "geometry_msgs/msg/Point": "float64 x\nfloat64 y\nfloat64 z",
    "geometry_msgs/msg/Vector3": "float64 x\nfloat64 y\nfloat64 z",
    "geometry_msgs/msg/Quaternion": "float64 x\nfloat64 y\nfloat64 z\nfloat64 w",
    "geometry_msgs/msg/Pose": "geometry_msgs/Point position\ngeometry_msgs/Quaternion orientation",
    "geometry_msgs/msg/Twist": "geometry_msgs/Vector3 linear\ngeometry_msgs/Vector3 angular",
    "geometry_msgs/msg/Wrench": "geometry_msgs/Vector3 force\ngeometry_msgs/Vector3 torque",
    "geometry_msgs/msg/PoseStamped": "std_msgs/Header header\ngeometry_msgs/Pose pose",
    "geometry_msgs/msg/TwistStamped": "std_msgs/Header header\ngeometry_msgs/Twist twist",
    "geometry_msgs/msg/WrenchStamped": "std_msgs/Header header\ngeometry_msgs/Wrench wrench",
}
TEXT = "std_msgs/msg/String"
_LINE = "=" * 80

Vector = tuple[float, float, float]
Fields = Mapping[str, Any]


class Output(NamedTuple):
    """A topic of ROS 2: its name, its message type, and the function from our fields to its vector, or None."""

    name: str
    kind: str
    value: Callable[[Fields], Vector | None]


def _field(name: str) -> Callable[[Fields], Vector | None]:
    return lambda fields: fields[name]


def _in_mode(mode: str, name: str) -> Callable[[Fields], Vector | None]:
    return lambda fields: fields[name] if fields["mode"] == mode else None


def _tip(fields: Fields) -> Vector:
    """Return the position of the tip [m]; deflection and z both count away from the sample, so they add."""
    x, y, z = fields["base_position_m"]
    return x, y, z + fields["deflection_m"]


CRTK = {
    "haptic/state": (
        Output("hand/measured_cp", POSE, _field("position_m")),
        Output("hand/measured_cv", TWIST, _field("velocity_m_per_s")),
        Output("hand/measured_cf", WRENCH, _field("operator_force_n")),
        Output("hand/setpoint_cp", POSE, _in_mode("position", "reference_m")),
        Output("hand/setpoint_cf", WRENCH, _field("motor_force_n")),
    ),
    "haptic/command": (
        Output("hand/servo_cp", POSE, _in_mode("position", "position_m")),
        Output("hand/servo_cf", WRENCH, _in_mode("force", "force_n")),
    ),
    "afm/state": (
        Output("tip/measured_cp", POSE, _tip),
        Output("tip/measured_cf", WRENCH, _field("tip_force_n")),
        Output("tip/setpoint_cp", POSE, _field("base_position_m")),
    ),
    "afm/command": (Output("tip/servo_cp", POSE, _in_mode("position", "base_position_m")),),
}
# Topics published as JSON texts: they come a few times a second, or on events.
TEXTS = ("session/event", "session/control", "law/status", "link/status", "node/health")
TOPICS_IN = (*CRTK, *TEXTS)
_FRAMES = {"hand": "master", "tip": "afm"}


class Ros2Message(NamedTuple):
    """A message of ROS 2: topic without a leading /, type, and the object with its fields."""

    topic: str
    kind: str
    message: Any


class Encoder:
    """Converts messages of a rig to messages of ROS 2."""

    def __init__(self) -> None:
        """Register the definitions with the library that encodes CDR."""
        self.store: Any = typesys.get_typestore(typesys.Stores.EMPTY)
        for name, text in _DEFINITIONS.items():
            self.store.register(typesys.get_types_from_msg(text, name))

    def messages(self, topic: str, name: str, t_ns: int, fields: Fields) -> Iterator[Ros2Message]:
        """Yield the messages of ROS 2 for a message of a rig: several for a state, none for most topics.

        Args:
            topic: The topic of the message.
            name: The topic of a text; for copies by the link it contains the site.
            t_ns: The time of sending [ns since the Unix epoch].
            fields: The fields as JSON values.
        """
        if topic in TEXTS:
            text = json.dumps(fields, separators=(",", ":"))
            yield Ros2Message(name.replace("@", "/at_"), TEXT, self._made(TEXT, data=text))
        for output in CRTK.get(topic, ()):
            if (vector := output.value(fields)) is not None:
                kind = f"geometry_msgs/msg/{output.kind}"
                yield Ros2Message(output.name, kind, self._stamped(output, t_ns, vector))

    def cdr(self, message: Ros2Message) -> bytes:
        """Return the bytes of a message in CDR."""
        return bytes(self.store.serialize_cdr(message.message, message.kind))

    def definition(self, kind: str) -> str:
        """Return the definition of a message type with those of its parts, in the format ros2msg."""
        parts, waiting = {kind: _DEFINITIONS[kind]}, [kind]
        while waiting:
            for line in parts[waiting.pop()].splitlines():
                package, _, name = line.split()[0].partition("/")
                part = f"{package}/msg/{name}"
                if name and part not in parts:
                    parts[part] = _DEFINITIONS[part]
                    waiting.append(part)
        first, *others = parts.items()
        return "\n".join([first[1], *(f"{_LINE}\nMSG: {name.replace('/msg/', '/')}\n{text}" for name, text in others)])

    def type_hash(self, kind: str) -> str:
        """Return the hash by which rmw_zenoh compares the types of publisher and subscriber."""
        return str(self.store.hash_rihs01(kind))

    def _stamped(self, output: Output, t_ns: int, vector: Vector) -> Any:
        seconds, nanoseconds = divmod(t_ns, 10**9)
        stamp = self._made("builtin_interfaces/msg/Time", sec=seconds, nanosec=nanoseconds)
        frame = _FRAMES[output.name.partition("/")[0]]
        header = self._made("std_msgs/msg/Header", stamp=stamp, frame_id=frame)
        kind = f"geometry_msgs/msg/{output.kind}"
        if output.kind == POSE:
            upright = self._made("geometry_msgs/msg/Quaternion", x=0.0, y=0.0, z=0.0, w=1.0)
            pose = self._made("geometry_msgs/msg/Pose", position=self._vector("Point", vector), orientation=upright)
            return self._made(kind, header=header, pose=pose)
        first, second = (self._vector("Vector3", part) for part in (vector, (0.0, 0.0, 0.0)))
        if output.kind == TWIST:
            return self._made(kind, header=header, twist=self._made(_bare(kind), linear=first, angular=second))
        return self._made(kind, header=header, wrench=self._made(_bare(kind), force=first, torque=second))

    def _vector(self, kind: str, vector: Vector) -> Any:
        x, y, z = map(float, vector)
        return self._made(f"geometry_msgs/msg/{kind}", x=x, y=y, z=z)

    def _made(self, kind: str, **fields: Any) -> Any:
        return self.store.types[kind](**fields)


def definitions() -> Mapping[str, str]:
    """Return the definitions of the messages by type, parts before the messages that contain them."""
    return _DEFINITIONS


def _bare(kind: str) -> str:
    return kind.removesuffix("Stamped")


DEFAULT_ROUTER = "127.0.0.1:7447"
_NODE = "telenano"
_SDK = "zenoh_ros2_sdk"


class Publisher(Protocol):
    """The publisher of a topic."""

    def publish(self, **fields: Any) -> None:
        """Send a message with these fields."""

    def close(self) -> None:
        """Remove the topic from the graph."""


# Function that opens a topic; its arguments are topic with a leading /, type, definition and hash.
Opens = Callable[[str, str, str, str], Publisher]


class Ros2Bridge:
    """Forwards the messages of a rig to ROS 2."""

    def __init__(self, open_publisher: Opens, namespace: str = "") -> None:
        """Prepare a bridge without topics: each topic is opened with its first message.

        Args:
            open_publisher: The function that opens a topic.
            namespace: The prefix of the names of the topics.
        """
        self.sent = 0
        self._encoder = Encoder()
        self._open = open_publisher
        self._prefix = f"/{namespace.strip('/')}/" if namespace.strip("/") else "/"
        self._publishers: dict[str, Publisher] = {}

    def run(self, messages: Iterable[RecordedMessage]) -> None:
        """Publish messages until there are no more; messages that cannot be decoded are left out."""
        for message in messages:
            if message.topic in TOPICS_IN and message.channel_topic == message.topic:
                self._publish(message)

    def close(self) -> None:
        """Remove the topics from the graph."""
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
    """Connect to a router of rmw_zenoh, and return the function that opens a topic there.

    Args:
        router: Its address, host:port. A router that does not answer yet is tried again.
        domain: The domain of ROS.

    Raises:
        ConfigError: The address is not host:port, or a required package is not installed.
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
    # The library would fetch unknown definitions from the network, so they are registered here.
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
    """Close the connection to the router, if any; the library keeps one for the whole process."""
    kept = importlib.import_module(f"{_SDK}.session").ZenohSession
    if kept._instance is not None:
        kept._instance.close()


# Profile and QoS as `ros2 bag record` writes them; with an empty QoS `ros2 bag play` uses its default.
_PROFILE = "ros2"
_QOS = (("offered_qos_profiles", ""),)


def export_ros2(recording: Recording, target: Path, selection: Selection) -> CopyResult:
    """Write the selected channels of a recording as topics of ROS 2, each message with the time of its sending.

    For a topic that the link copies, only the original is written, so that each state is there once. Topics without a
    counterpart in ROS 2 (see `CRTK` and `TEXTS`) are left out.

    Raises:
        RecordingError: The target cannot be written.
    """
    encoder = Encoder()
    kinds: dict[str, str] = {}

    def wanted(channel: RecordedChannel) -> bool:
        return channel.topic in TOPICS_IN and channel.topic == channel.channel_topic and selection(channel)

    def encode(message: RecordedMessage) -> Iterator[tuple[str, bytes]]:
        fields = message.plain()
        for encoded in encoder.messages(message.topic, message.channel_topic, message.publish_ns, fields):
            kinds[encoded.topic] = encoded.kind
            yield encoded.topic, encoder.cdr(encoded)

    def describe(topic: str) -> tuple[str, str, tuple[tuple[str, str], ...], tuple[str, str, bytes]]:
        kind = kinds[topic]
        return f"/{topic}", "cdr", _QOS, (kind, "ros2msg", encoder.definition(kind).encode())

    return write_mcap(recording, target, wanted, encode, describe, _PROFILE)


def ros2(
    site_file: SiteFileOption = DEFAULT_SITE_FILE,
    router: Annotated[
        str,
        typer.Option("--router", metavar="HOST:PORT", help="Router of rmw_zenoh, `ros2 run rmw_zenoh_cpp rmw_zenohd`."),
    ] = DEFAULT_ROUTER,
    domain: Annotated[
        int, typer.Option("--domain", min=0, max=232, metavar="N", envvar="ROS_DOMAIN_ID", help="Domain of ROS.")
    ] = 0,
    namespace: Annotated[str, typer.Option("--namespace", metavar="NAME", help="Prefix of each topic.")] = "",
    rate: Annotated[
        float,
        typer.Option(
            "--rate", min=0.0, metavar="HZ", help="Greatest number of messages of each topic per second; 0: all."
        ),
    ] = LiveRecording.VIEWER_HZ,
    duration: DurationOption = None,
) -> None:
    """Publish positions and forces in ROS 2 by the names of CRTK, until Ctrl-C; no ROS has to be installed here.

    It only sends: nothing that comes from ROS reaches the rig.
    """
    with report_errors(False), contextlib.ExitStack() as open_parts:
        open_publisher = zenoh_publishers(router, domain)
        open_parts.callback(close_session)
        bridge = open_parts.enter_context(contextlib.closing(Ros2Bridge(open_publisher, namespace)))
        live = open_parts.enter_context(live_rig(site_file, rate_hz=rate))
        typer.echo(f"publishing to the router at {router}, domain {domain}")
        if not is_connected():
            say(f"no router answers at {router} yet; the bridge keeps trying")
        hand_on(bridge, live, duration)
