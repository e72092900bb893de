"""One running rig, and all that a person or a stranger may do beside it, one after the other."""

import json
import os
import re
import signal
import subprocess
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, closing, contextmanager
from pathlib import Path
from typing import Any

import msgpack
import pytest
import zmq
from killed import check_killed, kill_recorders
from ledger import record
from stack_rig import (
    BOTH_WAYS,
    FIGURE_S,
    Rig,
    apart,
    assert_drawn_as_in_the_paper,
    decoded,
    first_of_the_session,
    judged,
    pulled_as_in_the_paper,
    wait_for_the_recorder,
)

from services.viz_node.commander import RigCommander
from services.viz_node.hub import Hub
from services.viz_node.live import LiveSource
from services.viz_node.requests import PROTOCOL
from telenano.console.send_commands import send_control
from telenano.recording.reader import Recording
from telenano.rerun.rerun import rerun
from telenano.runtime.bus.address_book import AddressBook
from telenano.runtime.bus.publisher import ZmqPublisher
from telenano.runtime.loop.commands import Command
from telenano.serving.access import Access
from telenano.settings import DEFAULT_SITE_FILE
from telenano.timing.clock import SystemClock
from telenano.wire.errors import RigError

CONSOLE = "console@master"
OPERATOR, OBSERVER = "operator-token-0123", "observer-token-0123"
HAND, TIP = "haptic_node@master", "afm_node@slave"
GOOD = {
    "seq": 0,
    "t_ns": 1,
    "src": CONSOLE,
    "v": 1,
    "id": "x",
    "command": "mark",
    "target": "nobody",
    "parameters": {},
}
HOSTILE = {
    "malformed": [b"session/control", b"\xc1\xff"],
    "oversized": [b"session/control", bytes(1_100_000)],
    "newer_version": [b"session/control", msgpack.packb({**GOOD, "v": 99})],
    "schema": [b"session/control", msgpack.packb({**GOOD, "commnd": "stop"})],
    "frames": [b"session/control", b"", b""],
}

# those of the master's site receive from the console directly
READERS = ("haptic_node@master", "controller@master", "delay_node@master")


@pytest.fixture
def rig(shared_rig: Rig) -> Rig:
    return shared_rig


@pytest.fixture(scope="module")
def figure(shared_rig: Rig) -> Path:
    """Give the recording of the programme of Fig. 12, cut from that of the rig while this is being written."""
    whole, cut = shared_rig.out / "session.mcap", shared_rig.folder / "figure.mcap"
    states = shared_rig.recording().messages("haptic/state")
    last = next(message for message in states if message.fields()["session_s"] >= FIGURE_S)
    end_s = (last.log_ns - Recording(whole).span_ns[0]) * 1e-9
    done = shared_rig.telenano("bag", "filter", str(whole), "--end", f"{end_s:.3f}", "--out", str(cut))
    assert done.returncode == 0, done.stderr
    return cut


def test_the_session_begins_with_the_tip_at_the_papers_distance(figure: Path) -> None:
    tip, start = first_of_the_session([figure])
    assert (tip.placed, tip.mode, start.armed) == (True, "follow", True)
    assert tip.separation_m == pytest.approx(10e-9, rel=0.0, abs=0.1e-9)


def test_hold_contact_and_release_are_the_papers(rig: Rig, figure: Path, tmp_path: Path) -> None:
    done = rig.telenano("report", str(figure), "--out", str(tmp_path / "report"), "--json")
    # 3: the push that follows in the programme is not in the cut
    assert done.returncode == 3, done.stderr
    summary = json.loads(done.stdout)
    assert summary["greatest_pull_nn"] == pulled_as_in_the_paper(figure)
    if not judged(summary, "Fig. 12 of the shared rig"):
        return
    assert summary["hold_ratio"] == pytest.approx(1.050, abs=0.005)
    assert summary["contact_x_cm"] == pytest.approx(0.703, abs=0.010)
    assert abs(summary["release_force_nn"]) < 0.02
    holds = [hold["verdict"] for hold in summary["holds"] if hold["end_s"] <= FIGURE_S]
    assert len(holds) >= 2
    assert set(holds) <= {"stable"}
    assert_drawn_as_in_the_paper(figure, FIGURE_S)


