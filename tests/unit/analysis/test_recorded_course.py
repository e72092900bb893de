"""What was set for a recorded session, and its columns, come from what the nodes reported."""

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import yaml
from recorder_samples import EPOCH_NS, MILLISECOND_NS, NODE, sample

from telenano.analysis.fig12 import SessionSeries
from telenano.analysis.recorded_course import conditions_of, course_of
from telenano.recording.reader import Recording
from telenano.recording.site_clock import Timeline
from telenano.recording.writer import FileSettings, RecordingWriter
from telenano.wire import encode
from telenano.wire.codec import fields_of

SCENARIO = {
    "name": "trial", "description": "", "duration_s": 1.0,
    "delay_node": {"forward": {"delay_s": 0.004}, "backward": {"delay_s": 0.004}},
}  # fmt: skip
SET = "delay_node@master: set forward.delay_s = 0.02"


def stated(folder: Path, reports: dict[int, float], changed: tuple[str, ...] = (), **scenario: Any) -> Any:
    """Return the conditions of a session of which the link reported delays one way [s], by time from its start [ms]."""
    writer = RecordingWriter.create(NODE, FileSettings(directory=folder))
    writer.attach("scenario.yaml", "application/yaml", yaml.safe_dump(SCENARIO | scenario).encode(), EPOCH_NS)
    channel = writer.channel("link/status", "delay_node@master", "master")
    for n, (at_ms, delay_s) in enumerate(reports.items()):
        way = fields_of(sample("link/status", 0))["forward"] | {"settings": {"delay_s": delay_s}, "profile": "lte"}
        t_ns = EPOCH_NS + (at_ms + 1000) * MILLISECOND_NS
        message = sample("link/status", n, src="delay_node@master", t_ns=t_ns, forward=way, backward=way)
        writer.write(channel, t_ns, t_ns, n, encode(message))
    writer.finish()
    recording = Recording(writer.path)
    facts = {
        "law": ["wave", "passivity"], "parameters": {}, "changed": list(changed), "link_profile": "constant delay",
        "link_seed": 3,
    }  # fmt: skip
    session = SimpleNamespace(
        conditions=facts, scenario="trial", start_ns=EPOCH_NS + 1000 * MILLISECOND_NS, timeline=Timeline(recording)
    )
    return conditions_of(recording, session)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("reports", "changed", "round_trip_ms"),
    [
        pytest.param({}, (), 8.0, id="nothing reported, as in the scenario"),
        pytest.param({-150: 0.01, -50: 0.01, 50: 0.01}, (), 20.0, id="set long before the session"),
        pytest.param({-150: 0.004, -50: 0.004, 50: 0.02}, (), 40.0, id="set just before the session"),
        pytest.param({-150: 0.004, -50: 0.004, 50: 0.02}, (SET,), 8.0, id="set in the session"),
        pytest.param({-50: 0.004, 50: 0.02}, ("controller@master: set law = wave",), 40.0, id="law set in the session"),
        pytest.param({50: 0.03}, (SET,), 60.0, id="only reported in the session"),
    ],
)
def test_the_delay_is_the_one_in_force_when_the_session_began(
    tmp_path: Path, reports: dict[int, float], changed: tuple[str, ...], round_trip_ms: float
) -> None:
    found = stated(tmp_path, reports, changed)
    assert found.round_trip_ms == round_trip_ms
    assert found.link_profile == ("lte" if reports else "constant delay")
    assert (found.law, found.changed, found.link_seed) == ("wave then passivity", changed, 3)


@pytest.mark.parametrize(
    ("afm", "hand", "sample_words", "hand_words"),
    [
        ({}, {}, "tip_sample", "force_profile to 2 N"),
        (
            {"environment": "spring", "spring": {"stiffness_n_per_m": 20.0}},
            {},
            "spring 20.0 N/m",
            "force_profile to 2 N",
        ),
        ({"sample": {"name": "flat"}}, {"operator": {"kind": "interactive"}}, "tip_sample over flat", "interactive"),
        ({"driver": "modbus"}, {"driver": "a_handle"}, "at modbus", "at a_handle"),
        (
            {},
            {"operator": {"kind": "impedance", "arm": "soft", "path": [{"time_s": 0.0, "position_m": 0.0}]}},
            "tip_sample",
            "soft arm",
        ),
    ],
)
def test_sample_and_hand_are_stated_in_words(
    tmp_path: Path, afm: dict[str, Any], hand: dict[str, Any], sample_words: str, hand_words: str
) -> None:
    found = stated(tmp_path, {}, afm_node=afm, haptic_node=hand)
    assert (found.sample, found.hand) == (sample_words, hand_words)


def test_a_column_has_the_newest_value_and_none_that_is_old() -> None:
    hand_s = np.array([0.0, 0.01, 0.02, 0.2])
    tip_s = np.array([0.005, 0.02])
    series = SessionSeries(hand_s, hand_s, hand_s, np.empty(0), np.empty(0), tip_s, tip_s, tip_s, 2.0)
    tip = {"in_contact": np.array([True, True]), "placed": np.array([np.nan, np.nan]), "base_position_m.2": -tip_s}
    session = SimpleNamespace(
        series=lambda: series,
        tip=tip,
        touches=lambda: np.array([True, True]),
        command={"force_n.2": np.empty(0)},
        hand={"mode": np.array(["force"] * 3 + ["off"])},
    )
    course = course_of(session)  # type: ignore[arg-type]
    for name in ("tip_force_n", "base_position_m", "separation_m"):
        assert course[name].tolist() == pytest.approx([np.nan, 0.005, 0.02, np.nan], nan_ok=True)
    assert course["scaled_tip_force_n"][1] == 0.01
    assert course["in_contact"].tolist() == [False, True, True, False]
    assert course["hand_following"].tolist() == [True, True, True, False]
    # no command was recorded
    assert np.isnan(course["reference_m"]).all() and np.isnan(course["rendered_force_n"]).all()
