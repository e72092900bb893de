"""Each site records its own: what the slave sends fast is fetched after the session and does not cross beside it."""

import json
from collections.abc import Iterator
from pathlib import Path

import pytest
from two_sites import TwoSites, needs_namespaces

from recording.reader import Recording

pytestmark = [needs_namespaces, pytest.mark.stack, pytest.mark.endurance, pytest.mark.timeout(300)]


@pytest.fixture
def rig(tmp_path: Path) -> Iterator[TwoSites]:
    found = TwoSites(tmp_path)
    try:
        yield found
    finally:
        found.close()


def counts(path: Path) -> dict[str, int]:
    """Give the messages of each channel."""
    found: dict[str, int] = {}
    for message in Recording(path).messages():
        name = f"{message.channel_topic} {message.src}"
        found[name] = found.get(name, 0) + 1
    return found


def test_a_session_of_two_sites_is_recorded_at_both_and_merged_at_its_end(rig: TwoSites) -> None:
    rig.start("--duration", "5")
    assert rig.master.process is not None
    assert rig.master.process.wait(timeout=120) == 0, rig.master.logs()
    out = rig.master.out
    own, both = counts(out / "session.mcap"), counts(out / "both.mcap")
    fast = ["afm/state afm_node@slave", "node/journal afm_node@slave", "teleop/backward controller@slave"]
    for name in fast:
        assert name not in own
        assert both[name] > 0
    assert both["afm/state afm_node@slave"] > 3000
    # what the link delivered at the master's site is there as it was received
    assert both["teleop/backward@master controller@slave"] == own["teleop/backward@master controller@slave"]
    summary = rig.master.summary()
    assert summary["verdict"] == "stable", summary["holds"]
    assert summary["recording"]["complete"] is True, summary["recording"]
    assert Path(summary["recording"]["file"]).name == "both.mcap"
    # the site goes on, and so does what it sends: it is fetched once more, and nothing has changed
    again = rig.master.telenano("bag", "fetch", str(out), "--json")
    assert again.returncode == 0, again.stderr
    assert json.loads(again.stdout)["messages"] == sum(both.values())
    (fetched,) = (out / "far").iterdir()
    fetched.unlink()
    refetched = rig.master.telenano("bag", "fetch", str(out), "--json")
    assert refetched.returncode == 0, refetched.stderr
    assert json.loads(refetched.stdout)["messages"] == sum(both.values())
    fetched.unlink()
    # beside a session that runs the link carries the request
    rig.master.start("--duration", "8")
    rig.wait_until(rig.running, "a second session")
    beside = rig.master.telenano("bag", "fetch", str(out), "--json", "--kbit-per-s", "20000")
    assert beside.returncode == 0, beside.stderr
    assert json.loads(beside.stdout)["messages"] == sum(both.values())
    assert rig.master.process.wait(timeout=120) == 0, rig.master.logs()
    assert rig.master.summary()["verdict"] == "stable", rig.master.summary()["holds"]
    unknown = rig.master.telenano("bag", "fetch", str(out), "--file", "session_99.mcap")
    assert unknown.returncode != 0
    assert "launcher@slave refuses: session_99.mcap cannot be read: No such file" in unknown.stderr
    outside = rig.master.telenano("bag", "fetch", str(out), "--file", "../scenario.yaml")
    assert outside.returncode != 0
    assert "is no part of a recording" in outside.stderr
