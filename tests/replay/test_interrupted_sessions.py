"""Silence, loss and interruption are told apart, alike by report, verify, split and merge, in drawn sessions."""

from pathlib import Path
from typing import Any

import pytest
from interrupted_sessions import HOLD_S, InterruptedSession

from telenano.analysis import Session, summary_of
from telenano.recording.multi_file import open_recordings
from telenano.recording.rewrite import merge_recordings, split_recording
from telenano.recording.verify import verify
from telenano.testing import run

# a tenth of a hold without samples is more than may be overlooked
SHARE = 0.1


def summary_at(paths: list[Path]) -> dict[str, Any]:
    recording = open_recordings(paths)
    return summary_of(Session.of(recording), recording)


def check(seed: int, folder: Path) -> None:
    session = InterruptedSession.of(seed)
    path, lacks = session.record(folder)
    parts = [Path(part.path) for part in split_recording(path, folder / "parts", interval_s=0.7)]
    merged = folder / "merged.mcap"
    merge_recordings(parts, merged)
    verdicts = set()
    for files in ([path], parts, [merged]):
        summary = summary_at(files)
        # not whole is only what lacks a message that was sent
        assert summary["recording"]["complete"] is (lacks == 0), (session, summary["recording"]["missing"])
        findings = [finding.text for finding in verify(files).findings if finding.level != "info"]
        assert bool(findings) is (lacks > 0), (session, findings)
        verdicts.add(summary["verdict"])
    assert len(verdicts) == 1, session
    summary = summary_at([path])
    if any(loss.channel in ("haptic/state", "afm/state") for loss in session.losses) or session.cut != "no":
        return
    silent = [one for one in summary["interruptions"] if one["kind"] == "source_silent"]
    assert summary["sources_silent"] == len(silent)
    for found, (topic, start_s, end_s) in zip(silent, session.silent_s, strict=True):
        assert found["reason"] == f"the {'hand' if topic.startswith('haptic') else 'AFM'} sent nothing"
        assert found["start_s"] == pytest.approx(start_s, abs=0.01)
        assert found["end_s"] == pytest.approx(end_s, abs=0.02)
        inside_s = min(end_s, HOLD_S[1]) - max(start_s, HOLD_S[0])
        if inside_s > (SHARE + 0.03) * (HOLD_S[1] - HOLD_S[0]):
            (hold,) = summary["holds"]
            assert hold["verdict"] == "guarded", (session, hold)
            # what came first is the cause, and all of it is told of the session
            assert "sent nothing" in summary["reason"]
            assert hold["coupled_share"] <= 1.0 - inside_s / (HOLD_S[1] - HOLD_S[0]) + 0.03
    if not session.silent_s:
        assert not any("sent nothing" in hold["reason"] for hold in summary["holds"])


@pytest.mark.check("runs rigs in virtual time")
@pytest.mark.drawn(0.5)
@pytest.mark.parametrize("seed", [4, 6, 9, 15, 27, 39, 52])
def test_what_is_said_of_a_session_is_the_same_by_each_command(seed: int, tmp_path: Path) -> None:
    check(seed, tmp_path)


@pytest.mark.endurance
@pytest.mark.parametrize("seed", range(1000, 1060))
def test_what_is_said_of_each_of_sixty_sessions_is_the_same(seed: int, tmp_path: Path) -> None:
    check(seed, tmp_path)


@pytest.mark.check("runs rigs in virtual time")
@pytest.mark.parametrize(("seed", "codes"), [(15, (0, 0)), (6, (3, 1))])
def test_the_exit_codes_say_the_same(seed: int, codes: tuple[int, int], tmp_path: Path) -> None:
    path, _ = InterruptedSession.of(seed).record(tmp_path)
    parts = [Path(part.path) for part in split_recording(path, tmp_path / "parts", interval_s=0.7)]
    merged = tmp_path / "merged.mcap"
    assert run("bag", "merge", *parts, "--out", merged)[0] == 0
    for files in ([path], parts, [merged]):
        code, out, err = run("report", *files, "--out", tmp_path / "out")
        assert (code, "the recording is not whole" in err) == (codes[0], codes[0] == 3)
        assert run("bag", "verify", *files)[0] == codes[1]
    if codes[0] == 0:
        # a warning, and the last line says why
        assert "telenano: warning: not only the law acted in this session: the AFM sent nothing from" in err
        assert "guarded (the AFM sent nothing from" in out
