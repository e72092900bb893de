"""A plot unpacks the chunks that have what it shows, and no other."""

from pathlib import Path

import pytest
from telenano_lab.studies.plot import read_traces

from telenano.recording import FileSettings, RecordingWriter
from telenano.recording.reader import Recording
from telenano.testing import EPOCH_NS, hand_state, numbered
from telenano.wire import encode


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


def test_a_plot_reads_the_chunks_that_have_its_topic_and_decodes_nothing_else(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path, unpacked = _hand(tmp_path, 2000), []
    inside = Recording._content
    monkeypatch.setattr(Recording, "_content", lambda *given: unpacked.append(given[2].offset) or inside(*given))
    monkeypatch.setattr("telenano.recording.messages.RecordedMessage.fields", None)
    (trace,) = read_traces(path, ["session/event.seq"])
    assert trace.values.tolist() == [0.0, 1999.0]
    assert len(unpacked) == 2
    unpacked.clear()
    first, second = read_traces(path, ["haptic/state.seq", "haptic/state.position_m.2"])
    assert (len(first.values), len(second.values)) == (2000, 2000)
    # both fields by one pass
    assert len(unpacked) == len(set(unpacked))
