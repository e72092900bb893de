"""Each site records its own: what the slave sends fast is fetched after the session and does not cross beside it."""

import json
from pathlib import Path

import pytest
from two_sites import TwoSites, needs_namespaces

from recording.reader import Recording

pytestmark = [needs_namespaces, pytest.mark.stack, pytest.mark.endurance, pytest.mark.timeout(300)]


def counts(path: Path) -> dict[str, int]:
    """Give the messages of each channel."""
    found: dict[str, int] = {}
    for message in Recording(path).messages():
        name = f"{message.channel_topic} {message.src}"
        found[name] = found.get(name, 0) + 1
    return found


def test_a_session_of_two_sites_is_recorded_at_both_and_merged_at_its_end(sites: TwoSites) -> None:
    sites.start("--duration", "5")
    assert sites.master.process is not None
    assert sites.master.process.wait(timeout=120) == 0, sites.master.logs()
    out = sites.master.out
    own, both = counts(out / "session.mcap"), counts(out / "both.mcap")
    fast = ["afm/state afm_node@slave", "node/journal afm_node@slave", "teleop/backward controller@slave"]
    for name in fast:
        assert name not in own
        assert both[name] > 0
    assert both["afm/state afm_node@slave"] > 3000
    # what the link delivered at the master's site is there as it was received
    assert both["teleop/backward@master controller@slave"] == own["teleop/backward@master controller@slave"]
    summary = sites.master.summary()
    assert summary["verdict"] == "stable", summary["holds"]
    assert summary["recording"]["complete"] is True, summary["recording"]
    assert Path(summary["recording"]["file"]).name == "both.mcap"
    # the site goes on, and so does what it sends: it is fetched once more, and nothing has changed
    again = sites.master.telenano("bag", "fetch", str(out), "--json")
    assert again.returncode == 0, again.stderr
    assert json.loads(again.stdout)["messages"] == sum(both.values())
    (fetched,) = (out / "far").iterdir()
    fetched.unlink()
    refetched = sites.master.telenano("bag", "fetch", str(out), "--json")
    assert refetched.returncode == 0, refetched.stderr
    assert json.loads(refetched.stdout)["messages"] == sum(both.values())
    fetched.unlink()
    # beside a session that runs the link carries the request
    sites.master.start("--duration", "8")
    sites.wait_until(sites.running, "a second session")
    beside = sites.master.telenano("bag", "fetch", str(out), "--json", "--kbit-per-s", "20000")
    assert beside.returncode == 0, beside.stderr
    assert json.loads(beside.stdout)["messages"] == sum(both.values())
    assert sites.master.process.wait(timeout=120) == 0, sites.master.logs()
    assert sites.master.summary()["verdict"] == "stable", sites.master.summary()["holds"]
    unknown = sites.master.telenano("bag", "fetch", str(out), "--file", "session_99.mcap")
    assert unknown.returncode != 0
    assert "launcher@slave refuses: session_99.mcap cannot be read: No such file" in unknown.stderr
    outside = sites.master.telenano("bag", "fetch", str(out), "--file", "../scenario.yaml")
    assert outside.returncode != 0
    assert "is no part of a recording" in outside.stderr
