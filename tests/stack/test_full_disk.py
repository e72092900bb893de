"""A recording that is removed, and disks that are full: that of a rig, and that of what a live command has measured."""

import contextlib
import re
from collections.abc import Iterator
from pathlib import Path

import pytest
from ledger import record
from stack_rig import Rig

from telenano.testing import disk_of


@pytest.fixture
def small(tmp_path: Path) -> Iterator[Rig]:
    """Return a rig whose folder is on a small disk of its own."""
    with disk_of(tmp_path / "disk", "2m") as disk, contextlib.closing(Rig(tmp_path)) as rig:
        rig.out = disk / "out"
        yield rig


@pytest.mark.check("fills a disk, takes 20 s")
@pytest.mark.drawn(0.0, "telenano/recording/", "services/recorder/", "telenano/launcher/")
def test_a_removed_recording_and_a_full_disk_are_reported_and_what_was_recorded_is_summarised(small: Rig) -> None:
    rig = small
    rig.start("--duration", "600")
    rig.wait_until(rig.running, "a running session")
    rig.kill("recorder@master")
    rig.wait_until((rig.out / "session_1.mcap").exists, "a recorder that was started again")
    rig.wait_until(lambda: (rig.out / "session_1.mcap").stat().st_size > 4000, "a flush of it")
    (rig.out / "session_1.mcap").unlink()
    rig.wait_until((rig.out / "session_2.mcap").exists, "a recording that goes on in another file")

    def full() -> bool:
        status = rig.telenano("status", "--duration", "1.2", "--json")
        return status.returncode == 1 and "No space left on device" in status.stdout

    rig.wait_until(full, "a status that reports the full disk")
    # the rig itself goes on
    assert rig.telenano("topic", "hz", "haptic/state", "--duration", "0.5", "--json").returncode == 0
    code, found, err = rig.stop()
    assert code == 1
    assert "Traceback" not in err
    assert "fig12.png: cannot be written: No space left on device" in err
    recording, missing = found["summary"]["recording"], found["summary"]["recording"]["missing"]
    assert recording["complete"] is False
    assert [part["file"] for part in recording["parts"]] == ["session.mcap", "session_2.mcap"]
    for text in (
        "session.mcap was not closed",
        "between session.mcap and session_2.mcap",
        "session_1.mcap was removed while it was written",
        "recording stopped, the rig continues: ",
    ):
        assert any(text in sentence for sentence in missing), (text, missing)
    # of the channels that lack most five are named, and which of those at 1 kHz these are is a matter of a few messages
    channels = [text for text in missing if re.fullmatch(r"\d+ messages of \S+@\S+ on \S+ are missing", text)]
    assert channels, missing
    assert any(sentence.endswith("further channels are missing") for sentence in missing), missing
    # nothing half written is left
    left = {path.name for path in rig.out.iterdir()} - {"logs", "scenario.yaml"}
    assert left == {"session.mcap", "session_2.mcap"}
    verified = rig.telenano("bag", "verify", str(rig.out / "session_2.mcap"))
    assert verified.returncode == 1
    assert "any amount" in verified.stdout
    pause_s = recording["parts"][1]["pause_s"]
    record("the recorder is killed in a session", f"summary of both parts, {pause_s:.1f} s between them stated")
    record("the recording is removed while it is written", "reported; went on in session_2.mcap")
    record("the disk of the recording is full", "rig went on; reported; summary of what was recorded, exit code 1")


# A command that takes something of a running rig, and where its results go.
LIVE = {
    "image": ("scan", "--live", "--json", "--pixels", "8", "--size", "20", "--lines", "2", "--out"),
    "curve": ("curve", "--live", "--json", "--out"),
    "recording.mcap": ("record", "--duration", "3", "--json", "--out"),
}


@pytest.mark.endurance
def test_live_commands_whose_results_have_no_room_name_the_place_and_leave_the_rig_as_it_was(rig: Rig) -> None:
    rig.start(scenario="image")
    rig.wait_until(rig.running, "the session")
    with disk_of(rig.folder / "disk", "64k") as disk:
        (disk / "filler").write_bytes(b"\0" * 65_536)
        for name, words in LIVE.items():
            done = rig.telenano(*words, str(disk / name), patience_s=120.0)
            assert done.returncode == 1, (words, done.stdout, done.stderr)
            assert str(disk / name) in done.stderr and "No space left on device" in done.stderr, done.stderr
            assert "Traceback" not in done.stderr
            # a recording keeps what there was room for
            assert {path.name for path in disk.iterdir()} - {"recording.mcap"} == {"filler"}
            rig.wait_until(lambda: rig.newest("afm/state").mode == "retracted", "a program that is over")
    rig.wait_until(lambda: rig.telenano("status", "--duration", "2").returncode == 0, "a rig without a problem")
    record(
        "the disk for an image, a curve or a recording of a running rig is full",
        "each ended with 1 and named the place; no image or curve was left half written, the tip was withdrawn, the "
        "rig went on",
    )
