"""A drawn signal is that of its publisher, however late the recorder was."""

from pathlib import Path

import numpy as np
from recorder_samples import EPOCH_NS, MILLISECOND_NS, NODE, haptic_state

from analysis.plot import Trace, extremes, read_traces
from proto import encode
from recording.writer import FileSettings, RecordingWriter


def test_a_ramp_stays_a_ramp_where_the_recorder_was_late(tmp_path: Path) -> None:
    writer = RecordingWriter.create(NODE, FileSettings(directory=tmp_path))
    channel = writer.channel("haptic/state", "haptic_node@master", "master")
    for n in range(600):
        state = haptic_state(n, t_ns=EPOCH_NS + n * MILLISECOND_NS)
        # received in heaps, 200 ms apart
        writer.write(channel, EPOCH_NS + (1 + n // 200) * 200 * MILLISECOND_NS, state.t_ns, n, encode(state))
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