@pytest.mark.parametrize("node", ["controller@slave", "delay_node@master"])
def test_a_node_is_rerun_bit_by_bit_from_the_recording_of_the_rig(figure: Path, node: str) -> None:
    result = rerun(Recording(figure), node)
    # the cut leaves the last messages of a node without what they answer
    assert result.difference == ""
    assert max(result.compared.values()) > 1000


def test_a_replay_does_not_take_the_place_of_a_node_that_runs(rig: Rig, figure: Path) -> None:
    begin_ns = time.time_ns()
    played = rig.telenano("replay", str(figure), "--nodes", "controller@slave")
    assert played.returncode == 1
    assert f"/controller@slave is in use by process {rig.process_of('controller@slave')}: stop it" in played.stderr
    wait_for_the_recorder(rig)
    # nothing of it came to a device, which went on following
    assert not any(rig.log_has(node, "come from a recording") for node in (TIP, HAND))
    assert {state.mode for state in decoded(rig, "afm/state", begin_ns)} == {"follow"}


def test_topic_commands_look_at_a_running_rig(rig: Any) -> None:
    listed = rig.telenano("topic", "list", "--json")
    assert listed.returncode == 0, listed.stderr
    assert "haptic/state" in listed.stdout
    echoed = rig.telenano("topic", "echo", "afm/state", "--count", "3")
    assert echoed.stdout.count("tip_force_n") == 3
    for topic in ("haptic/state", "teleop/forward@slave"):
        measured = rig.telenano("topic", "hz", topic, "--duration", "1", "--json")
        assert measured.returncode == 0, measured.stderr
        (source,) = json.loads(measured.stdout)["sources"]
        assert source["age_p50_ms"] <= source["age_p99_ms"] <= source["age_max_ms"]
        assert 0 < source["mean_bytes"] <= source["most_bytes"]
        assert source["bytes_per_s"] == pytest.approx(source["rate_hz"] * source["mean_bytes"], rel=0.05)


def test_second_rig_of_the_same_name_names_who_has_it(rig: Any, tmp_path: Any) -> None:
    second = rig.telenano("up", "--rig", "main", "--scenario", "fig12", "--out", str(tmp_path / "second"), "--json")
    assert second.returncode != 0
    assert "in use by process" in second.stderr
    assert second.stdout == "" or '"error"' in second.stdout
    wait_for_the_recorder(rig)
    numbers = [message.seq for message in rig.recording().messages("session/event") if message.src == "launcher@master"]
    assert numbers == list(range(numbers[0], numbers[0] + len(numbers)))


def test_run_time_change_is_acknowledged_and_recorded(rig: Any) -> None:
    begin_ns = time.time_ns()
    good = rig.telenano("session", "set", "virtual_impedance.force_gain=10.0", "--target", "controller")
    assert good.returncode == 0, good.stderr + good.stdout
    bad = rig.telenano("session", "set", "virtual_impedance.force_gain=-1.0", "--target", "controller")
    assert bad.returncode == 1
    assert "force_gain" in bad.stdout + bad.stderr
    link = rig.telenano("session", "set", "forward.delay_s=0.005", "--target", "delay_node")
    assert link.returncode == 0, link.stderr
    expected = {
        ("controller@master", "ack"),
        ("controller@slave", "ack"),
        ("controller@master", "refused"),
        ("delay_node@master", "ack"),
    }
    rig.wait_until(
        lambda: expected <= {(event.src, event.kind) for event in decoded(rig, "session/event", begin_ns) if event.id},
        "the answers in the recording",
    )


