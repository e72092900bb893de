"""The wire contract: messages, topics and the codec. It imports nothing else of the project."""

from proto.codec import MAX_MESSAGE_BYTES, WireError, decode, decode_header, encode
from proto.messages import Message
from proto.topics import TOPICS, Topic

__all__ = ["MAX_MESSAGE_BYTES", "TOPICS", "Message", "Topic", "WireError", "decode", "decode_header", "encode"]
