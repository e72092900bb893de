"""A recording as a document: its curves as a whole and in part, and what happened in it, for a page to read in."""

import threading
import time
from collections.abc import Callable, Mapping
from typing import Any, Protocol

import numpy as np

from proto.errors import RefusedError, TelenanoError
from recording.multi_file import RecordingSource
from recording.site_clock import Timeline
from services.viz_node.levels import Floats, Levels, packed, read_samples
from services.viz_node.streams import STREAMS

# A part that is shorter than this is read from the file, sample by sample [s]; of a longer one a pixel has several.
_RAW_S = 3.0
# the longest part that is given sample by sample, for a file of its own [s]
_MOST_RAW_S = 60.0
_MOST_SPANS = 4000
# Of a longer recording an outline is read first [s]: so many looks into it, each so long [s].
_LONG_S, _LOOKS, _LOOK_S = 120.0, 240, 0.02
# the reader gives way to what plays, after so much work [s], for so long [s]
_WORK_S, _REST_S = 0.02, 0.002

Facts = Mapping[str, Any]


class Document(Protocol):
    """What a page may read in, at any place."""

    def about(self) -> Facts:
        """Return what is known of the whole by now: `read` is the share that has been read."""

    def part(self, from_s: float, to_s: float, spans: int) -> Facts:
        """Return the curves of a part [s] in so many spans; all samples for 0. RefusedError says why not."""


class RecordingDocument:
    """Curves, phases, marks and verdicts of a recording. It is read in a thread of its own when first asked for."""

    def __init__(self, recording: RecordingSource, judge: Callable[[RecordingSource], Facts] | None = None) -> None:
        """Prepare to read; `judge` returns what happened in it: phases, holds, moments, the numbers of its summary."""
        self._recording = recording
        self._judge = judge
        self._start_ns, end_ns = recording.span_ns
        self._length_s = (end_ns - self._start_ns) * 1e-9
        self._levels = Levels(self._length_s)
        self._read = 0.0
        self._facts: Facts = {}
        self._timeline: Timeline | None = None
        self._lock = threading.Lock()
        self._thread: threading.Thread | None = None

    def about(self) -> Facts:
        self._begin()
        return {
            "start_ns": self._start_ns,
            "length_s": self._length_s,
            "read": round(self._read, 3),
            **self._facts,
        }

    def part(self, from_s: float, to_s: float, spans: int) -> Facts:
        self._begin()
        if not to_s > from_s:
            raise RefusedError(f"from {from_s:g} s to {to_s:g} s is no part of a recording")
        if spans <= 0 and to_s - from_s > _MOST_RAW_S:
            raise RefusedError(f"every sample is given of at most {_MOST_RAW_S:g} s at once: choose a shorter part")
        if spans <= 0 or to_s - from_s <= _RAW_S:
            return {"from_s": from_s, "to_s": to_s, "width_s": 0.0, "streams": self._raw(from_s, to_s)}
        found, width_s = {}, 0.0
        for stream in STREAMS:
            times, values, width_s = self._levels.between(stream.name, from_s, to_s, min(spans, _MOST_SPANS))
            found[stream.name] = packed(times, values)
        return {"from_s": from_s, "to_s": to_s, "width_s": width_s, "streams": found}

    def wait(self) -> None:
        """Wait until everything has been read."""
        self._begin()
        if self._thread is not None:
            self._thread.join()

    def _begin(self) -> None:
        with self._lock:
            if self._thread is None:
                self._thread = threading.Thread(target=self._read_all, name="document", daemon=True)
                self._thread.start()

    def _known_timeline(self) -> Timeline:
        with self._lock:
            if self._timeline is None:
                self._timeline = Timeline(self._recording)
            return self._timeline

    def _read_all(self) -> None:
        try:
            self._fill()
            if self._judge is not None:
                self._facts = self._judge(self._recording)
        except (TelenanoError, ValueError, ArithmeticError, OSError) as error:
            self._facts = {"fault": str(error)}
        self._read = 1.0

    def _fill(self) -> None:
        if self._length_s > _LONG_S:
            self._outline()
        rested_s = time.monotonic()
        for name, times, values, read_ns in read_samples(self._recording, self._known_timeline()):
            self._levels.add(name, times, values)
            self._read = min(0.999, (read_ns - self._start_ns) * 1e-9 / max(self._length_s, 1e-9))
            if time.monotonic() - rested_s > _WORK_S:
                time.sleep(_REST_S)
                rested_s = time.monotonic()

    def _outline(self) -> None:
        """Look into the recording at even distances, so that the whole of hours has a shape within seconds."""
        step_ns = round(self._length_s * 1e9 / _LOOKS)
        for look in range(_LOOKS):
            from_ns = self._start_ns + look * step_ns
            looked = read_samples(self._recording, self._known_timeline(), from_ns, from_ns + round(_LOOK_S * 1e9))
            for name, times, values, _ in looked:
                self._levels.add(name, times, values)
            time.sleep(_REST_S)

    def _raw(self, from_s: float, to_s: float) -> dict[str, Facts]:
        # a message is written a little after it was sent
        margin_s = 0.1
        bounds = (self._start_ns + round((at_s) * 1e9) for at_s in (from_s - margin_s, to_s + margin_s))
        pieces: dict[str, list[tuple[Floats, Floats]]] = {stream.name: [] for stream in STREAMS}
        for name, times, values, _ in read_samples(self._recording, self._known_timeline(), *bounds):
            inside = (times >= from_s) & (times <= to_s)
            pieces[name].append((times[inside], values[:, inside]))
        found = {}
        for stream in STREAMS:
            parts = pieces[stream.name] or [(np.empty(0), np.empty((len(stream.columns), 0)))]
            times, values = (np.concatenate([part[i] for part in parts], axis=-1) for i in (0, 1))
            found[stream.name] = packed(times, values)
        return found
