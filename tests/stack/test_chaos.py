"""kill -9 of each node in turn: the devices make themselves safe, the rig comes back, the recording shows it."""

import json
import time
from datetime import datetime, timedelta
from pathlib import Path
from typing import Any

import pytest
from ledger import record
from recovered import RESTARTED, SOON_NS, STATE_OF, Kill, coupled, recover
from stack_rig import BOTH_WAYS, CONSTANT_PUSH, Rig

from telenano.recording.reader import Recording

LATER_NS = 4_000_000_000
KILLS = {
    "node": (
        "controller@master",
        "controller@slave",
        "delay_node@master",
        "afm_node@slave",
        "haptic_node@master",
        "recorder@master",
    ),
    # one of each process
    "site": ("controller@slave", "haptic_node@master"),
}
# The recorder is killed in this way.
OF_NODES = pytest.mark.parametrize("processes", ["node"], indirect=True, scope="module")


@pytest.fixture(scope="module")
def wreck(tmp_path_factory: pytest.TempPathFactory, processes: str) -> Any:
    rig = Rig(tmp_path_factory.mktemp("chaos"), processes)
    kills = []
    try:
        rig.start("--duration", "600", "--set", CONSTANT_PUSH)
        rig.wait_until(rig.running, "a running session")
        for node in KILLS[processes]:
            rig.wait_until(lambda: coupled(rig), f"hand and tip to be coupled before {node} is killed")
            rig.kill(node)
            kills.append(Kill(node, time.time_ns()))
            recover(rig, kills[-1])
        files = ["session.mcap", *(["session_1.mcap"] if "recorder@master" in KILLS[processes] else [])]
        rig.wait_until(
            lambda: (rig.out / files[-1]).exists() and len(rig.recording().messages("haptic/state")) > 1000,
            "a second of what the newest recorder recorded",
        )
        kill_again_and_again(rig, "delay_node@master")
        code, _, err = rig.finish()
        yield rig, kills, code, err
    finally:
        rig.close()


def kill_again_and_again(rig: Rig, node: str) -> None:
    """Kill a node each time that it has come back, until the rig has ended."""
    killed: set[int] = set()
    end = time.monotonic() + 60.0
    while rig.process is not None and rig.process.poll() is None and time.monotonic() < end:
        process_id = rig.process_of(node)
        if process_id is not None and process_id not in killed:
            killed.add(rig.kill(node))
        time.sleep(0.05)


def states(path: Path, topic: str, first_ns: int, last_ns: int) -> list[Any]:
    return [m.decode() for m in Recording(path).messages([topic]) if first_ns <= m.publish_ns <= last_ns]


def kill_of(wreck: Any, node: str) -> Kill:
    rig, kills = wreck[:2]
    return next(kill for kill in kills if node in rig.mates_of(kill.node))


@BOTH_WAYS
def test_recording_has_every_death_and_restart(wreck: Any) -> None:
    rig, kills = wreck[:2]
    path = rig.out / "session.mcap"
    texts = [m.decode().text for m in Recording(path).messages(["session/event"]) if m.src == "launcher@master"]
    for node in (mate for kill in kills if kill.node != "recorder@master" for mate in rig.mates_of(kill.node)):
        assert any(
            text.startswith(f"{node} ended")
            or text.startswith(f"{node} was ended")
            or (node in text and "SIGKILL" in text)
            for text in texts
        ), (node, texts)
        assert any(node in text and RESTARTED in text for text in texts), (node, texts)


@OF_NODES
def test_killed_recording_is_readable_up_to_the_last_flush(wreck: Any) -> None:
    rig = wreck[0]
    kill = kill_of(wreck, "recorder@master")
    recording = Recording(rig.out / "session.mcap")
    assert not recording.closed
    last_ns = max(message.publish_ns for message in recording.messages(["haptic/state"]))
    assert kill.at_ns - last_ns < 250_000_000 + SOON_NS
    following = Recording(rig.out / "session_1.mcap")
    assert following.closed
    assert following.info().messages > 1000


def after_ms(path: Path, topic: str, kill: Kill, mode: str) -> float | None:
    """Give the time from a kill until a device was in a mode [ms]."""
    for state in states(path, topic, kill.at_ns, kill.at_ns + LATER_NS):
        if state.mode == mode:
            return (state.t_ns - kill.at_ns) * 1e-6
    return None


@BOTH_WAYS
def test_times_are_entered_in_the_table_of_faults(wreck: Any) -> None:
    rig, kills = wreck[:2]
    path = rig.out / "session.mcap"
    for kill in kills:
        texts = []
        own = {STATE_OF.get(node) for node in rig.mates_of(kill.node)}
        for topic, mode, words in (
            ("haptic/state", "off", "hand off"),
            ("afm/state", "hold", "tip held"),
            ("afm/state", "retracted", "withdrawn"),
        ):
            # the device that was killed itself sends nothing until it is back
            if topic in own or kill.node == "recorder@master":
                continue
            at_ms = after_ms(path, topic, kill, mode)
            assert at_ms is not None, (kill.node, topic, mode)
            texts.append(f"{words} after {at_ms:.0f} ms")
        if kill.node == "recorder@master":
            lost_ms = (kill.at_ns - max(m.publish_ns for m in Recording(path).messages(["haptic/state"]))) * 1e-6
            texts.append(f"{max(lost_ms, 0.0):.0f} ms lost, the rest in session_1.mcap")
        way = ", one process" if rig.processes == "site" else ""
        record(f"kill -9 of {', '.join(rig.mates_of(kill.node))}{way}", "; ".join([*texts, "restarted"]))


@BOTH_WAYS
def test_a_node_that_dies_again_and_again_ends_the_rig(wreck: Any) -> None:
    rig, _, code, err = wreck
    assert code == 1
    assert "Traceback" not in err
    lines = map(json.loads, (rig.out / "logs" / "launcher@master.log").read_text().splitlines())
    died = [line for line in lines if line.get("about_node") == "delay_node@master" and "exit_code" in line]
    last = datetime.fromisoformat(died[-1]["time"])
    within = [line for line in died if last - datetime.fromisoformat(line["time"]) < timedelta(seconds=30)]
    assert len(within) == 5
    assert "it died 5 times within 30 s" in died[-1]["text"]
    reported = next(line for line in err.splitlines() if "5 times" in line).removeprefix("telenano: ")
    assert "delay_node@master" in reported
    assert rig.process_of("haptic_node@master") is None
    way = " in a process of several" if rig.processes == "site" else ""
    record(f"a node that dies again and again{way}", f"exit code 1: {reported}")
