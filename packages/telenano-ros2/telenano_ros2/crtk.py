"""The messages of a rig as those of ROS 2, with the names of CRTK, encoded without an installation of ROS.

CRTK (the Collaborative Robotics Toolkit) names what a device measures and is asked for: `measured_cp` is a measured
Cartesian position, `setpoint_cp` the goal that it follows, `servo_cp` a command, `cv` a velocity, `cf` a force. The
hand's device is `hand`, in the master frame; the tip of the instrument is `tip`, in the AFM frame; both are
right-handed, z is up and away from the sample, and every value is SI. What CRTK has no name for is a text of JSON.
"""

import json
from collections.abc import Callable, Iterator, Mapping
from typing import Any, NamedTuple

from rosbags import typesys

# The types of messages, of the package geometry_msgs.
POSE = "PoseStamped"
TWIST = "TwistStamped"
WRENCH = "WrenchStamped"
# The definitions of the messages that are used, as ROS 2 has had them since its first release.
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
    """A topic of ROS 2: its name, its message, and the vector of one of our messages, None where it has none."""

    name: str
    kind: str
    value: Callable[[Fields], Vector | None]


def _field(name: str) -> Callable[[Fields], Vector | None]:
    return lambda fields: fields[name]


def _in_mode(mode: str, name: str) -> Callable[[Fields], Vector | None]:
    return lambda fields: fields[name] if fields["mode"] == mode else None


def _tip(fields: Fields) -> Vector:
    """Return where the tip is: the deflection of the cantilever is away from the sample, as z is."""
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
# These are sent a few times a second, or when something happens.
TEXTS = ("session/event", "session/control", "law/status", "link/status", "node/health")
TOPICS_IN = (*CRTK, *TEXTS)
_FRAMES = {"hand": "master", "tip": "afm"}


class Ros2Message(NamedTuple):
    """A message of ROS 2: topic without a leading /, type, and the object that has its fields."""

    topic: str
    kind: str
    message: Any


class Encoder:
    """Makes messages of ROS 2 from those of a rig."""

    def __init__(self) -> None:
        """Load the definitions into the library that knows CDR."""
        self.store: Any = typesys.get_typestore(typesys.Stores.EMPTY)
        for name, text in _DEFINITIONS.items():
            self.store.register(typesys.get_types_from_msg(text, name))

    def messages(self, topic: str, name: str, t_ns: int, fields: Fields) -> Iterator[Ros2Message]:
        """Return what a message of a rig is in ROS 2: of a state several messages, of most topics none.

        Args:
            topic: The topic of the message.
            name: The topic that a text gets; of copies by the link it has the site.
            t_ns: When it was sent [ns since the Unix epoch].
            fields: Its fields, as JSON holds them.
        """
        if topic in TEXTS:
            text = json.dumps(fields, separators=(",", ":"))
            yield Ros2Message(name.replace("@", "/at_"), TEXT, self._made(TEXT, data=text))
        for output in CRTK.get(topic, ()):
            if (vector := output.value(fields)) is not None:
                kind = f"geometry_msgs/msg/{output.kind}"
                yield Ros2Message(output.name, kind, self._stamped(output, t_ns, vector))

    def cdr(self, message: Ros2Message) -> bytes:
        """Return a message as bytes."""
        return bytes(self.store.serialize_cdr(message.message, message.kind))

    def definition(self, kind: str) -> str:
        """Return the definition of a message with those of its parts, as ros2msg has them."""
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
    """Return the definition of each message, those of parts before those that have them."""
    return _DEFINITIONS


def _bare(kind: str) -> str:
    return kind.removesuffix("Stamped")
