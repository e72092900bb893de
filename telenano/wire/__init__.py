"""The wire contract: messages, topics and the codec. It imports nothing else of the project.

What is named here is imported when it is first used: the messages and NumPy take most of the time that a command needs
to start, and `telenano.wire.nodes` and `telenano.wire.errors` serve programs that cannot wait for them, an emergency
stop above all.
"""

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from telenano.wire.codec import (
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
    from telenano.wire.messages import Message
    from telenano.wire.topics import TOPICS, Topic

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

_MODULES = {"Message": "telenano.wire.messages", "TOPICS": "telenano.wire.topics", "Topic": "telenano.wire.topics"}


def __getattr__(name: str) -> Any:
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    value = getattr(importlib.import_module(_MODULES.get(name, "telenano.wire.codec")), name)
    globals()[name] = value
    return value
