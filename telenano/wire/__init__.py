"""The wire contract: messages, topics and the codec. It imports nothing else of the project.

What is named here is imported when it is first used: the models of all messages take a third of a second, and
`proto.nodes` and `proto.errors` serve programs that cannot wait for them, an emergency stop above all.
"""

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from proto.codec import (
        MAX_MESSAGE_BYTES,
        WireError,
        accept,
        compose,
        decode,
        decode_header,
        encode,
        fields_of,
        read_header,
    )
    from proto.messages import Message
    from proto.topics import TOPICS, Topic

__all__ = [
    "MAX_MESSAGE_BYTES",
    "TOPICS",
    "Message",
    "Topic",
    "WireError",
    "accept",
    "compose",
    "decode",
    "decode_header",
    "encode",
    "fields_of",
    "read_header",
]

_MODULES = {"Message": "proto.messages", "TOPICS": "proto.topics", "Topic": "proto.topics"}


def __getattr__(name: str) -> Any:
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    value = getattr(importlib.import_module(_MODULES.get(name, "proto.codec")), name)
    globals()[name] = value
    return value
