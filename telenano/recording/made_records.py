"""Recordings made from messages without a bus, for tests of an export or a bridge."""

from collections.abc import Iterable
from pathlib import Path

from telenano.recording.messages import RecordedChannel, RecordedMessage
from telenano.recording.recorder_config import RecorderConfig
from telenano.recording.writer import RecordingWriter, channel_topic
from telenano.wire import TOPICS, Message, encode
from telenano.wire.nodes import site_of


def recorded(topic: str, message: Message, log_ns: int, site: str = "") -> RecordedMessage:
    """Return a message as it would be read from a recording or received from a running rig.

    Args:
        topic: The topic of the message.
        message: The message.
        log_ns: Time of reception [ns since 1970].
        site: Site of reception, empty for the publisher's; at another site the message counts as a copy from the link.
    """
    row, site = TOPICS[topic], site or site_of(message.src)
    via, name = "direct" if site == site_of(message.src) else "link", channel_topic(topic, message.src, site)
    channel = RecordedChannel(name, topic, site, via, message.src, row.rate_hz, row.delivery)
    return RecordedMessage(channel, log_ns, message.t_ns, message.seq, encode(message))


def write_recording(folder: Path, messages: Iterable[RecordedMessage]) -> Path:
    """Write messages made by `recorded` to a file in a folder, as the recorder does, and return the file's path."""
    writer = RecordingWriter.create("recorder@master", RecorderConfig(directory=folder))
    numbers: dict[RecordedChannel, int] = {}
    for message in messages:
        channel = message.channel
        if channel not in numbers:
            numbers[channel] = writer.channel(channel.topic, channel.src, channel.site)
        writer.write(numbers[channel], message.log_ns, message.publish_ns, message.seq, message.payload)
    writer.finish()
    return writer.path
