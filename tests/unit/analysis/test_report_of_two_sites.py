"""Reports of sessions whose sites have clocks of their own, whose data are missing, or whose network was away."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from made_sessions import BEGAN_NS, NS, Made, hand_force_n
from telenano_lab.studies.plot import read_traces

import telenano
from telenano.analysis.recording_document import judged_recording
from telenano.analysis.report import write_report
from telenano.cli.output import clock_warning, closing_lines, line_changes
from telenano.recording.reader import Recording
from telenano.recording.sender_time import SenderClock
from telenano.recording.site_clock import read_site_clock
from telenano.recording.site_merge import merge_sites
from telenano.recording.verify import verify

# The share of its longer tests that is in `make check` where the change touches none of these folders.
pytestmark = pytest.mark.drawn(0.5, "telenano/analysis/", "telenano/recording/", "telenano/timing/")

# what differs with the clocks: names, times to the rounding of stamps, and what is said of the clocks
FIGURES = ("verdict", "stable", "reason", "hold_ratio", "contact_x_cm", "release_force_nn", "greatest_pull_nn")
CLOCKS = {
    "37 s ahead": {"ahead_s": 37.0},
    "0.3 s behind": {"ahead_s": -0.3},
    "500 ppm fast": {"drift": 5e-4},
    "37 s ahead and 500 ppm slow": {"ahead_s": 37.0, "drift": -5e-4},
}


def report(folder: Path, **made: Any) -> dict[str, Any]:
    """Give the summary of a session that is made up, as its file would have it."""
    folder.mkdir(exist_ok=True)
    found: dict[str, Any] = json.loads(json.dumps(telenano.open(Made(**made).write(folder)).summary))
    return found


def verdicts(summary: dict[str, Any]) -> list[str]:
    return [hold["verdict"] for hold in summary["holds"]]


def same(summary: dict[str, Any], expected: dict[str, Any]) -> None:
    """The figures are those of a session with one clock; stamps are of whole ns and offsets known to 0.2 ms."""
    for key in FIGURES:
        found = summary[key]
        assert found == (
            pytest.approx(expected[key], rel=2e-3, abs=1e-9) if isinstance(found, float) else expected[key]
        )
    assert verdicts(summary) == verdicts(expected)
    assert summary["completeness"] == pytest.approx(expected["completeness"], rel=0.0, abs=2e-3)
    assert summary["rate_hz"] == pytest.approx(expected["rate_hz"], rel=0.0, abs=0.3)
    assert summary["recording"]["complete"] is expected["recording"]["complete"] is True


@pytest.fixture(scope="module")
def with_one_clock(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    summary = report(tmp_path_factory.mktemp("one"))
    assert summary["verdict"] == "stable"
    assert summary["hold_ratio"] == pytest.approx(1.0, rel=1e-6)
    assert summary["clocks"]["applied"] is False
    assert summary["clocks"]["otherwise"] is None
    assert clock_warning(summary) == ""
    return summary


@pytest.mark.check("takes 0.6 s")
@pytest.mark.parametrize("clock", CLOCKS)
def test_a_session_with_another_clock_at_the_slave_has_the_figures_of_one_without(
    tmp_path: Path, with_one_clock: dict[str, Any], clock: str
) -> None:
    summary = report(tmp_path, **CLOCKS[clock])
    same(summary, with_one_clock)
    found, given = summary["clocks"], CLOCKS[clock]
    assert found["applied"] is True
    middle_s = given.get("ahead_s", 0.0) + 4.0 * given.get("drift", 0.0)
    assert found["offset_s"] == pytest.approx(middle_s, abs=3e-4)
    assert found["drift_ppm"] == pytest.approx(1e6 * given.get("drift", 0.0), abs=30.0)
    assert clock_warning(summary).startswith("the clocks of the sites are not synchronised: ")


@pytest.mark.parametrize("way_s", [2e-4, 0.1])
def test_a_drift_is_seen_within_the_bound_that_the_round_trip_sets(tmp_path: Path, way_s: float) -> None:
    made = Made(drift=5e-4, there_s=way_s, back_s=way_s, jitter_s=1e-4)
    clock = read_site_clock(Recording(made.write(tmp_path)))
    assert clock is not None and clock.applied
    times_s = np.arange(0.0, 8.0, 0.5)
    stamps = np.array([made.slave_ns(time_s) for time_s in times_s.tolist()], dtype=np.int64)
    truth_ns = stamps - BEGAN_NS - np.rint(times_s * NS).astype(np.int64)
    # the ways differ by their least jitter
    assert np.abs(clock.ahead_ns(stamps) - truth_ns).max() < 1e-4 * NS


@pytest.mark.check("takes 0.8 s")
def test_ways_that_differ_are_not_taken_for_clocks_and_both_readings_are_given(
    tmp_path: Path, with_one_clock: dict[str, Any]
) -> None:
    summary = report(tmp_path, there_s=0.01, back_s=0.07)
    same(summary, with_one_clock)
    clocks = summary["clocks"]
    assert clocks["applied"] is False
    assert clocks["offset_s"] == pytest.approx(-0.03, abs=1e-3)
    assert clocks["otherwise"]["verdict"] == "stable"
    assert clocks["otherwise"]["hold_ratio"] == pytest.approx(1.0, rel=1e-3)


def test_two_readings_with_two_verdicts_are_said_in_words(with_one_clock: dict[str, Any]) -> None:
    other = {"stable": False, "verdict": "limit_cycle", "reason": "", "hold_ratio": None}
    clocks = {**with_one_clock["clocks"], "otherwise": other}
    assert clock_warning({**with_one_clock, "clocks": clocks}).endswith(
        "uncorrected, the session is stable, corrected for it limit_cycle"
    )


def test_a_queue_that_fills_on_one_way_is_no_drift(tmp_path: Path) -> None:
    made = Made()
    # the questions take longer and longer, and the answers do not
    made.queue_s = 5e-4
    clock = read_site_clock(Recording(made.write(tmp_path)))
    assert clock is not None
    assert (clock.drift, clock.applied) == (0.0, False)


def test_an_offset_by_which_an_answer_comes_before_its_question_is_refused(tmp_path: Path) -> None:
    # what the link says of the clocks contradicts every stamp of the recording
    clock = read_site_clock(Recording(Made(told_s=1.0).write(tmp_path)))
    assert clock is not None
    assert clock.applied is False
    assert "too early" in clock.reason


def test_replay_plot_and_tables_have_the_clock_of_the_report(tmp_path: Path) -> None:
    made = Made(ahead_s=-0.3, drift=5e-4)
    path = made.write(tmp_path)
    recording = Recording(path)
    sender = SenderClock(recording)
    for message in recording.messages(["afm/state"]):
        sent_s = (sender.time_ns(message) - BEGAN_NS) / NS
        assert sent_s == pytest.approx(_truth_s(made, message.publish_ns), abs=3e-4)
    hand, tip = read_traces(path, ["haptic/state.session_s", "afm/state.tip_force_n.2"])
    assert [hand.time_s[0], tip.time_s[0]] == pytest.approx([0.0, 0.0], abs=1e-3)
    assert tip.time_s[-1] == pytest.approx(hand.time_s[-1], abs=1e-3)
    table = telenano.open(path).table("afm/state")
    assert table["time_s"][0] == pytest.approx(-0.3, abs=1e-3)


def _truth_s(made: Made, stamp_ns: int) -> float:
    return ((stamp_ns - BEGAN_NS) / NS - made.ahead_s) / (1.0 + made.drift)


@pytest.mark.check("takes 1.5 s")
@pytest.mark.drawn(0.5, "telenano/analysis/", "telenano/timing/")
@pytest.mark.parametrize("clock", CLOCKS)
def test_recordings_of_both_sites_together_are_reported_as_one(
    tmp_path: Path, with_one_clock: dict[str, Any], clock: str
) -> None:
    made = Made(**CLOCKS[clock])
    paths = [made.write(tmp_path, site) for site in ("master", "slave")]
    both = tmp_path / "both.mcap"
    merge_sites(paths, both, same_session=True)
    summary = write_report(both, tmp_path / "report")
    same(summary, with_one_clock)
    lags = [message.log_ns - message.publish_ns for message in Recording(both).messages(["afm/state"])]
    ahead_ns = [made.slave_ns(0.0) - BEGAN_NS, made.slave_ns(8.0) - BEGAN_NS - 8 * NS]
    # the recorder beside the tip had its samples at once
    assert all(abs(lag + ahead) < 5e6 for lag, ahead in zip((lags[100], lags[-60]), ahead_ns, strict=True))


def after_2_s(topic: str, time_s: float) -> bool:
    return topic == "afm/state" and time_s > 2.0


def test_a_hold_without_samples_of_the_tip_is_one_without_data(tmp_path: Path) -> None:
    summary = report(tmp_path, without=after_2_s)
    assert summary["stable"] is None
    assert summary["verdict"] == "no_data"
    assert verdicts(summary) == ["no_data"] * 3
    assert summary["hold_ratio"] is None
    assert summary["recording"]["complete"] is False
    assert summary["recording"]["missing"] == [
        "1259 messages of afm_node@slave on afm/state are missing",
        "afm/state: nothing from 2.000 s to 8.000 s of the session",
    ]


@pytest.mark.check("takes 1.4 s")
def test_a_session_without_any_sample_of_the_tip_has_a_summary_and_a_figure(tmp_path: Path) -> None:
    for lost in (("afm/state",), ("afm/state", "haptic/command"), ("afm/state", "haptic/command", "link/status")):
        summary = write_report(
            Made(without=lambda topic, time_s, lost=lost: topic in lost).write(tmp_path), tmp_path / "report"
        )
        assert json.loads((tmp_path / "report" / "summary.json").read_text()) == summary
        assert set(verdicts(summary)) == {"no_data"}
        assert summary["greatest_pull_nn"] is None
        assert (tmp_path / "report" / "fig12.png").stat().st_size > 10_000
        (tmp_path / "session.mcap").unlink()


def test_a_hold_that_the_recording_does_not_show_at_the_hand_is_one_without_data(tmp_path: Path) -> None:
    summary = report(tmp_path, without=lambda topic, time_s: topic == "haptic/state" and 2.7 < time_s < 4.55)
    assert verdicts(summary) == ["stable", "no_data"]
    assert summary["holds"][1]["reason"] == "haptic/state: nothing from 2.900 s to 4.500 s of the session"
    assert "haptic/state: nothing from 2.700 s to 4.550 s of the session" in summary["recording"]["missing"]


@pytest.mark.check("takes a second")
def test_a_pause_of_a_twentieth_of_a_hold_is_none(tmp_path: Path) -> None:
    summary = report(tmp_path, without=lambda topic, time_s: topic == "afm/state" and 3.5 < time_s < 3.57)
    assert verdicts(summary) == ["stable"] * 2


@pytest.mark.check("takes a second")
@pytest.mark.parametrize(("until_s", "found"), [(0.0, ["guarded"] * 4), (2.0, ["stable", "guarded", "guarded"])])
def test_a_session_in_which_no_answer_reached_the_hand_is_not_stable(
    tmp_path: Path, until_s: float, found: list[str]
) -> None:
    summary = report(tmp_path, answers=until_s)
    assert verdicts(summary) == found
    assert (summary["verdict"], summary["stable"]) == ("guarded", False)
    first_s = max(until_s, summary["holds"][found.index("guarded")]["start_s"])
    assert summary["reason"].startswith(f"haptic/command: no answer reached the hand from {first_s:.3f} s to ")
    # what the hand did not get is no message that the recorder lacks
    assert summary["recording"]["missing"] == []


def test_what_a_recording_that_ends_early_does_not_show_has_no_data(tmp_path: Path) -> None:
    summary = report(tmp_path, end_s=3.0)
    assert verdicts(summary) == ["stable", "no_data", "no_data"]
    assert summary["stable"] is None


def withdrawn(reason: str, held: bool) -> dict[str, Any]:
    """The instrument presses, and withdraws at 3.5 s of the session; held: it has stood still for half a second."""

    def mode(time_s: float) -> str:
        before = "hold" if held and time_s >= 3.0 else "follow"
        return before if time_s < 3.5 else "retracting" if time_s < 3.6 else "retracted"

    return {
        "mode": mode,
        # it comes late into contact, so that there is a jump in the hold
        "tip_n": lambda time_s: 0.0 if 2.6 < time_s < 3.3 or time_s > 3.55 else hand_force_n(time_s - 0.02),
        "in_contact": lambda time_s: hand_force_n(time_s - 0.02) > 0.0 and not 2.6 < time_s < 3.3 and time_s < 3.55,
        "events": ((3.5, {"mode": "retracting", "reason": reason, "base_position_m": 0.0}),) if reason else (),
    }


@pytest.mark.parametrize("reason", ["hold_expired", ""])
def test_a_network_that_was_away_is_named_and_the_law_is_not_blamed(tmp_path: Path, reason: str) -> None:
    summary = report(tmp_path, **withdrawn(reason, held=True))
    assert verdicts(summary) == ["stable", "guarded", "guarded"]
    assert "withdrew at 3.500 s because no command came (hold_expired: none for 250 ms)" in summary["reason"]
    assert "network" in summary["reason"]


@pytest.mark.check("takes 0.5 s")
def test_the_kill_of_a_node_is_named_in_the_holds_that_it_touched_and_in_no_other(tmp_path: Path) -> None:
    killed = (3.1, "afm_node@slave ended by SIGKILL: it is started again")
    summary = report(
        tmp_path,
        ahead_s=37.0,
        without=lambda topic, time_s: topic == "afm/state" and 3.0 < time_s < 3.9,
        incidents=(killed,),
    )
    assert verdicts(summary) == ["stable", "no_data"]
    assert summary["reason"] == f"afm/state: nothing from 3.000 s to 3.900 s of the session; at 3.100 s: {killed[1]}"
    starved = report(tmp_path / "starved", **withdrawn("hold_expired", held=True), incidents=(killed,))
    assert f"at 3.100 s: {killed[1]}" in starved["reason"]


KILL = (3.1, "haptic_node@master was killed by SIGKILL after 9.2 s: it is started again in 0.1 s")


def off_between(first_s: float, last_s: float) -> Any:
    return lambda time_s: "off" if first_s <= time_s < last_s else "position"


@pytest.mark.parametrize("anew_s", [None, 4.0])
def test_a_session_after_a_kill_of_the_hand_is_told_to_its_end_with_the_kill_and_its_time(
    tmp_path: Path, anew_s: float | None
) -> None:
    summary = report(
        tmp_path,
        killed_s=3.1,
        anew_s=anew_s,
        without=lambda topic, time_s: topic == "haptic/state" and 3.1 < time_s < 3.3,
        hand_mode=off_between(3.1, 3.6),
        incidents=(KILL,),
    )
    # the made session is 8 s long, and the hand's samples go on to 8.3 s
    assert summary["duration_s"] > 7.9
    (kill,) = summary["interruptions"]
    assert (kill["kind"], summary["processes_ended"]) == ("process_ended", 1)
    assert kill["start_s"] == pytest.approx(3.1, abs=0.01)
    assert kill["end_s"] == pytest.approx(summary["duration_s"] if anew_s is None else anew_s, abs=0.01)
    then = "its force profile was not started again" if anew_s is None else "its force profile began again at 4.000 s"
    assert f"in the session at 3.095 s {KILL[1]}; {then}" in summary["reason"]
    # the holds of the programme that began anew are judged as well
    presses = [hold for hold in summary["holds"] if hold["hand_force_n"] > 0.5 and hold["start_s"] > 4.0]
    assert len(presses) == (0 if anew_s is None else 2)


@pytest.mark.check("takes 1.0 s")
def test_every_hold_of_the_tip_and_every_time_that_the_hand_was_let_go_is_counted_and_named(tmp_path: Path) -> None:
    """The network is away for 60 ms in a hold of 1 N, and the force swings from then on until the hold ends."""
    swings = lambda time_s: hand_force_n(time_s - 0.02) + (0.2 if 1.6 < time_s < 2.6 and time_s % 0.2 < 0.1 else 0.0)  # noqa: E731
    given: dict[str, Any] = {
        "tip_n": swings,
        "in_contact": lambda time_s: hand_force_n(time_s - 0.02) > 0.0,
        "mode": lambda time_s: "hold" if 1.6 <= time_s < 1.63 or 3.5 <= time_s < 3.54 else "follow",
        "hand_mode": off_between(1.61, 1.65),
        "events": (
            (1.6, {"mode": "hold", "reason": "command_deadline", "base_position_m": 0.0}),
            (1.61, {"mode": "off", "position_m": 0.0}),
            (3.5, {"mode": "hold", "reason": "command_deadline", "base_position_m": 0.0}),
        ),
    }
    summary = report(tmp_path, **given)
    assert (summary["tip_holds"], summary["hand_let_go"], summary["processes_ended"]) == (2, 1, 0)
    assert verdicts(summary) == ["limit_cycle", "stable"]
    sentence = "the tip was held once because no command came (command_deadline), at 1.600 s, for 30 ms"
    assert sentence in summary["holds"][0]["facts"][0]["text"]
    assert [fact["kind"] for fact in summary["holds"][0]["facts"]] == ["interrupted", "interrupted"]
    twice = "the tip was held 2 times because no command came (command_deadline), first at 1.600 s, for 40 ms at the"
    assert f"in the session {twice} longest" in summary["reason"]
    assert "the hand was let go once, at 1.610 s, for 40 ms (no command within the deadline" in summary["reason"]
    # a hold that somebody asked for is none of the network's, and opens the loop all the same
    asked = {**given, "hand_mode": off_between(9.0, 9.1)}
    asked["events"] = tuple((at_s, {**data, "reason": "hold_requested"}) for at_s, data in given["events"])
    own = report(tmp_path / "own", **asked)
    assert (own["tip_holds"], own["hand_let_go"], own["interruptions"]) == (0, 0, [])
    assert verdicts(own) == ["limit_cycle", "stable"]


@pytest.mark.check("takes 0.8 s")
@pytest.mark.parametrize(("back_s", "verdict"), [(3.6, "stable"), (3.8, "guarded"), (4.45, "guarded")])
def test_a_hold_is_judged_with_its_hand_and_the_cause_of_its_absence_comes_first(
    tmp_path: Path, back_s: float, verdict: str
) -> None:
    """The tip rests all the time; the motor of the hand is off from 2.95 s on, in a hold from 2.9 s to 4.5 s."""
    summary = report(
        tmp_path, hand_mode=off_between(2.95, back_s), events=((2.95, {"mode": "off", "position_m": 0.0}),)
    )
    first, hold = summary["holds"]
    assert (first["verdict"], first["coupled_share"]) == ("stable", 1.0)
    assert hold["verdict"] == summary["verdict"] == verdict
    assert hold["coupled_share"] == pytest.approx(1.0 - (back_s - 2.95) / 1.6, abs=0.02)
    assert summary["recording"]["missing"] == []
    said = closing_lines(summary, tmp_path)[0]
    share = f"{100.0 * hold['coupled_share']:.0f} %"
    if verdict == "guarded":
        cause = f"the hand was let go once, at 2.950 s, for {1e3 * (back_s - 2.95):.0f} ms"
        assert summary["reason"].startswith(cause)
        assert f"hand and tip were coupled for {share} of the hold" in hold["reason"]
        assert "the hand held" not in said
    else:
        assert said.endswith(f"N for each newton at the tip, in the {share} of the hold in which both were in it")


STANDS_S = (3.2, 3.5)


def stood_still(made: Made, anew: bool) -> Made:
    """Return a session whose AFM sends nothing for 0.3 s, and goes on, itself or a new process of it."""
    made.silent = lambda topic, time_s: topic == "afm/state" and STANDS_S[0] < time_s < STANDS_S[1]
    made.anew_tip_s = STANDS_S[1] if anew else None
    return made


@pytest.mark.check("takes 0.8 s")
@pytest.mark.parametrize("anew", [False, True])
def test_an_instrument_that_stood_still_has_lost_nothing(tmp_path: Path, anew: bool) -> None:
    path = stood_still(Made(), anew).write(tmp_path)
    summary = telenano.open(path).summary
    assert verify([path]).sound
    assert (summary["recording"]["complete"], summary["verdict"], summary["sources_silent"]) == (True, "guarded", 1)
    words = "the AFM sent nothing from 3.200 s to 3.500 s"
    assert summary["reason"].startswith(words)
    (silence,) = summary["interruptions"]
    assert (silence["kind"], silence["reason"]) == ("source_silent", "the AFM sent nothing")
    assert summary["holds"][1]["coupled_share"] == pytest.approx(1.0 - 0.3 / 1.6, abs=0.02)
    # the same time without samples, of which the numbers are missing
    (tmp_path / "lost").mkdir()
    lost_path = Made(without=lambda topic, time_s: topic == "afm/state" and 3.2 < time_s < 3.5).write(tmp_path / "lost")
    lost = telenano.open(lost_path).summary
    assert not verify([lost_path]).sound
    assert (lost["recording"]["complete"], lost["verdict"], lost["sources_silent"]) == (False, "no_data", 0)


def test_a_law_that_swung_before_the_network_was_away_is_blamed_for_it(tmp_path: Path) -> None:
    cycle = lambda time_s: hand_force_n(time_s - 0.02) + (0.3 * np.sin(50.0 * time_s) if 2.9 < time_s < 4.5 else 0.0)  # noqa: E731
    summary = report(
        tmp_path,
        tip_n=cycle,
        in_contact=lambda time_s: hand_force_n(time_s - 0.02) > 0.0,
        mode=lambda time_s: "hold" if 4.3 <= time_s < 4.33 else "follow",
        events=((4.3, {"mode": "hold", "reason": "command_deadline", "base_position_m": 0.0}),),
    )
    assert verdicts(summary)[1] == "limit_cycle"
    assert "the tip was held once because no command came" in summary["reason"]


@pytest.mark.check("takes 0.8 s")
def test_what_was_set_at_the_slave_is_in_the_session_by_its_own_clock(tmp_path: Path) -> None:
    for folder, ahead_s in (("one", 0.0), ("other", 37.0)):
        summary = report(tmp_path / folder, ahead_s=ahead_s, set_s=3.0)
        assert summary["changed"] == ["afm_node@slave: set afm_node.safety.force_limit_n to 3e-08"]


def test_another_guard_is_named_with_its_time(tmp_path: Path) -> None:
    summary = report(tmp_path, **withdrawn("force_limit", held=False))
    assert summary["holds"][-1]["verdict"] == "guarded"
    assert "at 3.500 s (force_limit: more than 200 nN on the tip)" in summary["holds"][-1]["reason"]
    assert all("network" not in hold["reason"] for hold in summary["holds"])


@pytest.mark.parametrize("way_s", [5e-5, 0.02])
def test_the_clock_of_one_machine_is_left_alone(tmp_path: Path, way_s: float) -> None:
    clock = read_site_clock(Recording(Made(there_s=way_s, back_s=way_s).write(tmp_path)))
    assert clock is not None
    assert clock.applied is False
    assert abs(clock.offset_s) < 1e-4


@pytest.mark.check("takes 1.0 s")
@pytest.mark.parametrize(("at_s", "by_s"), [(2.0, 0.3), (5.0, 3.0), (3.5, 3600.0)])
def test_a_clock_that_steps_back_inside_a_file_is_not_blamed_on_the_sites(
    tmp_path: Path, at_s: float, by_s: float
) -> None:
    summary = report(tmp_path, set_back_s=(at_s, by_s))
    assert summary["clocks"]["applied"] is False, summary["clocks"]
    assert clock_warning(summary) == ""


@pytest.mark.check("takes a second")
def test_the_page_tells_a_silence_and_a_loss(tmp_path: Path) -> None:
    document = judged_recording(Recording(stood_still(Made(), anew=False).write(tmp_path)))
    (silence,) = [moment for moment in document["moments"] if moment["kind"] == "source_silent"]
    assert (silence["level"], silence["src"]) == ("warning", "afm_node")
    assert silence["text"] == "the AFM sent nothing for 300 ms, and no message is missing"
    assert silence["t_s"] - document["session_s"][0] == pytest.approx(3.2, abs=0.01)
    assert document["summary"]["recording"]["complete"] is True
    (tmp_path / "lost").mkdir()
    lost = Made(without=lambda topic, time_s: topic == "afm/state" and 3.2 < time_s < 3.5).write(tmp_path / "lost")
    document = judged_recording(Recording(lost))
    assert [moment for moment in document["moments"] if moment["kind"] == "source_silent"] == []
    assert document["summary"]["recording"]["complete"] is False


@pytest.mark.check("takes 4 s")
@pytest.mark.parametrize("ahead_s", [0.0, 37.0])
@pytest.mark.parametrize(("what", "verdict"), [("silent", "guarded"), ("without", "no_data")])
def test_recordings_of_both_sites_tell_silence_from_loss_alone_and_together(
    tmp_path: Path, what: str, verdict: str, ahead_s: float
) -> None:
    away: dict[str, Any] = {what: lambda topic, time_s: topic == "afm/state" and 3.2 < time_s < 3.6}
    paths = [Made(ahead_s=ahead_s, **away).write(tmp_path, site) for site in ("master", "slave")]
    both = tmp_path / "both.mcap"
    merge_sites(paths, both, same_session=True)
    for path in (paths[0], both):
        summary = telenano.open(path).summary
        assert summary["verdict"] == verdict
        assert summary["recording"]["complete"] is verify([path]).sound is (what == "silent")


@pytest.mark.check("takes a second")
@pytest.mark.parametrize("by_s", [0.03, 0.2])
def test_the_line_before_and_after_a_lasting_change_is_told(tmp_path: Path, by_s: float) -> None:
    summary = report(tmp_path, longer_s=(5.0, by_s))
    before, after = summary["line_states"]
    assert before["to_s"] == after["from_s"] == pytest.approx(5.0, abs=0.5)
    for state, true_ms in ((before, 40.0), (after, 40.0 + 1e3 * by_s)):
        assert state["low_ms"] <= true_ms <= state["high_ms"]
        assert state["round_trip_ms"] == pytest.approx(true_ms, abs=1.0)
    (told,) = line_changes(summary)
    assert told.startswith("the way between the sites became longer at ")
    assert f"is {after['round_trip_ms']:.3g} ms" in told


@pytest.mark.check("takes a second")
def test_a_line_that_stays_and_one_machine_have_no_change_to_tell_of(
    tmp_path: Path, with_one_clock: dict[str, Any]
) -> None:
    assert len(report(tmp_path, longer_s=(5.0, 0.0))["line_states"]) == 1
    assert "line_states" not in with_one_clock and line_changes(with_one_clock) == []
