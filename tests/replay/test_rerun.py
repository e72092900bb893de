"""The code gives the very bytes that it gave when the reference recordings were made."""

from pathlib import Path

import pytest

from services.controller.virtual_impedance import VirtualImpedanceConfig
from services.launcher.rerun import rerun
from services.recorder.compare import Tolerances
from services.recorder.edit import filter_recording
from services.recorder.reader import Recording
from services.recorder.selection import Selection
from services.runtime.errors import ConfigError, RecordingError

REFERENCES = sorted(Path(__file__).parent.glob("*.mcap"))
NODES = ("controller@master", "controller@slave", "afm_node@slave", "haptic_node@master")
REFERENCE = Path(__file__).parent / "virtual_impedance.mcap"


@pytest.fixture(scope="module")
def reference() -> Recording:
    return Recording(REFERENCE)


def test_there_is_a_reference_for_the_papers_law() -> None:
    assert REFERENCE in REFERENCES
    assert all(path.stat().st_size < 1_000_000 for path in REFERENCES)


@pytest.mark.parametrize("path", REFERENCES, ids=lambda path: path.stem)
@pytest.mark.parametrize("node", NODES)
def test_a_rerun_is_identical(path: Path, node: str) -> None:
    recording = Recording(path)
    result = rerun(recording, node)
    assert result.difference == ""
    assert result.ended_early == ""
    assert result.identical
    # nothing was left out: every recorded message of the node's outputs was met
    for topic, count in result.compared.items():
        seqs = [message.seq for message in recording.messages([topic]) if message.src == node]
        assert count == len([seq for seq in seqs if seq >= result.first_seq[topic]]) > 1000
        assert result.first_seq[topic] - seqs[0] < 500


def test_a_changed_gain_is_reported_with_message_field_and_time(reference: Recording) -> None:
    changed = 1.05 * VirtualImpedanceConfig().force_gain
    result = rerun(reference, "controller@master", settings=[f"controller.virtual_impedance.force_gain={changed}"])
    assert not result.identical
    assert result.topic == "haptic/command"
    assert result.field == "position_m.2"
    assert 0.0 < result.time_s < 10.0
    assert f"haptic/command, seq {result.seq}, {result.time_s:.6f} s after the start: re-run position_m.2" in (
        result.difference
    )
    assert result.compared["haptic/command"] > 100


def test_a_changed_gain_within_the_tolerance_is_the_same(reference: Recording) -> None:
    gain = VirtualImpedanceConfig().force_gain * (1.0 + 1e-10)
    barely = [f"controller.virtual_impedance.force_gain={gain!r}"]
    assert not rerun(reference, "controller@master", settings=barely).identical
    allowed = Tolerances({"position_m": 1e-9, "velocity_m_per_s": 1e-6, "force_n": 0.0})
    assert rerun(reference, "controller@master", allowed, barely).identical


def test_another_sample_is_reported_at_the_instrument(reference: Recording) -> None:
    result = rerun(reference, "afm_node@slave", settings=["afm_node.rest_distance_m=1.0001e-8"])
    assert result.topic == "afm/state"
    assert result.field in ("deflection_m", "tip_force_n.2", "separation_m")


def test_a_lost_input_ends_the_comparison_with_its_name(tmp_path: Path) -> None:
    cut = tmp_path / "cut.mcap"
    filter_recording(REFERENCE, cut, Selection.of(exclude=["afm/command"]))
    with pytest.raises(RecordingError, match="has no afm/command"):
        rerun(Recording(cut), "afm_node@slave")
    filter_recording(REFERENCE, tmp_path / "late.mcap", start_s=Recording(REFERENCE).info().duration_s - 1.0)
    late = rerun(Recording(tmp_path / "late.mcap"), "controller@master")
    assert min(late.first_seq.values()) > 0


def test_what_cannot_be_rerun_is_named(reference: Recording, tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="those that can are controller@master"):
        rerun(reference, "delay_node@master")
    with pytest.raises(ConfigError, match="force_gan: unknown key"):
        rerun(reference, "controller@master", settings=["controller.virtual_impedance.force_gan=1.0"])
