"""A report of recordings that are whole, of parts of one, and into folders that cannot be written."""

import errno
import io
import json
import os
import sys
from collections import Counter
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from PIL import Image

from telenano.analysis import Session
from telenano.analysis.fig12 import draw_fig12
from telenano.analysis.report import figure_title, write_files, write_report
from telenano.recording.channel_filter import ALL
from telenano.recording.multi_file import open_recordings
from telenano.recording.reader import Recording
from telenano.recording.rewrite import filter_recording
from telenano.recording.silence import cut_off
from telenano.sections import afm_section
from telenano.wire.errors import ReportError


@pytest.fixture(scope="module")
def session(recording_of: Callable[[str], Path]) -> Path:
    """Return the recording of two seconds of a session, with its scenario."""
    return recording_of("wave")


@pytest.fixture(scope="module")
def whole(session: Path, tmp_path_factory: pytest.TempPathFactory) -> tuple[dict[str, Any], bytes]:
    out = tmp_path_factory.mktemp("whole")
    steps: list[str] = []
    found = write_report(session, out, show=steps.append), (out / "fig12.png").read_bytes()
    assert [step.partition(":")[0] for step in steps] == [f"{n} of 3" for n in (1, 2, 3)]
    return found


@pytest.mark.check("takes 1 s")
def test_a_report_builds_no_model_of_the_instrument(
    session: Path, whole: tuple[dict[str, Any], bytes], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    afm_section._plant.cache_clear()
    monkeypatch.setattr(afm_section, "build_tip_sample", lambda *given: pytest.fail("the session that ran built it"))
    assert write_report(session, tmp_path) == whole[0]


@pytest.fixture(scope="module")
def parts(session: Path, tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    """Return the recording in two parts, of which the second begins 0.3 s after the end of the first."""
    folder = tmp_path_factory.mktemp("parts")
    paths = [folder / "session.mcap", folder / "session_1.mcap"]
    filter_recording(session, paths[0], ALL, end_s=1.2)
    filter_recording(session, paths[1], ALL, start_s=1.5)
    return paths


@pytest.mark.check("takes 2 s")
def test_a_report_opens_each_file_once(parts: list[Path], tmp_path: Path) -> None:
    opened: Counter[str] = Counter()
    is_counted = True

    def count(event: str, given: tuple[Any, ...]) -> None:
        if is_counted and event == "open" and str(given[0]).endswith(".mcap"):
            opened[str(given[0])] += 1

    # it cannot be taken away again
    sys.addaudithook(count)
    write_report(parts, tmp_path)
    is_counted = False
    assert opened == dict.fromkeys(map(str, parts), 1)


@pytest.mark.check("takes 1.2 s")
def test_a_part_of_a_session_is_not_called_whole(parts: list[Path], tmp_path: Path) -> None:
    known = "recorder@master: the disk was full"
    summary = write_report(parts[0], tmp_path, [known])["recording"]
    assert summary["complete"] is False
    (sentence, *rest) = summary["missing"]
    assert sentence.startswith("the recording ends within the operator's force profile")
    # what the launcher knows besides
    assert rest == [known]


@pytest.mark.check("takes 0.9 s")
def test_parts_are_joined_and_the_gap_is_stated(
    whole: tuple[dict[str, Any], bytes], parts: list[Path], tmp_path: Path
) -> None:
    summary = write_report(parts, tmp_path)
    assert summary["duration_s"] == whole[0]["duration_s"]
    recording = summary["recording"]
    assert recording["complete"] is False
    assert recording["lost"] > 1000
    (pause, *messages) = recording["missing"][: 1 + 5]
    assert pause.startswith("nothing was recorded for 0.3")
    assert pause.endswith("between session.mcap and session_1.mcap")
    assert all("messages of" in sentence for sentence in messages)
    assert [part["file"] for part in recording["parts"]] == ["session.mcap", "session_1.mcap"]
    first, second = recording["parts"]
    assert second["begins_s"] - first["ends_s"] == pytest.approx(second["pause_s"], rel=0, abs=2e-3)
    assert json.loads((tmp_path / "summary.json").read_text()) == summary
    # grey where nothing is known, and no line across it
    assert (tmp_path / "fig12.png").read_bytes() != whole[1]


@pytest.fixture
def full_disk(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let every write end after half of the data."""
    write = Path.write_bytes

    def write_half(path: Path, data: bytes) -> int:
        write(path, data[: len(data) // 2])
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(Path, "write_bytes", write_half)


def test_the_file_of_the_figure_has_the_conditions_in_it(whole: tuple[dict[str, Any], bytes]) -> None:
    summary, png = whole
    words = Image.open(io.BytesIO(png)).info["Description"]
    assert words.startswith(f"{summary['scenario']}, wave, ")
    for part in ("impedance_n_s_per_m=", "seed 0", f"telenano {summary['version']}", f"commit {summary['commit']}"):
        assert part in words


@pytest.mark.check("takes 0.8 s")
@pytest.mark.usefixtures("full_disk")
def test_a_disk_that_fills_up_leaves_the_summary_and_no_half_file(parts: list[Path], tmp_path: Path) -> None:
    with pytest.raises(ReportError, match=r"fig12.png: cannot be written: No space left on device") as caught:
        write_report(parts[1], tmp_path)
    assert caught.value.summary["recording"]["messages"] > 1000
    assert list(tmp_path.iterdir()) == []


def test_without_the_package_of_figures_the_summary_is_written(
    parts: list[Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def undrawn(*given: Any) -> Any:
        raise ModuleNotFoundError("No module named 'matplotlib'", name="matplotlib")

    monkeypatch.setattr("telenano.analysis.report.fig12_files", undrawn)
    said = r"summary\.json is written, and no figure is drawn: matplotlib is not installed: pip install"
    with pytest.raises(ReportError, match=said) as caught:
        write_report(parts[1], tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == ["summary.json"]
    assert json.loads((tmp_path / "summary.json").read_text())["law"] == caught.value.summary["law"]


@pytest.mark.usefixtures("full_disk")
def test_what_stands_in_the_place_of_a_file_that_cannot_be_written_stays(tmp_path: Path) -> None:
    (tmp_path / "summary.json").write_text("of the session before")
    with pytest.raises(ReportError, match=r"/summary\.json: cannot be written: No space left"):
        write_files(tmp_path, {"summary.json": b"{}"})
    assert [path.read_text() for path in tmp_path.iterdir()] == ["of the session before"]


def test_a_folder_that_cannot_be_made_is_named(tmp_path: Path) -> None:
    (tmp_path / "taken").write_text("a file")
    with pytest.raises(ReportError, match="taken"):
        write_files(tmp_path / "taken" / "below", {"summary.json": b"{}"})


def test_a_session_that_was_recorded_from_its_start_to_its_end_lacks_nothing_at_either(
    session: Path, tmp_path: Path
) -> None:
    assert cut_off(Recording(session)) == ()
    hand = Recording(session).columns("haptic/state", ("session_s", "log_ns"))
    running = np.flatnonzero(hand["session_s"] >= 0.0)
    begun_ns = Recording(session).span_ns[0]
    middle_s = 1e-9 * float(hand["log_ns"][running[running.size // 2]] - begun_ns)
    ends = [{"end_s": middle_s}, {"start_s": middle_s}]
    texts = []
    for name, bounds in zip(("beginning", "end"), ends, strict=True):
        filter_recording(session, tmp_path / f"{name}.mcap", ALL, **bounds)
        texts += cut_off(Recording(tmp_path / f"{name}.mcap"))
    assert [text.partition(", ")[0].split(" 0.")[0].split(" 1.")[0] for text in texts] == [
        "the recording ends within the operator's force profile",
        "the recording begins",
    ]


def test_no_line_is_drawn_across_a_gap(parts: list[Path]) -> None:
    session = Session.of(open_recordings(parts))
    series = session.series(session.gaps_s())
    (gap,) = series.gaps_s
    assert gap[1] - gap[0] == pytest.approx(0.3, rel=0.2)
    figure = draw_fig12(series, "title")
    for axes in figure.axes[:2]:
        for line in axes.lines[:2]:
            times = line.get_xdata()
            steps = [later - earlier for earlier, later in pairwise(times)]
            if len(times) > 10:
                assert not any(step > 0.1 for step in steps if not np.isnan(step))


CONDITIONS_OF_A_TITLE = {
    "law": ["wave"],
    "link_round_trip_ms": 40.0,
    "loop_round_trip_ms": 41.0,
    "link_profile": "clean",
    "hold_ratio": 1.05,
    "recording": {"complete": True},
}


def test_the_title_names_the_verdict_and_calls_no_drift_unstable() -> None:
    found = {**CONDITIONS_OF_A_TITLE, "verdict": "drifting", "stable": False}
    text = figure_title(SimpleNamespace(scenario="fig12", conditions=found), found)  # type: ignore[arg-type]
    # the ratio of one hold is no merit of a session that another one decides
    assert text == "fig12, wave, round trip of the link 40 ms: drifting"
    text = figure_title(SimpleNamespace(scenario="fig12", conditions=found), {**found, "verdict": "stable"})  # type: ignore[arg-type]
    assert text == "fig12, wave, round trip of the link 40 ms: stable, hold ratio 1.050"
