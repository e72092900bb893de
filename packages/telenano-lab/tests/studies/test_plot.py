"""A drawn signal is that of its publisher, however late the recorder was."""

from pathlib import Path

import numpy as np
import pytest
from telenano_lab.studies import plot
from telenano_lab.studies.plot import Trace, extremes, read_traces

from telenano.recording import FileSettings, RecordingWriter
from telenano.testing import EPOCH_NS, hand_state, numbered
from telenano.wire import encode


def test_a_ramp_stays_a_ramp_where_the_recorder_was_late(tmp_path: Path) -> None:
    writer = RecordingWriter.create("recorder@master", FileSettings(directory=tmp_path))
    channel = writer.channel("haptic/state", "haptic_node@master", "master")
    for n in range(600):
        state = hand_state(n, t_ns=EPOCH_NS + n * 1_000_000)
        # received in heaps, 200 ms apart
        writer.write(channel, EPOCH_NS + (1 + n // 200) * 200 * 1_000_000, state.t_ns, n, encode(state))
    writer.finish()
    (trace,) = read_traces(writer.path, ["haptic/state.position_m.2"])
    assert trace.time_s[0] == 0.0
    np.testing.assert_allclose(np.diff(trace.time_s), 1e-3, rtol=1e-6)
    np.testing.assert_allclose(np.diff(trace.values), -1e-3, rtol=1e-6)


def test_a_long_trace_keeps_each_peak() -> None:
    values = np.sin(np.linspace(0.0, 20.0, 100_003))
    values[[5, 50_001, 100_002]] = 9.0, -9.0, np.nan
    time_s, kept = extremes(Trace("x", np.arange(100_003.0), values), bins=100)
    assert len(kept) <= 202
    assert (np.nanmax(kept), np.nanmin(kept)) == (9.0, -9.0)
    assert (time_s[0], time_s[-1]) == (0.0, 100_002.0)
    assert (np.diff(time_s) > 0.0).all()
    short = Trace("x", np.arange(150.0), values[:150])
    assert extremes(short, bins=100)[1] is short.values


def test_a_pixel_has_the_extremes_of_its_time_however_many_samples_that_has() -> None:
    # a publisher that was ten times as fast in its second half
    time_s = np.concatenate([np.arange(0.0, 500.0, 0.1), np.arange(500.0, 1000.0, 0.01)])
    values = np.cos(time_s)
    values[:100] = np.nan
    kept_s, kept = extremes(Trace("x", time_s, values), bins=100)
    # none of the hundred samples at the beginning is a number, and so the first span has its gap
    assert np.isnan(kept[0])
    for begin_s in np.arange(10.0, 1000.0, 10.0):
        inside, shown = _between(time_s, begin_s), _between(kept_s, begin_s)
        assert (values[inside].min(), values[inside].max()) == (kept[shown].min(), kept[shown].max())


def _between(time_s: plot.Floats, begin_s: float) -> "np.ndarray[tuple[int], np.dtype[np.bool_]]":
    return np.asarray((time_s >= begin_s - 1e-9) & (time_s < begin_s + 10.0 - 1e-9))


def _hand(folder: Path, messages: int) -> Path:
    """Write the hand at 1 kHz in many chunks, an event in the first and the last of them."""
    writer = RecordingWriter.create("recorder@master", FileSettings(directory=folder, chunk_size_bytes=8192))
    hand = writer.channel("haptic/state", "haptic_node@master", "master")
    events = writer.channel("session/event", "launcher@master", "master")
    for n in range(messages):
        state = hand_state(n, t_ns=EPOCH_NS + n * 1_000_000)
        writer.write(hand, state.t_ns + 1000, state.t_ns, n, encode(state))
        if n in (0, messages - 1):
            event = numbered("session/event", n, src="launcher@master")
            writer.write(events, state.t_ns + 1000, state.t_ns, n, encode(event))
    writer.finish()
    return writer.path


def test_a_trace_of_any_length_is_kept_in_bounded_memory(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = _hand(tmp_path, 3000)
    (whole,) = read_traces(path, ["haptic/state.position_m.2"])
    monkeypatch.setattr(plot, "_MOST_KEPT", 400)
    (bounded,) = read_traces(path, ["haptic/state.position_m.2"])
    assert len(whole.values) == 3000
    assert len(bounded.values) <= 400
    assert (bounded.time_s[0], bounded.time_s[-1]) == (whole.time_s[0], whole.time_s[-1])
    assert (bounded.values.min(), bounded.values.max()) == (whole.values.min(), whole.values.max())