def test_link_is_shown_changed_refused_and_cleared(rig: Any) -> None:
    begin_ns = time.time_ns()
    assert rig.telenano("link", "set", "forward.delay_s=0.004", "backward.loss.probability=0.1").returncode == 0
    refused = rig.telenano("link", "set", "forward.delay_s=-1.0")
    assert refused.returncode == 1
    assert "forward.delay_s" in refused.stdout
    shown = json.loads(rig.telenano("link", "show", "--json").stdout)
    assert shown["forward"]["settings"]["delay_s"] == 0.004
    assert shown["clock"]["valid"]
    # one machine, one clock: the offset is nought within its own uncertainty
    assert abs(shown["clock"]["offset_s"]) <= shown["clock"]["uncertainty_s"]
    assert rig.telenano("link", "profile", "lan").returncode == 0
    assert rig.telenano("link", "clear").returncode == 0
    wait_for_the_recorder(rig, "teleop/backward", "teleop/backward@master", "link/fates")
    lost = [fate for message in decoded(rig, "link/fates", begin_ns) for fate in message.fates if fate.dropped]
    assert {fate.dropped for fate in lost} == {"loss"}
    # what the ground truth calls lost is what did not come out at the other site
    sent, came = numbers(rig, "teleop/backward", begin_ns), numbers(rig, "teleop/backward@master", begin_ns)
    reported_lost = {fate.seq for fate in lost if fate.topic == "teleop/backward"}
    first, last = min(came), max(came)
    inside = {seq for seq in sent if first < seq < last}
    assert inside - came == reported_lost & inside


def numbers(rig: Rig, channel: str, since_ns: int) -> set[int]:
    return {message.seq for message in rig.recording().messages(channel, since_ns)}


def test_hostile_frames_are_counted_and_nobody_dies(rig: Any) -> None:
    begin_ns = time.time_ns()
    context = zmq.Context()
    socket = context.socket(zmq.XPUB)
    socket.set(zmq.XPUB_VERBOSE, 1)
    try:
        socket.bind(f"ipc://{rig.sockets}/{CONSOLE}")
        # nodes look for the console every 50 ms: when no more of them come, all of this site are there
        subscribed = 0
        while socket.poll(20_000 if subscribed < 4 else 2_000):
            subscribed += socket.recv() in (b"\x01session/control", b"\x01")
        assert subscribed >= 4
        for frames in HOSTILE.values():
            for _ in range(20):
                socket.send_multipart(frames)
        for node in READERS:
            rig.wait_until(
                lambda node=node: rejected(rig, node) == set(HOSTILE), f"{node} to have refused each kind", 30.0
            )
        # the recorder looks at headers only: one with a good header and a wrong field it keeps as it came
        rig.wait_until(
            lambda: len(rig.recording().messages("recorder/rejected", begin_ns)) >= 20 * (len(HOSTILE) - 1),
            "what the recorder refused",
        )
    finally:
        socket.close(linger=0)
        context.term()


def rejected(rig: Rig, node: str) -> set[str]:
    """Give the reasons for which a node reports that it refused frames."""
    health = [message for message in rig.recording().messages("node/health") if message.src == node]
    # what a busy machine left waiting is no frame of ours
    return set(health[-1].fields()["rejected"]) - {"superseded", "stale"} if health else set()


@BOTH_WAYS
def test_an_emergency_stop_needs_no_turn_and_is_recorded(rig: Any) -> None:
    begin_ns = time.time_ns()
    with zmq.Context() as context:
        # a console at work, which has the endpoint and its lock
        console = ZmqPublisher(context, SystemClock(), CONSOLE, f"ipc://{rig.sockets}/{CONSOLE}")
        try:
            # an interpreter of its own: its start is most of the time
            stopped = subprocess.run(
                rig.command("estop"), env=rig.environment, capture_output=True, text=True, check=False, timeout=60
            )
        finally:
            console.close()
    assert stopped.returncode == 0, stopped.stderr
    assert sorted(line.partition(":")[0] for line in stopped.stdout.splitlines()) == [f"{TIP} ack", f"{HAND} ack"]
    rig.wait_until(lambda: rig.newest("afm/state").mode == "estop", "the AFM in emergency stop")
    rig.wait_until(lambda: rig.newest("haptic/state").estop, "the hand in emergency stop")
    stopped_ns = next(state.t_ns for state in decoded(rig, "afm/state", begin_ns) if state.mode == "estop")
    took = f"the tip {(stopped_ns - begin_ns) / 1e6:.0f} ms after the command"
    record(f"an emergency stop while a console is at work{rig.way}", f"both stopped, {took}")
    rig.wait_until(
        lambda: (
            {message.src for message in rig.recording().messages("session/control", begin_ns)}
            == {"estop@master", "estop@slave"}
        ),
        "the stops of both sites in the recording",
    )


