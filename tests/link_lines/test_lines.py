"""What is said of lines whose truth is known: of some of them in every check, of four hundred on demand."""

import pytest
from line_judge import OFF_MS, judge
from lines import LineOf, Piece, Seen, Session, WayOf, draw_line, run
from lines_confusion import Counted, Figures, figures

from telenano.analysis.line_states import LineReport, states_of

LEVEL = (Piece(0.0, 20.0),)
# Of the lines: capacities that are wrong at most, and that are not known where a queue limits the line at most.
WRONG, NULL = 0.05, 0.30
# Round trips that are wrong at most, and steps after which the hand is off for too long at most: with losses, TCP holds
# the link's questions up.
ROUND_TRIP_WRONG, LATE = 0.05, 0.15


def held(found: Figures) -> None:
    """Check that shares may be what they are to be: the interval of each reaches below its bound."""
    bounds = (found.wrong, WRONG), (found.null_of_limited, NULL), (found.round_trip_wrong, ROUND_TRIP_WRONG)
    for share, bound in (*bounds, (found.late, LATE)):
        assert share.interval()[0] <= bound, found


@pytest.mark.check("takes 15 s")
def test_of_some_lines_what_is_said_is_right() -> None:
    held(figures(judge(run(draw_line(seed), str(seed))) for seed in range(20_000, 20_008)))


@pytest.mark.endurance("takes 10 min")
@pytest.mark.timeout(3600)
def test_of_four_hundred_lines_what_is_said_is_right() -> None:
    found = figures(judge(run(draw_line(seed), str(seed))) for seed in range(10_000, 10_400))
    assert found.wrong.share <= WRONG, found
    assert found.null_of_limited.share <= NULL, found
    assert found.round_trip_wrong.share <= ROUND_TRIP_WRONG, found
    assert found.late.share <= LATE, found


@pytest.mark.check("takes 10 s")
@pytest.mark.drawn(0.0, "telenano/analysis/", "telenano/link/", "telenano/timing/")
def test_a_report_tells_what_lines_took_before_and_after_a_change_that_lasts() -> None:
    seeds = [seed for seed in range(23_000, 23_040) if draw_line(seed).kind in ("step", "reorders", "jitters in order")]
    wrong = []
    for seed in seeds[:10]:
        line = draw_line(seed)
        session = run(line, str(seed))
        said = [
            LineReport(one.at_s, one.round_trip_ms, one.low_ms, one.high_ms, one.at_s)
            for one in session.seen
            if one.at_s > 1
        ]
        states = states_of(said, line.seconds)
        true_ms = [session.seen[0].true_ms, session.seen[-1].true_ms]
        expected = true_ms if abs(true_ms[1] - true_ms[0]) > max(6.0, 0.12 * true_ms[0]) else true_ms[:1]
        slack_ms = 2.0 + 2.0 * (line.there.jitter[1] + line.back.jitter[1])
        right = len(states) == len(expected) and all(
            abs(state["round_trip_ms"] - value) <= slack_ms for state, value in zip(states, expected, strict=True)
        )
        wrong += [] if right else [(seed, line.kind, states, expected)]
    assert len(wrong) <= 1, wrong


def step(after_ms: float, hz: int = 500, from_s: float = 3.0) -> LineOf:
    way = WayOf((Piece(0.0, 20.0), Piece(from_s, after_ms)))
    return LineOf("step", way, way, hz=hz, seconds=6.0)


@pytest.mark.grid(hz=125)
@pytest.mark.parametrize("hz", [125, 1000])
@pytest.mark.parametrize("after_ms", [50.0, 100.0])
def test_after_a_step_the_hand_is_off_for_a_moment_and_no_queue_is_said_to_stand(after_ms: float, hz: int) -> None:
    session = run(step(after_ms, hz), "1")
    assert session.hand_off_in(3.0, 6.0) <= OFF_MS
    ((_, before_ms, told_ms),) = session.told
    assert (before_ms, told_ms) == (pytest.approx(40.0, abs=0.5), pytest.approx(2 * after_ms, abs=0.5))
    last = session.seen[-1]
    assert last.low_ms <= 2 * after_ms <= last.high_ms
    assert all(said is not None and said < 1.0 for said, _, _ in last.queues_ms)
    assert all(mbit is None or mbit > 10.0 for seen in session.seen for mbit, _ in seen.capacities)


@pytest.mark.check("takes 2.6 s")
def test_one_way_that_becomes_longer_is_told_from_the_other() -> None:
    level = WayOf(LEVEL)
    for there, back in ((step(60.0).there, level), (level, step(60.0).there)):
        session = run(LineOf("step", there, back, hz=500, seconds=6.0), "1")
        assert session.hand_off_in(3.0, 6.0) <= OFF_MS
        # The tip is as well: it obeys what comes by the way there.
        assert not [at_ms for at_ms in session.tip_off_ms if at_ms > 3_400]


def test_a_queue_that_grows_switches_the_hand_off_for_as_long_as_it_grows() -> None:
    # The messages of others fill the line evenly, by a tenth more than it carries.
    way = WayOf(LEVEL, rate_mbit=(Piece(0.0, 4.0),), room_bytes=400_000, others=((2.0, 6.0, 4.6),))
    session = run(LineOf("queue of others", way, WayOf(LEVEL), hz=250, seconds=6.0), "1")
    growing = [one for one in session.seen if 3.0 < one.at_s < 5.0]
    assert all(one.round_trip_ms < 60.0 for one in growing)
    assert session.hand_off_in(3.5, 5.0) > 1400


def made(capacity: float | None, truth: float, round_trip_ms: float = 40.0) -> Session:
    line = LineOf("limited" if truth else "step", WayOf(LEVEL, (Piece(0.0, truth),)), WayOf(LEVEL), hz=1000)
    session = Session(line)
    for tick in range(90):
        ways = ((capacity, truth), (None, 0.0))
        session.seen.append(Seen(0.1 * tick, round_trip_ms, 40.0, 39.0, 41.0, ((0.0, 0.0, 0.0),) * 2, ways))
    return session


def test_the_judge_names_what_is_wrong() -> None:
    said = {1.0: "right", 1.2: "right", 1.3: "wrong", 0.7: "wrong", None: "null"}
    assert {value: judge(made(value, 1.0))[0].capacity for value in said} == said
    assert judge(made(0.1, 0.0))[0].capacity == "wrong"
    assert not judge(made(None, 0.0, round_trip_ms=100.0))[0].round_trip
    low, high = Counted(5, 100).interval()
    assert (low, high) == (pytest.approx(0.0215, abs=1e-3), pytest.approx(0.1118, abs=1e-3))
