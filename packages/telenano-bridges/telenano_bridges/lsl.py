"""Publishes a running rig on the Lab Streaming Layer (LSL): states as streams, events and trials as markers.

Every sample has the time at which its node sent it, on LSL's clock of this machine. The two clocks are compared by a
reading of one between two readings of the other; the narrowest of many such pairs bounds the error. The description of
each stream has the offset and its error.
"""

import importlib
import json
import time
from collections.abc import Callable, Iterable, Mapping
from typing import Annotated, Any, NamedTuple

import typer

from telenano.cli import DurationOption, SiteFileOption, report_errors, say
from telenano.console import hand_on, live_rig
from telenano.extend.checks import Finding
from telenano.recording import RecordedMessage, quantity
from telenano.settings import DEFAULT_SITE_FILE
from telenano.wire import TOPICS, ConfigError, RecordingError

DEFAULT_NAME = "telenano"
_AXES = "xyz"
# The fields of each stream; a vector has a channel for each axis.
STATES: Mapping[str, tuple[str, ...]] = {
    "haptic/state": ("position_m", "velocity_m_per_s", "operator_force_n", "motor_force_n", "session_s"),
    "afm/state": ("base_position_m", "tip_force_n", "deflection_m", "separation_m", "in_contact"),
}
_VECTORS = ("position_m", "velocity_m_per_s", "operator_force_n", "motor_force_n", "base_position_m", "tip_force_n")
MARKERS = ("session/event", "experiment/trial", "experiment/answer")
_JOURNAL = "node/journal"
_READINGS = 200
# The clocks are compared again after this time, because on some systems they may drift apart.
_AGAIN_NS = 10_000_000_000
_NS = 1e-9


class Comparison(NamedTuple):
    """Offset of LSL's clock ahead of the monotonic clock of this machine, and the bound of its error [s]."""

    offset_s: float
    uncertainty_s: float


class Sample(NamedTuple):
    """A sample for a stream of LSL: values of its channels, or one text, and the time on LSL's clock [s]."""

    values: tuple[Any, ...]
    time_s: float


class Stream(NamedTuple):
    """The description of a stream: name, LSL's type of content, source, channels with units, and facts on its time."""

    name: str
    kind: str
    source: str
    channels: tuple[tuple[str, str], ...]
    facts: Mapping[str, str]


# Function that opens a stream, and returns the function that sends a sample on it.
Opens = Callable[[Stream], Callable[[Sample], None]]


def compare_clocks(
    lsl_clock: Callable[[], float],
    monotonic_ns: Callable[[], int] = time.monotonic_ns,
    readings: int = _READINGS,
) -> Comparison:
    """Compare LSL's clock with the monotonic one, by the narrowest of some readings.

    Args:
        lsl_clock: LSL's clock [s].
        monotonic_ns: The monotonic clock [ns].
        readings: The number of comparisons.
    """
    best = Comparison(0.0, float("inf"))
    for _ in range(readings):
        before, there, after = monotonic_ns(), lsl_clock(), monotonic_ns()
        half_s = 0.5 * _NS * (after - before)
        if half_s < best.uncertainty_s:
            best = Comparison(there - _NS * before - half_s, half_s)
    return best


