"""Examples of messages, for tests and for the first look at a topic."""

import json
from functools import cache
from pathlib import Path
from typing import Any

import msgspec

from telenano.wire.codec import decode
from telenano.wire.messages import Message


def example(topic: str, **fields: Any) -> Message:
    """Return the example message of a topic with some fields replaced; raise KeyError for an unknown topic."""
    base = decode(topic, bytes.fromhex(_examples()[topic]))
    return type(base)(**(msgspec.structs.asdict(base) | fields))


@cache
def _examples() -> dict[str, str]:
    # The golden vectors of the case `minimal`; the others are not installed.
    return dict(json.loads((Path(__file__).with_name("examples.json")).read_text(encoding="utf-8")))
