"""A recording as a document for pages: the curves of the whole or of a part, and the events and verdicts in it."""

import threading
import time
from collections.abc import Callable, Mapping
from itertools import islice
from typing import Any, Protocol

import numpy as np

from services.viz_node.levels import Floats, Levels, is_curve, is_link, packed, read_samples
from services.viz_node.streams import STREAMS
from telenano.recording.multi_file import RecordingSource
from telenano.recording.reader import Piece
from telenano.recording.site_clock import Timeline
from telenano.wire.errors import RefusedError, TelenanoError

# A part shorter than this is returned sample by sample [s]; in a longer one a pixel shows several samples.
_RAW_S = 3.0
# The longest part that a page may request sample by sample, to store as a file [s].
_MOST_RAW_S = 60.0
_MOST_SPANS = 4000
# A recording longer than this is first read in outline [s].
_LONG_S = 120.0
# Number of places in the recording from which the outline is made.
_LOOKS = 240
# Number of messages read at each place.
_LOOK = 200
# Length of the pieces in which the recording is read [s].
_PIECE_S = 2.0
# Most missing pieces that are read at once, while the page waits; more are left to the reading thread.
_AT_ONCE = 16
# Longest time between sending and reception of a message [s].
_MARGIN_S = 0.1
# The losses of the link are counted from one report to the next; one comes within this time [ns].
_BEFORE_NS = 300_000_000
# A part with fewer spans of the finest level than this is returned sample by sample.
_LEAST_SPANS = 300
# Pause after each piece, in which the reading thread gives way to the playback [s].
_REST_S = 0.005

Facts = Mapping[str, Any]


class Document(Protocol):
    """A recording that a page may read at any place."""

    def about(self) -> Facts:
        """Return the facts of the whole that are known by now; `read` is the share that has been read."""

    def part(self, from_s: float, to_s: float, spans: int) -> Facts:
        """Return the curves of a part [s] in at most this number of spans, or all samples for 0.

        Raises:
            RefusedError: The part is empty, or too long for all samples.
        """


class KeptReading(Protocol):
    """Stores the result of a reading, so that a recording need not be read again."""

    def load(self, levels: Levels) -> Facts | None:
        """Fill the levels and return the facts; None if nothing was stored."""

    def save(self, levels: Levels, facts: Facts) -> None:
        """Store both."""


