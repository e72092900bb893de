"""A recording as a bag of ROS 2: MCAP with ros2msg schemas and CDR, which `ros2 bag` and the viewers of ROS read."""

from collections.abc import Iterator
from pathlib import Path

from telenano.recording import (
    CopyResult,
    RecordedChannel,
    RecordedMessage,
    Recording,
    Selection,
    write_mcap,
)
from telenano_ros2.crtk import TOPICS_IN, Encoder

# Profile and QoS are as `ros2 bag record` writes them: without them `ros2 bag play` takes its default.
_PROFILE = "ros2"
_QOS = (("offered_qos_profiles", ""),)


def export_ros2(recording: Recording, target: Path, selection: Selection) -> CopyResult:
    """Write the chosen channels of a recording as topics of ROS 2, each message with the time of its sending.

    Of a topic that the link carries the first copy is taken, so that a state is one message; what has no counterpart
    (`telenano_ros2.crtk`) is left out.

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
