"""A session of nodes that run elsewhere."""

from pathlib import Path
from typing import Any

import pytest
from launcher_bench import SECOND_NS, TICK_NS, Rig, health, row

from telenano.launcher.external_recording import ExternalRecording, readable_here
from telenano.launcher.processes import NodeProcesses
from telenano.launcher.readiness import READY_DEADLINE_S
from telenano.timing.clock import SystemClock

RECORDER = "recorder@master"
OTHERS = ("controller@master", "afm_node@slave", "haptic_node@master")
FILES = ("/rec/session_1.mcap", "/rec/session_2.mcap")


class Attached(Rig):
    """Nodes that run elsewhere, with a recorder that begins a file when it is commanded to."""

    def __init__(self, **options: Any) -> None:
        self.files = list(FILES)
        self.split_ids: list[str] = []
        super().__init__(own=(), others=OTHERS, recorder=RECORDER, **options)

    @property
    def recording(self) -> ExternalRecording:
        assert self.session.recording is not None
        return self.session.recording

    def with_recorder(self) -> None:
        self.receive_health(RECORDER)

    def start(self) -> None:
        self.all_ready()
        self.with_recorder()
        self.tick(5)

    def after_tick(self) -> None:
        for control in self.bus.controls()[self.answered :]:
            if control.target != RECORDER or RECORDER in self.silent:
                continue
            if RECORDER not in self.refusing and control.id not in self.split_ids:
                self.receive_event(RECORDER, "recording", state="started", path=self.files.pop(0))
                self.split_ids.append(control.id)
            kind = "refused" if RECORDER in self.refusing else "ack"
            self.receive_event(RECORDER, kind, "what the recorder says", answer_to=control.id)
        super().after_tick()


def commands(rig: Rig) -> list[tuple[str, str]]:
    return [(control.command, control.target) for control in rig.bus.controls()]


def test_a_session_has_a_file_of_its_own_and_leaves_the_nodes() -> None:
    rig = Attached(duration_s=2.0)
    rig.receive_event(RECORDER, "recording", state="started", path="/rec/session.mcap")
    rig.start()
    assert rig.session.phase == "running"
    start = rig.bus.controls()[-1]
    assert rig.session.start_id == start.id
    rig.tick_alive(46)
    assert rig.finished
    assert commands(rig) == [
        ("set", RECORDER),
        ("arm", "haptic_node"),
        ("arm", "afm_node"),
        ("start", "*"),
        ("stop", "*"),
        ("set", RECORDER),
        # there is no operator any more: the tip is withdrawn once the file is complete, by no emergency stop
        ("stop", "afm_node"),
    ]
    assert {**rig.bus.controls()[0].parameters} == {"record.split": True}
    # the file that the second command began is not the session's
    assert rig.recording.files == [FILES[0]]
    assert rig.bus.events()[-1].text == "the session is over, the nodes keep running"
    assert rig.children.started == []


def test_a_session_that_fails_while_it_arms_leaves_no_tip_armed() -> None:
    rig = Attached(duration_s=2.0)
    rig.refusing = {"haptic_node@master"}
    rig.all_ready()
    rig.with_recorder()
    rig.tick_alive(150)
    assert rig.finished
    assert rig.session.failure.startswith("haptic_node@master refused arm")
    assert commands(rig)[-1] == ("stop", "afm_node")


def test_a_recorder_that_is_behind_completes_the_file_before_it_begins_the_next() -> None:
    rig = Attached(duration_s=2.0)
    rig.start()

    def tick_behind(count: int, age_s: float) -> None:
        for _ in range(count):
            rig.receive(
                health(RECORDER, inputs=(row("haptic/state", "haptic_node@master", age_s=age_s),)), "node/health"
            )
            rig.tick_alive()

    tick_behind(46, 3.0)
    # no tip stays on the sample for the sake of a recorder
    assert commands(rig)[-2:] == [("stop", "*"), ("stop", "afm_node")]
    tick_behind(40, 2.0)
    assert not rig.finished
    assert any("which is 2.0 s behind" in line for line in rig.reports)
    tick_behind(5, 0.1)
    assert rig.finished
    assert commands(rig)[-1] == ("set", RECORDER)
    assert rig.recording.files == [FILES[0]]


def test_it_waits_without_a_limit_and_says_for_what() -> None:
    rig = Attached()
    rig.receive_health(*OTHERS[:2])
    rig.with_recorder()
    rig.receive(health("afm_node@slave", inputs=(row("afm/command", received=False),)), "node/health")
    for _ in range(round(10 * READY_DEADLINE_S)):
        rig.tick_alive(20, missing=OTHERS)
        rig.receive_health("controller@master")
        rig.receive(health("afm_node@slave", inputs=(row("afm/command", received=False),)), "node/health")
    assert rig.session.phase == "starting"
    assert rig.session.causes() == {
        "afm_node@slave": "does not receive afm/command",
        "haptic_node@master": "has not reported yet",
    }
    assert rig.session.status_line() == "waiting for 2 of 3 nodes to be ready (without a limit, Ctrl-C gives up)"
    assert rig.bus.controls() == []


