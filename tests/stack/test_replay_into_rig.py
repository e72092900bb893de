"""A recording played at its own rate into a live rig without the node that it plays: no device obeys it."""

from collections.abc import Callable
from pathlib import Path

import pytest
from stack_rig import Rig

from telenano.recording.reader import Recording

LAW = "controller@slave"


@pytest.fixture
def reference(recording_of: Callable[[str], Path]) -> str:
    return str(recording_of("passivity"))


@pytest.mark.endurance
def test_no_device_obeys_a_replay_in_the_place_of_the_law(rig: Rig, reference: str) -> None:
    rig.start("--duration", "600", "--without", LAW)
    rig.wait_until(lambda: rig.log_has("afm_node@slave", "ready"), "a rig without the law of the slave")
    played = rig.telenano("replay", reference, "--nodes", LAW, "--rate", "1")
    assert played.returncode == 0, played.stderr
    text = f"commands of {LAW} come from a recording and are rejected"
    rig.wait_until(lambda: rig.log_has("afm_node@slave", text), "the instrument's refusal")
    rig.stop()
    recording = Recording(rig.out / "session.mcap")
    # it was there, at the rate of the recording
    assert len(list(recording.messages(["afm/command"]))) > 1000
    states = [message.fields() for message in recording.messages(["afm/state"])]
    assert {state["mode"] for state in states} == {"retracted"}
    # at rest where nothing can be touched
    assert len({state["base_position_m"] for state in states}) == 1


def test_the_recording_that_is_played_has_commands(reference: str) -> None:
    assert len(list(Recording(Path(reference)).messages(["afm/command"]))) > 1000