class LslBridge:
    """Forwards states and events of a rig to LSL, each with the time of its sending on LSL's clock."""

    def __init__(
        self,
        open_stream: Opens,
        lsl_clock: Callable[[], float],
        epoch_offset_ns: int,
        name: str = DEFAULT_NAME,
        is_here: Callable[[str], bool] = lambda node: True,
        monotonic_ns: Callable[[], int] = time.monotonic_ns,
    ) -> None:
        """Open the stream of the markers; the streams of the states are opened with their first message.

        So a recorder that looks for streams when it starts finds the markers, however late the first of them is.

        Args:
            open_stream: The function that opens a stream.
            lsl_clock: LSL's clock [s].
            epoch_offset_ns: The offset of this process's clock ahead of the monotonic one [ns]; it gives messages of
                nodes without a journal the time of their reception.
            name: The beginning of the names of the streams.
            is_here: Function that returns whether a node is on this machine, which does not know the clock of another.
            monotonic_ns: The monotonic clock [ns].
        """
        self.sent = 0
        self._open, self._lsl_clock, self._monotonic_ns = open_stream, lsl_clock, monotonic_ns
        self._name, self._own_ns, self._is_here = name, epoch_offset_ns, is_here
        self.elsewhere: set[str] = set()
        self._streams: dict[tuple[str, str], Callable[[Sample], None]] = {}
        # The offset of each node's clock ahead of the monotonic clock [ns], from its journal.
        self._offsets_ns: dict[str, int] = {}
        self.clocks = compare_clocks(lsl_clock, monotonic_ns)
        self._compared_ns = monotonic_ns()
        self._send_marker = self._opened_markers()

    def run(self, messages: Iterable[RecordedMessage]) -> None:
        """Forward messages until there are no more; copies that crossed the link are left out."""
        for message in messages:
            self.take(message)

    def take(self, message: RecordedMessage) -> None:
        """Forward a message if it belongs to a stream; drop it if it cannot be decoded."""
        if message.channel_topic != message.topic or message.topic not in (*STATES, *MARKERS, _JOURNAL):
            return
        try:
            if message.topic not in MARKERS and not self._is_here(message.src):
                self.elsewhere.add(message.src)
            elif message.topic == _JOURNAL:
                self._offsets_ns[message.src] = int(message.fields()["epoch_offset_ns"])
            elif message.topic in MARKERS:
                self._mark(message)
            elif message.src in self._offsets_ns:
                # Before a node's first journal, which comes within a fraction of a second, its clock is not known.
                self._state(message)
        except (RecordingError, KeyError, TypeError, ValueError, IndexError, OverflowError):
            return

    def _state(self, message: RecordedMessage) -> None:
        fields = message.fields()
        values: list[float] = []
        for name in STATES[message.topic]:
            value = fields[name]
            values += [float(part) for part in value] if name in _VECTORS else [float(value)]
        send = self._streams.get((message.topic, message.src)) or self._opened(message)
        send(Sample(tuple(values), self._time_s(message.publish_ns - self._offsets_ns[message.src])))
        self.sent += 1

    def _mark(self, message: RecordedMessage) -> None:
        is_offset_known = message.src in self._offsets_ns
        sent_ns = (
            message.publish_ns - self._offsets_ns[message.src] if is_offset_known else message.log_ns - self._own_ns
        )
        stamped = "sent" if is_offset_known else "received"
        text = json.dumps({"topic": message.topic, "src": message.src, "stamped": stamped, **message.plain()})
        self._send_marker(Sample((text,), self._time_s(sent_ns)))
        self.sent += 1

    def _time_s(self, monotonic_ns: int) -> float:
        """Convert a time of the monotonic clock [ns] to LSL's clock [s]."""
        now_ns = self._monotonic_ns()
        if now_ns - self._compared_ns > _AGAIN_NS:
            self.clocks, self._compared_ns = compare_clocks(self._lsl_clock, self._monotonic_ns), now_ns
        return monotonic_ns * _NS + self.clocks.offset_s

    def _opened(self, message: RecordedMessage) -> Callable[[Sample], None]:
        channels: list[tuple[str, str]] = []
        for name in STATES[message.topic]:
            unit = quantity(message.topic, name).unit
            names = [f"{name}.{axis}" for axis in _AXES] if name in _VECTORS else [name]
            channels += [(channel, unit) for channel in names]
        rate_hz = TOPICS[message.topic].rate_hz
        facts = {"stamp": "time of sending by the node, on its clock", "nominal_rate_hz": f"{rate_hz or 0.0:g}"}
        stream = Stream(
            f"{self._name} {message.topic}", "Haptics" if message.topic == "haptic/state" else "AFM",
            f"{self._name}/{message.src}/{message.topic}", tuple(channels), facts | self._about_time(),
        )  # fmt: skip
        return self._streams.setdefault((message.topic, message.src), self._open(stream))

    def _opened_markers(self) -> Callable[[Sample], None]:
        stamp = "time of sending where the marker says stamped: sent, else that of its reception by the bridge"
        facts = {"stamp": stamp, "format": "one JSON object", "topics": " ".join(MARKERS)}
        stream = Stream(
            f"{self._name} markers", "Markers", f"{self._name}/markers", (("marker", ""),), facts | self._about_time()
        )
        return self._open(stream)

    def _about_time(self) -> dict[str, str]:
        return {
            "clock_offset_s": f"{self.clocks.offset_s:.9f}",
            "clock_uncertainty_s": f"{self.clocks.uncertainty_s:.9f}",
            "clock_compared": "LSL's local_clock against the monotonic clock of the rig's machine, again every 10 s",
        }