@BOTH_WAYS
def test_an_arm_that_waited_in_a_stopped_process_is_refused(rig: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    assert rig.newest("afm/state").mode == "estop", "left by the test before"
    monkeypatch.setenv("TELENANO_RUNTIME_DIR", str(rig.sockets))
    begin_ns = time.time_ns()
    pid = rig.process_of(TIP)
    os.kill(pid, signal.SIGSTOP)
    try:
        with pytest.raises(RigError, match=f"^{TIP} did not answer arm in time; arm was sent and may be in force"):
            send_control(Command("arm", "afm_node", deadline_ns=10**9), DEFAULT_SITE_FILE, "master", lambda event: None)
        time.sleep(1.05)
    finally:
        os.kill(pid, signal.SIGCONT)
    rig.wait_until(lambda: answers_of(rig, TIP, begin_ns) != [], "the answer to arm")
    kind, text = answers_of(rig, TIP, begin_ns)[0]
    assert kind == "refused"
    assert re.fullmatch(
        r"arm is refused: it does not refer to the newest emergency stop, which came \d+\.\d s ago", text
    )
    time.sleep(0.1)
    wait_for_the_recorder(rig)
    states = decoded(rig, "afm/state", begin_ns)
    assert {state.mode for state in states} == {"estop"}
    base_m = [state.base_position_m[2] for state in states]
    approach_nm = 1e9 * (max(base_m) - base_m[0])
    record(f"an arm that waited in a stopped AFM{rig.way}", f"{text}; the tip approached by {approach_nm:.1f} nm")
    # who is still there is obeyed
    for device in ("haptic_node", "afm_node"):
        armed = rig.telenano("session", "arm", "--target", device)
        assert armed.returncode == 0, armed.stdout + armed.stderr


@contextmanager
def served_page() -> Iterator[Callable[[str], Any]]:
    """Serve the page of the rig; yields what opens the web socket of one with a token, and says hello there."""
    pytest.importorskip("httpx2")
    from starlette.testclient import TestClient

    from services.viz_node.server import make_app

    access = Access(OPERATOR, OBSERVER, hosts=("testserver",))
    with ExitStack() as stack:
        source = stack.enter_context(closing(LiveSource(AddressBook.load(DEFAULT_SITE_FILE), "local")))
        commander = RigCommander(DEFAULT_SITE_FILE)
        app = make_app(Hub(source, commander), access, None)
        server = stack.enter_context(TestClient(app, client=("127.0.0.1", 5)))

        @contextmanager
        def page_of(token: str) -> Iterator[Any]:
            with server.websocket_connect("/bus", headers={"origin": "http://testserver"}) as page:
                page.send_bytes(msgpack.packb({"k": "hello", "token": token, "protocol": PROTOCOL}))
                yield page

        yield page_of


def answer_to(page: Any, identifier: str) -> dict[str, Any]:
    while True:
        frame = msgpack.unpackb(page.receive_bytes())
        if frame["k"] == "answer" and frame["id"] == identifier:
            return dict(frame)


@apart("the AFM answers the stop while the half beside it is stopped")
@pytest.mark.parametrize(
    "leaves",
    [pytest.param(False, marks=pytest.mark.endurance, id="the page stays"), pytest.param(True, id="the page leaves")],
)
def test_an_arm_that_waited_in_the_page_s_server_is_given_up_with_the_emergency_stop(
    rig: Any, monkeypatch: pytest.MonkeyPatch, leaves: bool
) -> None:
    monkeypatch.setenv("TELENANO_RUNTIME_DIR", str(rig.sockets))
    rig.wait_until(lambda: rig.newest("afm/state").mode != "estop", "an instrument that was armed before")
    pid = rig.process_of("controller@slave")
    with served_page() as page_of, ExitStack() as stack:
        page = stack.enter_context(page_of(OPERATOR))
        os.kill(pid, signal.SIGSTOP)
        try:
            setting = {"k": "command", "command": "set", "target": "controller", "parameters": {"law": "wave"}}
            for i in range(3):
                page.send_bytes(msgpack.packb({"id": f"set-{i}", **setting}))
            arm = {"k": "command", "command": "arm", "target": "afm_node", "parameters": {}}
            page.send_bytes(msgpack.packb({"id": "arm", **arm}))
            time.sleep(0.5)
            page.send_bytes(msgpack.packb({"id": "stop", "k": "estop"}))
            assert answer_to(page, "stop")["ok"] is True
            if leaves:
                stack.close()
            stopped_ns = time.time_ns()
            # as long as the commands before it may take, one after the other
            time.sleep(2.0)
        finally:
            os.kill(pid, signal.SIGCONT)
        rig.wait_until(lambda: rig.newest("afm/state").t_ns > stopped_ns + 5 * 10**9, "what came of it")
        assert {state.mode for state in decoded(rig, "afm/state", stopped_ns)} == {"estop"}
        assert {state.estop for state in decoded(rig, "haptic/state", stopped_ns)} == {True}
    record("an arm that waits in the page's server when an emergency stop comes", "given up; both stayed latched")
    for device in ("afm_node", "haptic_node"):
        armed = rig.telenano("session", "arm", "--target", device)
        assert armed.returncode == 0, armed.stdout + armed.stderr


@BOTH_WAYS
def test_the_emergency_stop_of_a_page_stops_the_devices(rig: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    # the test before has armed both; the recording comes behind
    rig.wait_until(lambda: rig.newest("afm/state").mode != "estop", "an instrument that was armed before")
    rig.wait_until(lambda: not rig.newest("haptic/state").estop, "a haptic device that was armed before")
    monkeypatch.setenv("TELENANO_RUNTIME_DIR", str(rig.sockets))
    with served_page() as page_of:

        def ask(token: str, **request: Any) -> dict[str, Any]:
            """Ask as the page does, over a web socket of its own."""
            with page_of(token) as page:
                page.send_bytes(msgpack.packb({"id": "a", **request}))
                return answer_to(page, "a")

        assert ask(OBSERVER, k="command", command="set", target="controller", parameters={})["ok"] is False
        begin_ns = time.time_ns()
        # anybody who sees the tip may stop it
        answer = ask(OBSERVER, k="estop")
        assert (answer["ok"], TIP in answer["text"], HAND in answer["text"]) == (True, True, True), answer["text"]
        rig.wait_until(lambda: rig.newest("afm/state").mode == "estop", "the AFM in emergency stop")
        rig.wait_until(lambda: rig.newest("haptic/state").estop, "the hand in emergency stop")
        stopped_ns = next(state.t_ns for state in decoded(rig, "afm/state", begin_ns) if state.mode == "estop")
        took = f"the tip {(stopped_ns - begin_ns) / 1e6:.0f} ms after the request of the page"
        record(f"an emergency stop from the page of the view{rig.way}", f"both stopped, {took}")
        # the AFM first: the hand must not move a reference that nothing follows
        for device in ("afm_node", "haptic_node"):
            armed = ask(OPERATOR, k="command", command="arm", target=device, parameters={})
            assert armed["ok"], armed["text"]
        rig.wait_until(lambda: not rig.newest("haptic/state").estop, "an armed haptic device")
        rig.wait_until(lambda: rig.newest("afm/state").mode != "estop", "an armed instrument")


def answers_of(rig: Rig, node: str, since_ns: int) -> list[tuple[str, str]]:
    """Give what a node answered to commands: kind and text."""
    events = [event for event in decoded(rig, "session/event", since_ns) if event.src == node and event.id]
    return [(event.kind, event.text) for event in events]


def test_killed_recorders_leave_files_that_lack_no_more_than_a_flush(rig: Any) -> None:
    check_killed(rig, kill_recorders(rig, 2))


@BOTH_WAYS
@pytest.mark.ends_shared_rig
def test_after_all_of_it_the_rig_ends_in_order_without_a_kept_stop_and_nobody_was_started_again(rig: Rig) -> None:
    rig.telenano("estop")
    assert {path.name for path in rig.sockets.glob("*.kept")} == {f"{node}.estop.kept" for node in (TIP, HAND)}
    code, summary, err = rig.stop()
    assert code == 0, err
    assert list(rig.sockets.glob("*.kept")) == []
    assert summary["seq_gaps"]["session/event"] == 0
    assert {"session.mcap", "fig12.png", "summary.json"} <= {path.name for path in rig.out.iterdir()}
    assert json.loads((rig.out / "summary.json").read_text()) == summary
    log = (rig.out / "logs" / "launcher@master.log").read_text()
    assert [line for line in log.splitlines() if "started again" in line] == []
    assert Recording(rig.out / "session.mcap").closed
