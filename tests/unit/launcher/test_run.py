import os
import signal
from pathlib import Path
from typing import Any

import pytest
from launcher_bench import Bench

from telenano.launcher import run as up
from telenano.launcher.external_recording import holds_command
from telenano.launcher.plan import Plan, UpRequest, make_plan
from telenano.launcher.run import Outcome, make_rig, outcome_of, report_of, run_rig
from telenano.launcher.session import SessionNode
from telenano.launcher.site_node import SiteNode
from telenano.launcher.supervisor import Supervisor
from telenano.recording.recorder_config import RecorderConfig
from telenano.recording.writer import RecordingWriter
from telenano.wire import encode
from telenano.wire.errors import RecordingError, RigError
from telenano.wire.messages import SessionControl

RECORDER = "recorder@master"


@pytest.fixture(autouse=True)
def _private_runtime(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TELENANO_RUNTIME_DIR", str(tmp_path / "run"))


def plan_of(tmp_path: Path, **options: Any) -> Plan:
    request = UpRequest(scenario="fig12", out=tmp_path / "out", **options)
    return make_plan(request, tmp_path)


def attached(tmp_path: Path) -> tuple[Plan, SessionNode]:
    plan, bench = plan_of(tmp_path, attach=True), Bench()
    session = make_rig(plan, bench.context, Supervisor(bench.clock, (), bench.children))
    assert isinstance(session, SessionNode)
    session._running_ns = 0
    session.start_id = "the-start"
    return plan, session


def recorded(folder: Path, command_id: str) -> Path:
    """Write a recording in which a command was given."""
    writer = RecordingWriter.create(RECORDER, RecorderConfig(directory=folder), 0)
    channel = writer.channel("session/control", "launcher@master", "master")
    control = SessionControl(
        seq=0, t_ns=5, src="launcher@master", v=1, id=command_id, command="start", target="*", parameters={}
    )
    writer.write(channel, 5, 5, 0, encode(control))
    writer.finish()
    return writer.path


def test_the_plan_says_which_rig_is_made(tmp_path: Path) -> None:
    bench = Bench()
    made = {
        name: make_rig(plan_of(tmp_path, **options), bench.context, Supervisor(bench.clock, (), bench.children))
        for name, options in {
            "plain": {},
            "attach": {"attach": True, "wait_s": 3.0},
            "master": {"site": "master"},
            "slave": {"site": "slave"},
        }.items()
    }
    assert isinstance(made["slave"], SiteNode)
    sessions = {name: rig for name, rig in made.items() if isinstance(rig, SessionNode)}
    assert set(sessions) == {"plain", "attach", "master"}
    assert {name for name, session in sessions.items() if session.recording is not None} == {"attach"}
    assert {name: session.liveness.site for name, session in sessions.items()} == {
        "plain": "",
        "attach": "",
        "master": "slave",
    }


def test_the_file_that_the_recorder_named_is_found_if_it_is_the_sessions(tmp_path: Path) -> None:
    plan, session = attached(tmp_path)
    assert session.recording is not None
    path = recorded(tmp_path / "rec", "the-start")
    session.recording.files = [str(path)]
    assert holds_command(path, "the-start")
    outcome = outcome_of(session, plan)
    assert (outcome.ran, outcome.recordings, outcome.note) == (True, (path,), "")
    session.start_id = "another"
    outcome = outcome_of(session, plan)
    assert outcome.recordings == ()
    assert f"`telenano report {path} --out {plan.out}`" in outcome.note


def test_a_recording_elsewhere_is_reported_with_the_command_that_reports_it(tmp_path: Path) -> None:
    plan, session = attached(tmp_path)
    assert session.recording is not None
    session.recording.files = ["/elsewhere/session_1.mcap"]
    outcome = outcome_of(session, plan)
    assert outcome.recordings == ()
    assert "recorder@master recorded the session to /elsewhere/session_1.mcap" in outcome.note
    session.recording.files = []
    assert outcome_of(session, plan).note == "nothing was recorded: no recorder reported"


def test_all_parts_of_a_recording_are_found_in_their_order(tmp_path: Path) -> None:
    bench, plan = Bench(), plan_of(tmp_path)
    plan.out.mkdir()
    for number in (0, 1, 2, 10):
        RecordingWriter.create(RECORDER, RecorderConfig(directory=plan.out), number).finish()
    # one that the recorder could not begin on a full disk, and one of somebody else
    (plan.out / "session_11.mcap").touch()
    (plan.out / "sessions.mcap").touch()
    rig = make_rig(plan, bench.context, Supervisor(bench.clock, (), bench.children))
    rig.recording_faults[RECORDER] = "recording stopped, the rig continues: the disk is full"
    outcome = outcome_of(rig, plan)
    names = ["session.mcap", "session_1.mcap", "session_2.mcap", "session_10.mcap"]
    assert [path.name for path in outcome.recordings] == names
    assert outcome.missing == (
        f"{RECORDER}: recording stopped, the rig continues: the disk is full",
        f"{plan.out / 'session_11.mcap'}: is empty",
    )


def test_a_report_is_made_of_a_session_that_ran(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    plan = plan_of(tmp_path)
    path = tmp_path / "session.mcap"
    reported: list[str] = []
    ran = Outcome("", False, True, (path,), "", {})

    def made(
        recordings: Any, out: Path, missing: Any, options: Any, show: Any, *, same_session: bool
    ) -> dict[str, Any]:
        show("1 of 4: reading the session")
        return {"recording": str(recordings[0]), "out": str(out)}

    monkeypatch.setattr("telenano.analysis.report.write_report", made)
    assert report_of(ran, plan, reported.append) == {"recording": str(path), "out": str(plan.out)}
    assert reported == ["making figure and summary"]
    # of a long one it is said what is done, and how to have the terminal back
    path.write_bytes(b"-")
    monkeypatch.setattr(up, "_LONG_BYTES", 0)
    reported.clear()
    report_of(ran, plan, reported.append)
    assert reported[1:] == [
        f"that takes some time; Ctrl-C leaves it to `telenano report {path} --out {plan.out}`",
        "1 of 4: reading the session",
    ]
    # so it is after Ctrl-C, however long the session was: who pressed it waits for the terminal
    monkeypatch.setattr(up, "_LONG_BYTES", 1_000_000)
    reported.clear()
    report_of(Outcome("", True, True, (path,), "", {}), plan, reported.append)
    assert reported[1:] == [
        f"that takes some time; another Ctrl-C leaves it to `telenano report {path} --out {plan.out}`",
        "1 of 4: reading the session",
    ]
    assert report_of(Outcome("", True, False, (path,), "", {}), plan, reported.append) is None
    assert report_of(Outcome("", False, True, (), "elsewhere", {}), plan, reported.append) is None

    def broken(*given: Any, **named: Any) -> Any:
        raise RecordingError("no session in it")

    monkeypatch.setattr("telenano.analysis.report.write_report", broken)
    assert report_of(Outcome("the cause", False, True, (path,), "", {}), plan, reported.append) is None
    with pytest.raises(RecordingError, match="no session in it"):
        report_of(ran, plan, reported.append)

    def interrupted(*given: Any, **named: Any) -> Any:
        raise KeyboardInterrupt

    monkeypatch.setattr("telenano.analysis.report.write_report", interrupted)
    with pytest.raises(RigError, match=r"`telenano report .* makes it"):
        report_of(ran, plan, reported.append)
    # before the report is begun, as by one signal of many, it is said as well
    for outcome, error in ((ran, RigError), (Outcome("", True, False, (), "", {}), KeyboardInterrupt)):
        with pytest.raises(error), outcome.report_later(plan):
            raise KeyboardInterrupt


def test_attaching_to_no_nodes_gives_up_at_its_limit_and_leaves_a_log(tmp_path: Path) -> None:
    plan = plan_of(tmp_path, attach=True, wait_s=0.2)
    phases: list[str] = []
    outcome = run_rig(plan, lambda rig: phases.append(rig.phase), phases.append)
    assert outcome.failure.startswith("the rig was not ready within 0.2 s: ")
    assert "haptic_node@master has not reported yet" in outcome.failure
    assert not outcome.ran
    assert phases[0] == "starting"
    assert "has not reported yet" not in phases
    assert (plan.out / "logs" / "launcher@master.log").exists()


def test_a_stop_signal_ends_the_wait(tmp_path: Path) -> None:
    plan = plan_of(tmp_path, attach=True)
    outcome = run_rig(plan, lambda rig: os.kill(os.getpid(), signal.SIGTERM), lambda text: None)
    assert (outcome.failure, outcome.interrupted, outcome.ran) == ("", True, False)
