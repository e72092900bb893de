"""A drawn signal is that of its publisher, however late the recorder was."""

from pathlib import Path

import numpy as np
from recorder_samples import EPOCH_NS, MILLISECOND_NS, NODE, haptic_state

from analysis.plot import read_traces
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
