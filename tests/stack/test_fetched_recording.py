"""Each site records its own: what the slave sends fast is fetched after the session and does not cross beside it."""

import json
import signal
import subprocess
from contextlib import closing
from pathlib import Path

import pytest
from stack_rig import PATIENCE_S, ROOT, judged
from two_sites import TwoSites, needs_namespaces
from wide_area_cable import WideAreaCable

from telenano.recording.reader import Recording

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
    assert both["afm/state afm_node@slave"] > 1000
    # what the link delivered at the master's site is there as it was received
    assert both["teleop/backward@master controller@slave"] == own["teleop/backward@master controller@slave"]
    summary = sites.master.summary()
    assert summary["verdict"] == "stable" or not judged(summary, "the fetched session"), summary["holds"]
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
    summary = sites.master.summary()
    assert summary["verdict"] == "stable" or not judged(summary, "the session beside a fetch"), summary["holds"]
    unknown = sites.master.telenano("bag", "fetch", str(out), "--file", "session_99.mcap")
    assert unknown.returncode != 0
    assert "launcher@slave refuses: session_99.mcap cannot be read: No such file" in unknown.stderr
    outside = sites.master.telenano("bag", "fetch", str(out), "--file", "../scenario.yaml")
    assert outside.returncode != 0
    assert "is not a part of a recording" in outside.stderr


def test_a_recording_is_fetched_in_pieces_over_a_line_that_loses_packets_and_is_cut(tmp_path: Path) -> None:
    """Fetch over 10 ms with two per cent of loss: the fetch is killed, then the line is cut, then it goes on."""
    cable = WideAreaCable(0.01, 0.02)
    with closing(TwoSites(tmp_path, cable=cable)) as sites:
        sites.start("--duration", "4", "--set", "recorder.far=fetch")
        assert sites.master.process is not None
        assert sites.master.process.wait(timeout=PATIENCE_S) == 0, sites.master.logs()
        out = sites.master.out
        both = counts(out / "both.mcap")
        (fetched,) = (out / "far").iterdir()
        whole = fetched.read_bytes()
        fetched.unlink()
        # what was recorded is sent for seconds, so that something can happen meanwhile
        command = ["bag", "fetch", str(out), "--kbit-per-s", "1000"]

        def begin() -> "subprocess.Popen[str]":
            return subprocess.Popen(
                sites.master.command(*command, "--site-file", str(sites.master.site_file)),
                env=sites.master.environment,
                stdout=subprocess.DEVNULL,
                stderr=subprocess.PIPE,
                text=True,
                cwd=ROOT,
            )

        def fetched_bytes() -> int:
            return sum(path.stat().st_size for path in (out / "far").iterdir())

        killed = begin()
        sites.wait_until(lambda: fetched_bytes() > len(whole) // 4, "a quarter of the recording")
        killed.kill()
        killed.communicate()
        kept = fetched_bytes()
        assert kept < len(whole), "all of it was there before the fetch was killed"
        cut = begin()
        sites.wait_until(lambda: fetched_bytes() > kept, "a fetch that goes on")
        assert fetched_bytes() >= kept
        cable.change(loss=1.0)
        signal.sigtimedwait((), 8.0)
        cable.change(loss=0.02)
        _, said = cut.communicate(timeout=PATIENCE_S)
        assert "Traceback" not in said
        # over so long a cut it either waited or ended with what to do; the next one ends it in either case
        assert cut.returncode == 0 or "bag fetch" in said, said
        last = sites.master.telenano(*command, "--json", patience_s=PATIENCE_S)
        assert last.returncode == 0, last.stderr
        assert json.loads(last.stdout)["messages"] == sum(both.values())
        assert fetched.read_bytes() == whole
