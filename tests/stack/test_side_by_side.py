"""Rigs of one user on one machine, as a class-room starts them: at once, killed, and stopped by one command."""

import json
import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import machine
import pytest
from stack_rig import Rig

from telenano.launcher.processors import FOR_A_RIG, held, shared_folder
from telenano.runtime.loop.realtime import may_use_fifo

pytestmark = pytest.mark.stack


@pytest.fixture
def rigs(tmp_path: Path) -> Iterator[list[Rig]]:
    """Two rigs that have one runtime folder, as those of one user have."""
    both = [Rig(tmp_path / name) for name in ("1", "2")]
    both[1].sockets, both[1].environment = both[0].sockets, both[0].environment
    yield both
    for rig in both:
        rig.close()


def listed(rig: Rig) -> dict[str, dict[str, Any]]:
    """Return the rigs of this user by name."""
    return {row["rig"]: row for row in json.loads(rig.telenano("status", "--all", "--json").stdout)["rigs"]}


def has_room() -> bool:
    """Return whether this machine has processors for two rigs, and note it where it has not."""
    permitted = os.sched_getaffinity(0)
    free = len(permitted) - len(held(permitted, shared_folder()))
    if may_use_fifo(50) and free >= 2 * FOR_A_RIG:
        return True
    machine.note(f"two rigs side by side: {free} processors are free, so that they had none of their own")
    return False


@pytest.mark.endurance
def test_two_that_are_started_at_once_run_each_by_itself(rigs: list[Rig]) -> None:
    room = has_room()
    for rig in rigs:
        rig.start("--duration", "300")
    for rig in rigs:
        rig.wait_until(rig.running, "the session")
    found = listed(rigs[0])
    assert set(found) == {"main", "2"}
    assert {row["out"] for row in found.values()} == {str(rig.out) for rig in rigs}
    if room:
        own = [number for row in found.values() for number in row["processors"]]
        assert len(own) == len(set(own)) == 2 * FOR_A_RIG
    unanswered = set()
    for name, row in found.items():
        state = json.loads(rigs[0].telenano("status", "--rig", name, "--json").stdout)
        assert "rig" in state, state
        assert state["rig"]["process"] == row["process"]
        marked = rigs[0].telenano("session", "mark", f"label={name}", "--rig", name)
        if marked.returncode != 0 and not room and "the rig is late by" in marked.stderr:
            # two rigs on the processors of one: it is said that the mark may be missing, and by how much it was late
            machine.note(f"the mark of one of two rigs was not judged: {marked.stderr.strip()}")
            unanswered.add(name)
            continue
        assert marked.returncode == 0, marked.stderr
    for rig in rigs:
        code, summary, err = rig.stop()
        assert code == 0, err + rig.logs()
        assert summary["recording"]["complete"], summary["recording"]["missing"]
    # each recording has the mark of its own rig and no other
    for row in found.values():
        cat = rigs[0].telenano("bag", "cat", f"{row['out']}/session.mcap", "--topics", "session/control")
        marks = [json.loads(line)["message"] for line in cat.stdout.splitlines()]
        # A command is repeated until it is answered.
        labels = {str(m["parameters"]["label"]) for m in marks if m["command"] == "mark"}
        assert labels <= {row["rig"]} and (labels or row["rig"] in unanswered)
    assert listed(rigs[0]) == {}
    assert not (rigs[0].sockets / "rig-2").exists()


@pytest.mark.endurance
def test_a_rig_that_is_killed_leaves_its_name_to_the_next(rigs: list[Rig]) -> None:
    first, second = rigs
    first.start("--duration", "60")
    first.wait_until(first.running, "the session")
    assert first.process is not None
    first.process.kill()
    second.run("--duration", "2")
    assert first.process_of("afm_node@slave") is None
    assert listed(second) == {}


@pytest.mark.drawn(0.0, "telenano/console/", "telenano/launcher/", "telenano/runtime/bus/")
def test_an_emergency_stop_reaches_every_rig(rigs: list[Rig]) -> None:
    has_room()
    for rig in rigs:
        rig.start("--duration", "60")
    for rig in rigs:
        rig.wait_until(rig.running, "the session")
    stopped = rigs[0].telenano("estop", "--json")
    assert stopped.returncode == 0, stopped.stderr
    answers = json.loads(stopped.stdout)["answers"]
    devices = ("haptic_node@master", "afm_node@slave")
    assert set(answers) == {f"{name}/{device}" for name in ("main", "2") for device in devices}
    for name in ("main", "2"):
        state = json.loads(rigs[0].telenano("status", "--rig", name, "--json").stdout)
        assert [row["mode"] for row in state["afm"]] == ["estop"]
    for rig in rigs:
        rig.stop()
