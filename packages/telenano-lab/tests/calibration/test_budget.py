"""The budget of a session: errors that cover, stages that add up to the loop, and what is refused."""

import json
import random
from collections.abc import Callable
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from telenano_lab.calibration import budget as budgets
from telenano_lab.calibration.budget import delay_budget, figure_budgets, scale_errors

from telenano.analysis import Session
from telenano.devices import HandleCalibration, InstrumentCalibration
from telenano.recording import Selection, Timeline, filter_recording, open_recordings
from telenano.testing import invoke
from telenano.wire import TelenanoError

NOW = datetime(2026, 11, 1, tzinfo=UTC).isoformat()
HANDLE: dict[str, Any] = {
    "schema": 1, "device_id": "0123456789abcdef", "calibrated": NOW, "max_force_n": 10.0,
    "position": {"zero_raw": 0, "m_per_count": -1e-6, "standard_error_m_per_count": 2e-9},
    "force": {"zero_raw": 0, "n_per_count": 1e-3, "standard_error_n_per_count": 1e-5, "saturation_n": 20.0},
    "drive": {"n_per_count": 1e-3}, "servo": {"stiffness_n_per_m": 1e4},
}  # fmt: skip
STAGE: dict[str, Any] = {
    "schema": 1, "instrument": {"map": "t7", "serial": 470012345}, "calibrated": NOW, "network": {"host": "127.0.0.1"},
    "stage": {"m_per_v": 8e-8, "rest_v": 1.0, "min_v": 0.0, "max_v": 5.0, "slew_v_per_s": 1e3},
    "deflection": {"range_v": 10.0, "zero_v": 0.0, "v_per_m": -2e7, "standard_error_v_per_m": 6e5},
    "cantilever": {"stiffness_n_per_m": 40.0, "standard_error_n_per_m": 1.6},
}  # fmt: skip
SUMMARY = {
    "hold_ratio": 1.05, "contact_x_cm": None, "release_force_nn": -2.0,
    "intervals": {"hold_ratio": [1.03, 1.07], "release_force_nn": [-2.0, -2.0]},
}  # fmt: skip


@pytest.fixture
def files(tmp_path: Path) -> tuple[Path, Path]:
    paths = tmp_path / "handle.yaml", tmp_path / "stage.yaml"
    for path, document in zip(paths, (HANDLE, STAGE), strict=True):
        path.write_text(yaml.safe_dump(document))
    return paths


def test_the_sources_of_a_figure_are_those_of_its_formula(files: tuple[Path, Path]) -> None:
    shares = scale_errors(HandleCalibration.from_file(files[0]), InstrumentCalibration.from_file(files[1]))
    assert list(shares.values()) == pytest.approx([0.01, 0.002, 0.04, 0.03])
    hold, release = figure_budgets(SUMMARY, shares)
    assert [part.standard for part in hold.sources] == pytest.approx([0.02 / 1.96, 0.0105, 0.042, 0.0315], rel=1e-4)
    assert sum(part.share for part in hold.sources) == pytest.approx(1.0)
    # force of the tip: 4 and 3 % are 5 %, whatever its sign, and the hand's position has no part in it
    assert release.half_width == pytest.approx(1.96 * 0.05 * 2.0, rel=1e-4)
    assert (hold.without, release.without) == ((), ())


def test_what_states_no_error_is_left_out_by_name(files: tuple[Path, Path]) -> None:
    files[1].write_text(yaml.safe_dump({**STAGE, "cantilever": {"stiffness_n_per_m": 40.0}}))
    _, release = figure_budgets(SUMMARY, scale_errors(None, InstrumentCalibration.from_file(files[1])))
    assert [part.source for part in release.sources] == ["scatter in the session", "deflection for a volt"]
    assert release.without == ("stiffness of the cantilever",)
    assert [one.half_width for one in figure_budgets(SUMMARY, {})] == pytest.approx([0.02, 0.0])


def test_the_interval_of_all_sources_covers_what_that_of_the_scatter_does_not() -> None:
    draw = random.Random(11)
    shares = dict(zip(("force of the hand for a count", *budgets._TIP_FORCE), (0.01, 0.04, 0.03), strict=True))
    covered = scattered = 0
    for _ in range(1000):
        wrong = [draw.gauss(0.0, share) for share in shares.values()]
        value = 1.05 * (1.0 + wrong[0]) / ((1.0 + wrong[1]) * (1.0 + wrong[2])) + draw.gauss(0.0, 0.01)
        interval = [value - 0.0196, value + 0.0196]
        (found,) = figure_budgets({"hold_ratio": value, "intervals": {"hold_ratio": interval}}, shares)
        covered += abs(found.value - 1.05) <= found.half_width
        scattered += interval[0] <= 1.05 <= interval[1]
    assert 930 <= covered <= 970
    assert scattered < 500