def lsl_streams() -> tuple[Opens, Callable[[], float]]:
    """Return the function that opens a stream of LSL, and LSL's clock.

    Raises:
        ConfigError: pylsl is not installed, or the library liblsl that it needs is not found.
    """
    try:
        pylsl = importlib.import_module("pylsl")
    except ImportError as error:
        raise ConfigError("the bridge to LSL needs pylsl: pip install pylsl") from error
    except RuntimeError as error:
        # pylsl lists in further lines the places where it has looked.
        reason = str(error).partition("\n")[0].strip()
        raise ConfigError(
            f"pylsl does not find the library liblsl ({reason}): install it, or name its file in PYLSL_LIB"
        ) from error

    def open_stream(stream: Stream) -> Callable[[Sample], None]:
        is_text = stream.kind == "Markers"
        info = pylsl.StreamInfo(
            stream.name,
            stream.kind,
            len(stream.channels),
            pylsl.IRREGULAR_RATE,
            pylsl.cf_string if is_text else pylsl.cf_double64,
            stream.source,
        )
        about = info.desc()
        about.append_child_value("manufacturer", "telenano")
        channels = about.append_child("channels")
        for label, unit in stream.channels:
            channel = channels.append_child("channel")
            channel.append_child_value("label", label)
            channel.append_child_value("unit", unit)
        synchronisation = about.append_child("synchronization")
        for name, value in stream.facts.items():
            synchronisation.append_child_value(name, value)
        outlet = pylsl.StreamOutlet(info)

        def send(sample: Sample) -> None:
            outlet.push_sample(list(sample.values), sample.time_s)

        return send

    return open_stream, pylsl.local_clock


def check_library() -> list[Finding]:
    """Return the finding whether pylsl finds liblsl on this machine."""
    from telenano_bridges.lsl import lsl_streams

    try:
        lsl_streams()
    except ConfigError as error:
        return [Finding("LSL", "warning", str(error), "only `telenano bridge lsl` needs it")]
    return [Finding("LSL", "ok", "pylsl finds liblsl")]


def lsl(
    site_file: SiteFileOption = DEFAULT_SITE_FILE,
    name: Annotated[
        str, typer.Option("--name", metavar="NAME", help="Prefix of the names of the streams.")
    ] = DEFAULT_NAME,
    duration: DurationOption = None,
) -> None:
    """Publish states, events and trials on the Lab Streaming Layer, until Ctrl-C, with the error of their time.

    It only sends. Streams of LSL are not encrypted: every machine of the network can find and read them.
    """
    with report_errors(False):
        open_stream, clock = lsl_streams()
        with live_rig(site_file) as live:
            bridge = LslBridge(open_stream, clock, live.epoch_offset_ns, name, live.is_here)
            clocks = bridge.clocks
            typer.echo(
                f"publishing on LSL as {name}; LSL's clock is ahead of the rig's monotonic clock by"
                f" {1e6 * clocks.offset_s:.3f} us, known to {1e6 * clocks.uncertainty_s:.3f} us"
            )
            hand_on(bridge, live, duration)
            if bridge.elsewhere:
                nodes = ", ".join(sorted(bridge.elsewhere))
                say(f"not published: {nodes}, on another machine; start a bridge there")