def test_a_limit_is_kept_and_names_who_was_missing() -> None:
    rig = Attached(wait_s=5.0)
    rig.receive_health(*OTHERS[:2])
    assert "up to 5 s" in rig.session.status_line()
    for _ in range(round(5 * SECOND_NS / TICK_NS) - 1):
        rig.receive_health(*OTHERS[:2])
        rig.tick()
    assert not rig.finished
    rig.tick(2)
    assert rig.finished
    assert rig.session.failure == "the rig was not ready within 5 s: haptic_node@master has not reported yet"


def test_without_a_recorder_the_session_runs_and_says_so() -> None:
    rig = Attached()
    rig.tick_alive(50)
    assert rig.session.phase == "starting"
    rig.tick_alive(20)
    assert rig.session.phase == "running"
    assert rig.reports == ["the session is not recorded: no recorder reported"]
    rig.tick_alive(51)
    assert rig.finished
    assert ("set", RECORDER) not in commands(rig)
    assert rig.recording.path == ""


@pytest.mark.parametrize(
    ("silent", "fault"),
    [
        (False, "recorder@master refused set: what the recorder says"),
        (True, "recorder@master did not answer set in time"),
    ],
)
def test_a_recorder_that_cannot_is_no_reason_not_to_run(silent: bool, fault: str) -> None:
    rig = Attached()
    rig.rig_nodes.append(RECORDER)
    (rig.silent if silent else rig.refusing).add(RECORDER)
    rig.tick_alive(130)
    assert rig.session.ran
    assert rig.reports == [f"the session is not recorded: {fault}"]


def test_a_file_that_follows_within_the_session_is_remembered() -> None:
    rig = Attached()
    rig.start()
    rig.receive_event(RECORDER, "recording", state="started", path="/rec/later.mcap")
    assert rig.recording.files == [FILES[0], "/rec/later.mcap"]
    assert rig.recording.path == FILES[0]


def test_a_silent_node_is_reported_and_does_not_end_the_session() -> None:
    rig = Attached(duration_s=30.0)
    rig.start()
    rig.tick_alive(70, missing=["afm_node@slave", "controller@master"])
    rig.tick_alive(20, missing=["afm_node@slave"])
    assert rig.session.phase == "running"
    assert set(rig.session.liveness.silent) == {RECORDER, "afm_node@slave"}
    assert "afm_node@slave" in rig.session.status_line()
    assert [event.data["state"] for event in rig.bus.events() if event.data.get("about_node") == "afm_node@slave"] == [
        "silent"
    ]
    rig.tick_alive(1)
    assert rig.reports[-1].startswith("afm_node@slave is alive again after 4.")
    assert rig.reports[-1].endswith("a tip that has retracted stays retracted until `telenano session arm`")
    assert "controller@master is alive again" in "\n".join(rig.reports)


def test_a_quick_restart_is_seen_by_the_uptime() -> None:
    rig = Attached(duration_s=30.0)
    rig.tick_alive(70)
    rig.receive_health("haptic_node@master", uptime_s=70.0)
    rig.receive_health("haptic_node@master", uptime_s=0.1)
    rig.tick()
    assert rig.reports[-1].startswith(
        "haptic_node@master was restarted; a haptic device that was restarted stays off until"
    )
    assert rig.bus.events()[-1].level == "warning"


def test_a_node_lost_while_the_devices_are_armed_is_waited_for_again() -> None:
    rig = Attached()
    rig.silent = {"haptic_node@master"}
    rig.start()
    assert rig.session.phase == "arming"
    rig.tick_alive(60, missing=["haptic_node@master"])
    assert rig.session.phase == "starting"
    assert rig.session.failure == ""
    rig.silent = set()
    rig.with_recorder()
    rig.tick_alive(6)
    assert rig.session.phase == "running"


@pytest.mark.parametrize(
    ("ready", "last"), [(False, []), (True, [("stop", "*"), ("set", RECORDER), ("stop", "afm_node")])]
)
def test_an_interruption_ends_the_session_and_completes_its_file(ready: bool, last: list[tuple[str, str]]) -> None:
    rig = Attached()
    if ready:
        rig.all_ready()
        rig.with_recorder()
    rig.tick(6)
    rig.session.interrupt()
    rig.tick(5)
    assert rig.finished
    assert commands(rig)[-3:] == last
    assert rig.session.ran is ready


def test_a_launcher_without_children_stops_nobody(tmp_path: Path) -> None:
    stopping: list[str] = []
    children = NodeProcesses({}, ["afm_node@slave"], tmp_path / "logs", SystemClock().epoch_offset_ns, stopping.append)
    assert children.reap() == {}
    children.stop()
    assert stopping == []


def test_another_file_of_the_same_name_is_not_taken_for_the_recording(tmp_path: Path) -> None:
    path = tmp_path / "session_1.mcap"
    assert not readable_here(str(path), "an-id")
    path.write_bytes(b"something else")
    assert not readable_here(str(path), "an-id")
