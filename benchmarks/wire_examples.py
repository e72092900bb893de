"""An ordinary message of each topic for the benchmarks, from the examples of the wire contract."""

import sys
from pathlib import Path

from telenano.wire.messages import Message
from telenano.wire.topics import TOPICS

sys.path.append(str(Path(__file__).resolve().parents[1] / "tests" / "contract"))


def ordinary_example(topic: str) -> Message:
    """Return the ordinary example of a topic."""
    from telenano.testing.filled_messages import examples

    return examples(TOPICS[topic])["ordinary"]
