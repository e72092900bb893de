"""A recording of real devices, read again with another calibration."""

from pathlib import Path
from typing import Any

import pytest
import yaml
from telenano_devices.handle.emulated_handle import DEVICE_ID, POSITION_ZERO
from telenano_devices.handle.emulated_handle import calibration_of as handle_file
from telenano_devices.t7.t7_model import calibration_of as stage_file

from telenano.recording import FileSettings, Recording, RecordingWriter
from telenano.sections import HapticConfig
from telenano.settings import merge
from telenano.testing import EPOCH_NS, invoke, numbered
from telenano.wire import encode

HAND_ID = f"{DEVICE_ID:016x} 2026-01-01T00:00:00+00:00"
STAGE_ID = "t7 470012345 2026-01-01T00:00:00+00:00"


def recorded(folder: Path, *, raw: bool = True) -> Path:
    """Write a recording of both devices at 10 counts, 2.6 V and 12.3 mV, as their old calibrations had it."""
    writer = RecordingWriter.create("recorder@master", FileSettings(directory=folder))
    counts = {"position_raw": POSITION_ZERO + 10, "velocity_raw": 5, "operator_force_raw": 0, "drive_raw": 3}
    volts = {"output_v": 2.6, "input_v": 0.0123}
    device = {"device": "ok", "sample_age_s": 1e-3}
    rows: list[tuple[str, str, str, dict[str, Any]]] = [
        ("node/health", "haptic_node@master", "master", {"calibration": HAND_ID}),
        ("node/health", "afm_node@slave", "slave", {"calibration": STAGE_ID}),
        ("haptic/state", "haptic_node@master", "master", {**device, **counts} if raw else {}),
        ("afm/state", "afm_node@slave", "slave", {**device, **volts} if raw else {}),
    ]
    for seq, (topic, src, site, fields) in enumerate(rows):
        channel = writer.channel(topic, src, site)
        message = numbered(topic, seq, src=src, **fields)
        writer.write(channel, EPOCH_NS + seq * 1_000_000, EPOCH_NS, seq, encode(message))
    writer.finish()
    return writer.path


def written(path: Path, document: dict[str, object], **changes: Any) -> str:
    path.write_text(yaml.safe_dump(merge(document, changes)))
    return str(path)


def test_positions_and_forces_are_those_of_the_new_calibration(tmp_path: Path) -> None:
    source = recorded(tmp_path)
    handle = written(tmp_path / "h.yaml", handle_file(HapticConfig()), position={"m_per_count": 2e-6})
    stage = written(tmp_path / "s.yaml", stage_file(1e6, 40.0), deflection={"zero_v": 0.0003}, stage={"m_per_v": 5e-8})
    out = tmp_path / "again.mcap"
    arguments = ["bag", "recalibrate", str(source), "--handle", handle, "--stage", stage, "--out", str(out), "--json"]
    done = invoke(arguments)
    assert done.exit_code == 0, done.output
    before = {message.topic + message.src: message.decode() for message in Recording(source).messages()}
    after = {message.topic + message.src: message.decode() for message in Recording(out).messages()}
    hand, tip = after["haptic/statehaptic_node@master"], after["afm/stateafm_node@slave"]
    assert hand.position_m[2] == pytest.approx(-10 * 2e-6)
    assert hand.velocity_m_per_s[2] == pytest.approx(-5 * 2e-6)
    assert tip.base_position_m[2] == pytest.approx(-0.1 * 5e-8)
    assert tip.deflection_m == pytest.approx(0.012 / 1e6)
    assert tip.tip_force_n[2] == pytest.approx(40.0 * 0.012 / 1e6)
    # what was asked of the devices, and what they sent, stays what it was
    was = before["haptic/statehaptic_node@master"]
    assert (hand.reference_m, hand.position_raw, hand.t_ns) == (was.reference_m, was.position_raw, was.t_ns)


def test_calibration_of_another_device_is_refused(tmp_path: Path) -> None:
    source = recorded(tmp_path)
    stage = written(tmp_path / "s.yaml", stage_file(1e6, 40.0), instrument={"serial": 7})
    out = tmp_path / "again.mcap"
    done = invoke(["bag", "recalibrate", str(source), "--stage", stage, "--out", str(out)])
    assert done.exit_code == 2
    text = " ".join(done.output.split())
    assert "was recorded with the device t7 470012345, and the calibration is that of t7 7" in text
    assert not out.exists()


def test_recording_without_raw_values_is_a_sentence(tmp_path: Path) -> None:
    source = recorded(tmp_path, raw=False)
    handle = written(tmp_path / "h.yaml", handle_file(HapticConfig()))
    done = invoke(["bag", "recalibrate", str(source), "--handle", handle, "--out", str(tmp_path / "a.mcap")])
    assert done.exit_code != 0
    assert "has no raw values" in " ".join(done.output.split())
    neither = invoke(["bag", "recalibrate", str(source), "--out", str(tmp_path / "b.mcap")])
    assert neither.exit_code == 2
    assert "give a calibration file" in neither.output
