"""A recording as a bag of ROS 2: MCAP with ros2msg schemas and CDR, which `ros2 bag` and the viewers of ROS read."""

from functools import partial
from pathlib import Path

from recording.channel_filter import Selection
from recording.mcap_scan import Damage, describe_damage
from recording.messages import RawChannel, RawMessage
from recording.reader import Recording
from recording.rewrite import CopyResult, CopyWriter
from recording.ros2 import TOPICS_IN, Encoder
from recording.sender_time import SenderClock, SenderOrder
from recording.tables import plain

# Profile and QoS as `ros2 bag record` writes them: without, `ros2 bag play` takes its default.
_PROFILE, _QOS = "ros2", (("offered_qos_profiles", ""),)


def export_ros2(recording: Recording, target: Path, selection: Selection) -> CopyResult:
    """Write the chosen channels of a recording as topics of ROS 2, each message with the time of its sending.

    Of a topic that the link carries the first copy is taken, so that a state is one message; what has no counterpart
    (`recording.ros2`) is left out.

    Raises:
        ConfigError: A package that is needed is not installed.
        RecordingError: The target cannot be written.
    """
    encoder = Encoder()
    skipped: list[Damage] = list(recording.structural_damage)
    refused: list[str] = []
    select = partial(recording.select, report=skipped.append)

    def wanted(channel: object) -> bool:
        topic, name = (getattr(channel, part) for part in ("topic", "channel_topic"))
        return topic in TOPICS_IN and topic == name and bool(selection(channel))  # type: ignore[arg-type]

    channels: dict[str, RawChannel] = {}
    sent = SenderOrder(recording, wanted, SenderClock(recording), select=select, ends=True)
    with CopyWriter(target, profile=_PROFILE) as writer:
        writer.copy_attachments_and_metadata([recording])
        for sent_ns, _, message in sent:
            try:
                fields = plain(message)
                found_here = encoder.messages(message.topic, message.channel_topic, message.publish_ns, fields)
                made = [(found, encoder.cdr(found)) for found in found_here]
            except (TypeError, ValueError, KeyError) as error:
                refused.append(f"{message.channel_topic}, seq {message.seq}: {error}")
                continue
            for found, data in made:
                if found.topic not in channels:
                    schema = (found.kind, "ros2msg", encoder.definition(found.kind).encode())
                    channels[found.topic] = RawChannel(f"/{found.topic}", "cdr", _QOS, schema)
                writer.add(RawMessage(channels[found.topic], sent_ns, message.publish_ns, message.seq, data))
    return CopyResult(path=str(target), messages=writer.messages, skipped=(*describe_damage(skipped), *refused))