class RecordingDocument:
    """Curves, phases, marks and verdicts of a recording.

    A thread reads it piece by piece after the first request; a part that a page requests is read first.
    """

    def __init__(
        self,
        recording: RecordingSource,
        judge: Callable[[], Facts] | None = None,
        kept: KeptReading | None = None,
        judged_before: Callable[[], Facts | None] = lambda: None,
    ) -> None:
        """Prepare to read.

        Args:
            recording: The recording.
            judge: Returns the facts of it: phases, holds, moments, the numbers of its summary.
            kept: Stores the result of reading a long recording; None to store nothing.
            judged_before: Returns the facts of an earlier verdict that is stored beside the file, or None.
        """
        self._recording = recording
        self._judge, self._judged_before = judge, judged_before
        self._start_ns, end_ns = recording.span_ns
        self._length_s = (end_ns - self._start_ns) * 1e-9
        self._levels = Levels(self._length_s)
        self._kept = kept if self._length_s > _LONG_S else None
        self._facts: Facts = {}
        self._is_known = False
        self._timeline: Timeline | None = None
        self._timing = threading.Lock()
        self._lock = threading.Lock()
        self._thread: threading.Thread | None = None
        # The pieces, the indices of those not read yet, and the last requested part [s]. There are no more pieces than
        # chunks, whatever length the file states.
        self._pieces = list(recording.pieces(round(_PIECE_S * 1e9), _BEFORE_NS))
        self._left = set(range(len(self._pieces)))
        self._asked: tuple[float, float] | None = None
        self._reading = threading.Lock()

    def about(self) -> Facts:
        self._begin()
        share = 1.0 - len(self._left) / max(1, len(self._pieces))
        return {
            "start_ns": self._start_ns,
            "length_s": self._length_s,
            # The curves are complete before the events are known, so the share is 1 only with both.
            "read": 1.0 if self._is_known else min(0.999, round(share, 3)),
            **self._facts,
        }

    def part(self, from_s: float, to_s: float, spans: int) -> Facts:
        self._begin()
        if not to_s > from_s:
            raise RefusedError(f"from {from_s:g} s to {to_s:g} s is not a part of a recording")
        if spans <= 0 and to_s - from_s > _MOST_RAW_S:
            raise RefusedError(f"at most {_MOST_RAW_S:g} s of samples are sent at once: choose a shorter part")
        if spans <= 0 or to_s - from_s <= max(_RAW_S, _LEAST_SPANS * self._levels.width_s):
            return {"from_s": from_s, "to_s": to_s, "width_s": 0.0, "streams": self._raw(from_s, to_s)}
        missing = self._left_in(from_s, to_s)
        if len(missing) <= _AT_ONCE:
            for piece in missing:
                self._read_piece(piece)
        else:
            self._asked = (from_s, to_s)
        curves, width_s = {}, 0.0
        for stream in STREAMS:
            times, values, width_s = self._levels.between(stream.name, from_s, to_s, min(spans, _MOST_SPANS))
            curves[stream.name] = packed(times, values)
        return {"from_s": from_s, "to_s": to_s, "width_s": width_s, "streams": curves}

    def wait(self) -> None:
        """Wait until the whole recording has been read."""
        self._begin()
        if self._thread is not None:
            self._thread.join()

    def _begin(self) -> None:
        with self._lock:
            if self._thread is None:
                self._thread = threading.Thread(target=self._read_all, name="document", daemon=True)
                self._thread.start()

    def _known_timeline(self) -> Timeline:
        with self._timing:
            if self._timeline is None:
                self._timeline = Timeline(self._recording, quick=self._length_s > _LONG_S)
            return self._timeline

    def _read_all(self) -> None:
        """Fill the levels and judge the recording, unless both results were stored."""
        is_kept = self._kept.load(self._levels) if self._kept is not None else None
        if is_kept is not None:
            self._facts = is_kept
            self._left.clear()
        else:
            try:
                # A stored verdict is available at once; facts that it does not contain follow when all is read.
                self._facts = self._judged_before() or {}
                self._fill()
                if self._judge is not None:
                    self._facts = self._judge()
                if self._kept is not None:
                    self._kept.save(self._levels, self._facts)
            except (TelenanoError, ValueError, ArithmeticError, OSError) as error:
                self._facts = {"fault": str(error)}
        self._is_known = True

    def _fill(self) -> None:
        if self._length_s > _LONG_S:
            self._outline()
        for piece in range(len(self._pieces)):
            while (asked := self._asked) is not None:
                for wanted in self._left_in(*asked):
                    if self._asked is not asked:
                        break
                    self._read_piece(wanted, with_rests=True)
                else:
                    self._asked = None if self._asked is asked else self._asked
            self._read_piece(piece, with_rests=True)

    def _left_in(self, from_s: float, to_s: float) -> list[int]:
        """Return the pieces not read yet that may contain messages of a part, in order."""
        bounds = self._bounds_ns(from_s, to_s)
        return [piece for piece in sorted(self._left.copy()) if self._pieces[piece].has(*bounds)]

    def _bounds_ns(self, from_s: float, to_s: float) -> tuple[int, int]:
        first_ns, last_ns = (self._start_ns + round(at_s * 1e9) for at_s in (from_s - _MARGIN_S, to_s + _MARGIN_S))
        return first_ns, last_ns

    def _read_piece(self, piece: int, *, with_rests: bool = False) -> None:
        """Read a piece into the levels, unless it has been read already; two threads may request it."""
        with self._reading:
            if piece not in self._left:
                return
            self._add(self._pieces[piece])
            self._left.discard(piece)
        if with_rests:
            time.sleep(_REST_S)

    def _add(self, piece: Piece, most: int | None = None) -> None:
        """Read a piece, or its first `most` messages, into the levels."""
        messages = islice(piece.recording.select(is_curve, blocks=piece.blocks), most)
        before = piece.recording.select(is_link, blocks=piece.lead)
        for name, times, values in read_samples(messages, before, self._known_timeline(), self._start_ns):
            self._levels.add(name, times, values)

    def _outline(self) -> None:
        """Read some messages at equal distances, so that a recording of hours has an outline within seconds."""
        for piece in self._pieces[:: max(1, len(self._pieces) // _LOOKS)]:
            self._add(piece, _LOOK)
            time.sleep(_REST_S)

    def _raw(self, from_s: float, to_s: float) -> dict[str, Facts]:
        first_ns, last_ns = self._bounds_ns(from_s, to_s)
        pieces: dict[str, list[tuple[Floats, Floats]]] = {stream.name: [] for stream in STREAMS}
        messages = self._recording.select(is_curve, first_ns, last_ns)
        before = self._recording.select(is_link, first_ns - _BEFORE_NS, first_ns)
        for name, times, values in read_samples(messages, before, self._known_timeline(), self._start_ns):
            inside = (times >= from_s) & (times <= to_s)
            pieces[name].append((times[inside], values[:, inside]))
        samples = {}
        for stream in STREAMS:
            parts = pieces[stream.name] or [(np.empty(0), np.empty((len(stream.columns), 0)))]
            times, values = (np.concatenate([part[i] for part in parts], axis=-1) for i in (0, 1))
            samples[stream.name] = packed(times, values)
        return samples