def test_the_stages_add_up_to_the_loop_and_the_link_has_its_delay(recording_of: Callable[[str], Path]) -> None:
    recording = open_recordings([recording_of("virtual_impedance")])
    session = Session.of(recording)
    *stages, loop = delay_budget(recording, session)
    assert sum(stage.mean_ms for stage in stages) == pytest.approx(loop.mean_ms, rel=1e-12)
    assert sum(stage.share for stage in stages) == pytest.approx(1.0, rel=1e-12)
    assert min(stage.mean_ms for stage in stages) > 0.0
    links = {stage.stage: stage.mean_ms for stage in stages if stage.stage.startswith("link")}
    # 4 ms each way on purpose
    assert links == {"link there, on purpose": 4.0, "link back, on purpose": 4.0}
    assert {stage.stage for stage in stages if stage.clock_ms} == {"law of the slave", "law of the master"}
    ages_ms = 1e-6 * (session.hand["answered_at_ns"] - session.hand["answered_t_ns"])
    assert loop.p50_ms == pytest.approx(float(np.median(ages_ms[session.hand["answered_t_ns"] > 0])), rel=0.02)


def test_another_clock_of_the_slave_moves_the_two_ways_against_each_other(
    recording_of: Callable[[str], Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    recording = open_recordings([recording_of("virtual_impedance")])
    session = Session.of(recording)
    before = delay_budget(recording, session)
    times_ns = Timeline.times_ns

    def shifted(self: Any, src: str, stamps_ns: Any, heard_ns: Any = None) -> Any:
        return times_ns(self, src, stamps_ns, heard_ns) + 1_000_000 * src.endswith("@slave")

    monkeypatch.setattr(Timeline, "times_ns", shifted)
    after = delay_budget(recording, session)
    changes = {new.stage: new.mean_ms - old.mean_ms for new, old in zip(after, before, strict=True)}
    moved = {name: change for name, change in changes.items() if abs(change) > 1e-9}
    # The rest of the way back is never below zero, so that its part on purpose gives way.
    assert moved.pop("law of the slave") == pytest.approx(1.0, abs=1e-9)
    assert sum(moved.values()) == pytest.approx(-1.0, abs=1e-9)
    assert set(moved) <= {"law of the master", "link back, on purpose"}


def test_a_recording_whose_loop_cannot_be_followed_is_refused_in_words(
    recording_of: Callable[[str], Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    filter_recording(recording_of(), tmp_path / "half.mcap", Selection.of(["haptic/*", "afm/state", "session/*"]))
    found = invoke(["budget", tmp_path / "half.mcap"])
    assert found.exit_code != 0
    assert "fewer than 50 samples of the hand can be followed" in found.stderr
    recording = open_recordings([recording_of("virtual_impedance")])
    session = Session.of(recording)
    with pytest.raises(TelenanoError, match="fewer than 50 samples of the hand can be followed"):
        delay_budget(recording, replace(session, start_ns=0, end_ns=1))
    intruders = [
        recording.channels[0]._replace(channel_topic="afm/command", src=f"made_up_{n}@slave") for n in range(9)
    ]
    monkeypatch.setattr(recording, "channels", [*recording.channels, *intruders])
    with pytest.raises(TelenanoError, match=r"afm/command has 10 publishers, .* and made_up_0@slave among them"):
        delay_budget(recording, replace(session, start_ns=0, end_ns=2**62))


def test_the_command_prints_and_writes_both_tables(
    recording_of: Callable[[str], Path], files: tuple[Path, Path], tmp_path: Path
) -> None:
    path = str(recording_of("virtual_impedance"))
    given = ["--handle", str(files[0]), "--stage", str(files[1]), "--out", str(tmp_path / "out")]
    found = invoke(["budget", path, *given, "--json"])
    assert found.exit_code == 0, found.stderr
    document = json.loads(found.stdout)
    assert document == json.loads((tmp_path / "out" / "budget.json").read_text())
    assert [one["stage"] for one in document["delay"]][-1] == "loop"
    page = (tmp_path / "out" / "budget.html").read_text()
    assert "deflection for a volt" in page
    assert "The link adds a delay of 8 ms there and back, as set." in page
    # without noise no mean has a scatter that says how well it is known, so the scales alone are in the budget
    shown = invoke(["budget", path, "--stage", str(files[1])], env={"COLUMNS": "200"})
    assert shown.exit_code == 0
    assert "scatter in the session" in shown.stdout
    assert "are left out: " in shown.stdout.replace("is left out", "are left out")
