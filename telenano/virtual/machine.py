"""The machine of a node in virtual time: nothing that it tells differs between two runs or two computers."""

from collections.abc import Mapping
from typing import Any

from telenano.recording.disk import Disk
from telenano.runtime.loop.log import StructuredLog
from telenano.virtual.timing import RandomStreams

# The fields of node/health that every message needs have these values. Others that tell of a machine are left out, so
# that a further one moves neither the bytes of a report nor what a link with a limited rate carries.
HEALTH: Mapping[str, int | float] = {"pid": 1, "cpu_percent": 0.0, "memory_bytes": 1}
_KEPT_LINES = 6


class VirtualMachine:
    """What a node of a rig in virtual time takes from its machine: tokens by the seed, and a disk."""

    def __init__(self, key: str, streams: RandomStreams, disk: Disk) -> None:
        self.disk = disk
        self._key, self._streams = key, streams

    def token(self, size_bytes: int) -> str:
        return self._streams.of(("token", self._key)).getrandbits(8 * size_bytes).to_bytes(size_bytes, "big").hex()

    def processor_time_s(self) -> float:
        return 0.0

    def health(self, processor_s: float, elapsed_s: float) -> Mapping[str, Any]:
        return HEALTH


class QuietLog(StructuredLog):
    """The log of a node in virtual time, of which the last lines are kept."""

    def __init__(self, node: str) -> None:
        super().__init__(node)
        self.lines: list[str] = []

    def write(self, level: str, text: str, **facts: Any) -> None:
        """Keep a line."""
        self.lines = [*self.lines[1 - _KEPT_LINES :], f"{level}: {text}"]
