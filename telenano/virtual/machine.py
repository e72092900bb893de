"""The machine of a node in virtual time, whose facts are the same in every run and on every computer."""

from collections.abc import Mapping
from typing import Any

from telenano.recording.disk import Disk
from telenano.runtime.loop.log import StructuredLog
from telenano.virtual.timing import RandomStreams

# Required fields of node/health on the machine have these values. Optional ones are left out, so that a new one changes
# neither the bytes of a report nor the load of a link with a limited rate.
HEALTH: Mapping[str, int | float] = {"pid": 1, "cpu_percent": 0.0, "memory_bytes": 1}
_KEPT_LINES = 6


class VirtualMachine:
    """The machine of a node in a virtual rig, with tokens from the seed, and a disk."""

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
    """The log of a node in virtual time, which keeps the last lines in memory."""

    def __init__(self, node: str) -> None:
        super().__init__(node)
        self.lines: list[str] = []

    def write(self, level: str, text: str, **facts: Any) -> None:
        """Keep a line, without its facts."""
        self.lines = [*self.lines[1 - _KEPT_LINES :], f"{level}: {text}"]
