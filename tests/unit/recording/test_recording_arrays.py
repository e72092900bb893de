import math
from collections.abc import Callable
from pathlib import Path

import msgpack
import numpy as np
import pytest
from recorder_samples import EPOCH_NS, MILLISECOND_NS, NODE, haptic_state, teleop_forward

from telenano.recording import columns
from telenano.recording.reader import Recording
from telenano.recording.recorder_config import RecorderConfig
from telenano.recording.writer import RecordingWriter
from telenano.wire import encode
from telenano.wire.errors import RecordingError

MakeFile = Callable[..., Path]


def test_columns_have_the_values_in_the_kinds_of_the_fields(make_file: MakeFile) -> None:
    recording = Recording(make_file(40))
    fields = ["position_m.2", "operator_force_n.0", "t_ns", "log_ns", "publish_ns", "seq", "limited", "src"]
    found = recording.columns("haptic/state", fields)
    number = np.arange(40)
    assert list(found) == fields
    np.testing.assert_array_equal(found["position_m.2"], -1e-3 * number)
    np.testing.assert_array_equal(found["operator_force_n.0"], np.full(40, 0.1))
    np.testing.assert_array_equal(found["t_ns"], EPOCH_NS + number * MILLISECOND_NS)
    np.testing.assert_array_equal(found["log_ns"] - found["publish_ns"], np.full(40, 100))
    np.testing.assert_array_equal(found["seq"], number)
    np.testing.assert_array_equal(found["limited"], number % 2 == 1)
    assert found["src"][0] == "haptic_node@master"
    assert [found[field].dtype.kind for field in fields] == ["f", "f", "i", "i", "i", "i", "b", "O"]


def test_nil_becomes_nan(config: RecorderConfig) -> None:
    writer = RecordingWriter.create(NODE, config)
    channel = writer.channel("teleop/forward", "controller@master", "master")
    for seq, wave in enumerate((None, (1e-9, 2e-9, 3e-9))):
        writer.write(channel, seq, seq, seq, encode(teleop_forward(seq, wave_sqrt_w=wave)))
    writer.finish()
    found = Recording(writer.path).columns("teleop/forward", ["wave_sqrt_w.2"])["wave_sqrt_w.2"]
    assert math.isnan(found[0])
    assert found[1] == 3e-9


@pytest.mark.parametrize(
    ("channel", "field", "text"),
    [
        (
            "haptic/stat",
            "t_ns",
            "has no channel haptic/stat; did you mean haptic/state.; its channels are haptic/state, teleop",
        ),
        (
            "haptic/state",
            "positon_m.2",
            "haptic/state, seq 0: has no field positon_m.2; did you mean position_m.; its fields are seq, t_ns",
        ),
        ("haptic/state", "position_m.3", "has no field position_m.3"),
        ("haptic/state", "t_ns.1", "has no field t_ns.1"),
        ("haptic/state", "position_m", "position_m is a tuple; name one of its parts, such as position_m.0"),
    ],
)
def test_what_is_not_there_is_named(make_file: MakeFile, channel: str, field: str, text: str) -> None:
    with pytest.raises(RecordingError, match=rf"session\.mcap.*{text}"):
        Recording(make_file(2)).columns(channel, [field])


@pytest.mark.parametrize(
    ("values", "kind"),
    [
        ([1, 2, 3, 2**62 + 1], "i"),
        ([1, 2, 3.5, None, 4], "f"),
        ([None, None, 1.0], "f"),
        ([None, None, "a", None, "b"], "O"),
        (["a", "b", "c"], "O"),
        ([True, False, True], "b"),
        ([None, None, None], "f"),
        ([True, None, False], "f"),
        ([None, True], "f"),
        ([True, 2, 0.5, None], "f"),
        ([1, "a", None], "O"),
        ([0.5, None, True, "a"], "O"),
        ([1, 2**64 - 1, 3], "f"),
        ([1, (2, 3)], None),
        ([True, None, {}], None),
    ],
)
def test_a_column_does_not_depend_on_how_much_is_packed_at_once(
    config: RecorderConfig, monkeypatch: pytest.MonkeyPatch, values: list[object], kind: str | None
) -> None:
    # of a newer version: its messages are taken as they came
    topic = "teleop/forward"
    writer = RecordingWriter.create(NODE, config)
    channel = writer.channel(topic, "controller@master", "master")
    for seq, value in enumerate(values):
        writer.write(channel, seq, seq, seq, msgpack.packb({"v": 10**6, "value": value}))
    writer.finish()
    recording = Recording(writer.path)
    for at_once in (1, 2, 3, 1000):
        monkeypatch.setattr(columns, "_AT_ONCE", at_once)
        if kind is None:
            with pytest.raises(RecordingError, match="value is a "):
                recording.columns(topic, ["value"])
            continue
        found = recording.columns(topic, ["value"])["value"]
        assert found.dtype.kind == kind
        expected = [math.nan if value is None and kind == "f" else value for value in values]
        np.testing.assert_array_equal(found, np.array(expected, dtype=found.dtype))


@pytest.mark.parametrize("wrong", [math.nan, math.inf, "x", [1.0], {}, True])
@pytest.mark.parametrize("at_once", [1, 4, 1000])
def test_a_message_that_is_not_valid_is_counted_and_left_out(
    config: RecorderConfig, monkeypatch: pytest.MonkeyPatch, wrong: object, at_once: int
) -> None:
    monkeypatch.setattr(columns, "_AT_ONCE", at_once)
    writer = RecordingWriter.create(NODE, config)
    channel = writer.channel("haptic/state", "haptic_node@master", "master")
    for seq in range(12):
        fields = msgpack.unpackb(encode(haptic_state(seq)))
        writer.write(channel, seq, seq, seq, msgpack.packb(fields | ({"step_s": wrong} if seq in (5, 9) else {})))
    writer.finish()
    recording = Recording(writer.path)
    found = recording.columns("haptic/state", ("step_s", "seq", "log_ns"))
    assert found["seq"].tolist() == found["log_ns"].tolist() == [seq for seq in range(12) if seq not in (5, 9)]
    assert np.isfinite(found["step_s"]).all()
    assert sum(recording.left_out.rejected.values()) == 2
    assert "step_s" in recording.left_out.last_error
