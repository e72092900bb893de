"""The recording of an assembly in simulated time: messages as of a rig's instrument, and the truth on its own topic."""

from pathlib import Path
from typing import Any

from telenano.devices import VirtualInstrument
from telenano.recording import RecordingWriter
from telenano.wire import TOPICS, compose
from telenano_lab.assembly.layers import PARTICLES

NAME = "assembly.mcap"
# Nodes under whose names the messages are written.
_INSTRUMENT = "afm_node@slave"
_PLANNER = "console@slave"
# Intervals at which the state of the instrument and the report of its program are recorded.
_STATE_S = 0.05
_REPORT_S = 0.1
# Recording interval of a message that does not change.
_RESTING_S = 1.0
# Greatest length of a sentence of the assembly.
_MOST_TEXT = 512
# Simulated time begins here [ns], because 0 means that there is no message.
_BEGAN_NS = 1_000_000_000


class AssemblyRecorder:
    """Records an instrument in simulated time; the same assembly gives the same file, byte by byte.

    Args:
        folder: The folder of the file.
        instrument: The instrument.
    """

    def __init__(self, folder: Path, instrument: VirtualInstrument) -> None:
        self._instrument = instrument
        self._writer = RecordingWriter.at(folder / NAME, "recorder@slave")
        self._writer.add_metadata("recording", {"node": "recorder@slave"})
        self._channels: dict[str, tuple[int, int]] = {}
        self._due_s = {"afm/state": 0.0, "afm/program": 0.0, "afm/particles": 0.0}

    def step(self) -> None:
        """Record the messages that are due after a step of a program."""
        if self._is_due("afm/state", _STATE_S):
            self._write("afm/state", **self._instrument.state())
            self._truth()
        if self._is_due("afm/program", _REPORT_S) and (report := self._instrument.report()) is not None:
            self._write("afm/program", **report.fields())
        if (line := self._instrument.scanline()) is not None:
            self._write("afm/scanline", **line)

    def ended(self) -> None:
        """Record the outcome of a program."""
        if self._instrument.outcome is not None:
            self._write("afm/program", **self._instrument.outcome.fields())

    def say(self, text: str) -> None:
        """Record a sentence of the assembly."""
        self._write("session/event", _PLANNER, id="", kind="mark", level="info", text=text[:_MOST_TEXT], data={})

    def finish(self) -> None:
        """Close the file."""
        self._writer.finish()

    def _truth(self) -> None:
        truth = self._instrument.truths["particles"]
        if PARTICLES.changes(truth) or self._is_due(PARTICLES.topic, _RESTING_S):
            self._write(PARTICLES.topic, **PARTICLES.fields(truth))

    def _is_due(self, topic: str, period_s: float) -> bool:
        if self._instrument.time_s < self._due_s[topic]:
            return False
        self._due_s[topic] = self._instrument.time_s + period_s * (1.0 - 1e-9)
        return True

    def _write(self, topic: str, src: str = _INSTRUMENT, **fields: Any) -> None:
        if topic not in self._channels:
            self._channels[topic] = self._writer.channel(topic, src, "slave"), 0
        channel, seq = self._channels[topic]
        self._channels[topic] = channel, seq + 1
        t_ns, model = _BEGAN_NS + round(1e9 * self._instrument.time_s), TOPICS[topic].model
        header = {"v": model.version, "src": src, "seq": seq, "t_ns": t_ns}
        _, payload = compose(topic, {**header, **fields})
        self._writer.write(channel, t_ns, t_ns, seq, payload)
