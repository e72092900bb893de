"""What a running rig makes of frames that are no messages, of a second rig, and of wrong files."""

from typing import Any

import msgpack
import zmq

from services.recorder.reader import Recording

CONSOLE = "console@master"
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

# those of the master's site hear the console directly
READERS = ("haptic_node@master", "controller@master", "delay_node@master")


def test_hostile_frames_are_counted_and_nobody_dies(rig: Any) -> None:
    rig.start("--duration", "600")
    rig.wait_until(rig.running, "a running session")
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
            # said with the next health report, which has to be in the recording
            rig.wait_until(lambda node=node: rig.log_has(node, "refused: "), f"{node} to refuse", patience_s=30.0)
        code, _, err = rig.stop()
    finally:
        socket.close(linger=0)
        context.term()
    assert code == 0, err
    rejected: dict[str, dict[str, int]] = {}
    for message in Recording(rig.out / "session.mcap").messages(["node/health"]):
        rejected[message.src] = message.fields()["rejected"]
    for node in READERS:
        assert set(rejected[node]) == set(HOSTILE), rejected
    refused = list(Recording(rig.out / "session.mcap").messages(["recorder/rejected"]))
    # the recorder looks at headers only: one with a good header and a wrong field it keeps as it came
    assert len(refused) >= 20 * (len(HOSTILE) - 1)
    restarts = [line for line in (rig.out / "logs" / "launcher@master.log").read_text().splitlines() if "again" in line]
    assert restarts == []


def test_second_rig_on_the_same_sockets_is_told_who_has_them(rig: Any, tmp_path: Any) -> None:
    rig.start("--duration", "600")
    rig.wait_until(rig.running, "a running session")
    second = rig.tell("up", "--scenario", "fig12", "--out", str(tmp_path / "second"), "--json")
    assert second.returncode != 0
    assert "in use by process" in second.stderr
    assert second.stdout == "" or '"error"' in second.stdout
    code, summary, err = rig.stop()
    assert code == 0, err
    assert summary["seq_gaps"]["session/event"] == 0


def test_run_time_change_is_acknowledged_and_recorded(rig: Any) -> None:
    rig.start("--duration", "600")
    rig.wait_until(rig.running, "a running session")
    good = rig.tell("session", "set", "virtual_impedance.force_gain=10.0", "--target", "controller")
    assert good.returncode == 0, good.stderr + good.stdout
    bad = rig.tell("session", "set", "virtual_impedance.force_gain=-1.0", "--target", "controller")
    assert bad.returncode == 1
    assert "force_gain" in bad.stdout + bad.stderr
    link = rig.tell("session", "set", "forward.delay_s=0.005", "--target", "delay_node")
    assert link.returncode == 0, link.stderr
    code, _, err = rig.stop()
    assert code == 0, err
    events = [m.decode() for m in Recording(rig.out / "session.mcap").messages(["session/event"])]
    answers = {(event.src, event.kind) for event in events if event.id}
    assert {("controller@master", "ack"), ("controller@slave", "ack"), ("controller@master", "refused")} <= answers
    assert ("delay_node@master", "ack") in answers


def test_topic_commands_look_at_a_running_rig(rig: Any) -> None:
    rig.start("--duration", "600")
    rig.wait_until(rig.running, "a running session")
    listed = rig.tell("topic", "list", "--json")
    assert listed.returncode == 0, listed.stderr
    assert "haptic/state" in listed.stdout
    echoed = rig.tell("topic", "echo", "afm/state", "--count", "3")
    assert echoed.stdout.count("tip_force_n") == 3
    rate = rig.tell("topic", "hz", "haptic/state", "--duration", "1", "--json")
    assert rate.returncode == 0, rate.stderr
    delay = rig.tell("topic", "delay", "teleop/forward@slave", "--duration", "1", "--json")
    assert delay.returncode == 0, delay.stderr
    code, _, err = rig.stop()
    assert code == 0, err
