import math
from typing import Any

import numpy as np
import pytest

from telenano.link.direction import DirectionEngine
from telenano.link.engine import LinkEngine
from telenano.link.fate import Release
from telenano.link.models.outages import Outages
from telenano.link.random_streams import stream
from telenano.settings.link_settings import LinkSettings, Outage

MS = 1_000_000
ORIGIN = 5_000 * MS


def outages(**keys):
    return Outages(Outage(**keys), ORIGIN, stream(31, "outage"))


def test_scheduled_outages_are_exact_and_end_when_they_say():
    link = outages(schedule=((0.010, 0.005), (0.020, 0.001)))
    expected = {0: None, 10 * MS - 1: None, 10 * MS: 15, 15 * MS - 1: 15, 15 * MS: None, 20 * MS: 21, 21 * MS: None}
    for elapsed, end in expected.items():
        assert link.end_ns(ORIGIN + elapsed) == (None if end is None else ORIGIN + end * MS)
    assert link.end_ns(ORIGIN + 10**12) is None


def test_schedule_repeats_with_its_period():
    link = outages(schedule=((0.0, 0.002),), period_s=0.010)
    down = [link.end_ns(ORIGIN + k * MS) is not None for k in range(100)]
    assert down == [k % 10 < 2 for k in range(100)]


def test_touching_outages_are_one():
    link = outages(schedule=((0.001, 0.001), (0.002, 0.003)))
    assert link.end_ns(ORIGIN + MS) == ORIGIN + 5 * MS


@pytest.mark.check("takes 4.0 s")
def test_random_outages_have_the_share_and_the_lengths_of_their_law():
    up_s, down_s = 0.080, 0.020
    link = outages(mean_up_s=up_s, mean_down_s=down_s)
    step_ns, steps = MS // 2, 2_000_000
    ends = [link.end_ns(ORIGIN + k * step_ns) for k in range(steps)]
    down = np.array([end is not None for end in ends])
    cycles = steps * step_ns * 1e-9 / (up_s + down_s)
    # Alternating exponential times: the share has the variance 2 u^2 d^2 / (u + d)^4 per cycle.
    sigma = math.sqrt(2 * up_s**2 * down_s**2 / (up_s + down_s) ** 4 / cycles)
    assert abs(down.mean() - down_s / (up_s + down_s)) < 4 * sigma
    first = [(k, end) for k, end in enumerate(ends) if end is not None and (k == 0 or ends[k - 1] != end)]
    # Exponential lengths have no memory: what remains at the first look has the mean of the whole.
    remaining_s = np.array([end - ORIGIN - k * step_ns for k, end in first]) * 1e-9
    assert abs(remaining_s.mean() / down_s - 1) < 4 / math.sqrt(len(remaining_s))


def test_random_outages_do_not_depend_on_when_one_looks():
    every, some = outages(mean_up_s=0.01, mean_down_s=0.005), outages(mean_up_s=0.01, mean_down_s=0.005)
    seen = {k: every.end_ns(ORIGIN + k * MS // 4) for k in range(8000)}
    for k in range(0, 8000, 77):
        assert some.end_ns(ORIGIN + k * MS // 4) == seen[k]


def test_schedule_and_chance_together_are_down_when_either_is():
    chance = outages(mean_up_s=0.01, mean_down_s=0.005)
    both = outages(mean_up_s=0.01, mean_down_s=0.005, schedule=((0.5, 0.1),))
    for k in range(1000):
        now = ORIGIN + k * MS
        either = chance.end_ns(now) is not None or 500 <= k < 600
        assert (both.end_ns(now) is not None) == either


def test_a_long_pause_is_not_walked_through_and_keeps_the_law():
    hour_ns, up_s, down_s = 3600 * 10**9, 3e-6, 1e-6
    settings = Outage(mean_up_s=up_s, mean_down_s=down_s)
    draws, ends = [], []
    for seed in range(4000):
        draw = stream(seed, "outage")
        link = Outages(settings, ORIGIN, lambda draw=draw: draws.append(0) or draw())
        ends.append(link.end_ns(ORIGIN + hour_ns))
    assert len(draws) <= 8 * len(ends)
    remaining_s = np.array([end - ORIGIN - hour_ns for end in ends if end is not None]) * 1e-9
    share = down_s / (up_s + down_s)
    assert abs(len(remaining_s) / len(ends) - share) < 4 * math.sqrt(share * (1 - share) / len(ends))
    # an outage that goes on has the mean of a whole one, to the nanosecond that is the least
    assert abs(remaining_s.mean() / down_s - 1) < 5 / math.sqrt(len(remaining_s))


@pytest.mark.check("takes 4.2 s")
def test_log_normal_lengths_have_their_mean_and_their_spread():
    mean_s, spread = 0.265, 0.3
    link = outages(mean_up_s=0.5, mean_down_s=mean_s, down_spread=spread)
    now, lengths = ORIGIN, []
    while len(lengths) < 4000:
        now += MS
        if (end := link.end_ns(now)) is not None:
            lengths.append((end - now) * 1e-9)
            now = end
    # The look comes up to 1 ms after the begin.
    assert np.mean(lengths) == pytest.approx(mean_s, abs=0.001 + 4 * spread * mean_s / math.sqrt(len(lengths)))
    assert np.std(np.log(lengths)) == pytest.approx(spread, abs=4 * spread / math.sqrt(2 * len(lengths)) + 0.003)


# --- what a stall holds ----------------------------------------------------------------------------------------------

STALL = {"schedule": ((0.010, 0.500),), "mode": "hold"}


def flooded(drop: str = "tail", messages: int = 400, **queue: Any) -> tuple[DirectionEngine, list[Release]]:
    """Send 100 bytes each millisecond, in turn on two topics, into a stall from 10 to 510 ms."""
    settings = {"outage": STALL, "queue": {"drop": drop, **queue}, "order": "link", "delay_s": 0.001}
    engine = DirectionEngine("forward", LinkSettings.of({"forward": settings}), 0)
    released: list[Release] = []
    for seq in range(messages):
        released += engine.submit(seq * MS, "ab"[seq % 2], bytes(100), seq)
    return engine, released


def ended(engine: DirectionEngine) -> list[Release]:
    released: list[Release] = []
    while (next_ns := engine.next_release_ns()) is not None:
        released += engine.due(next_ns)
    return released


@pytest.mark.parametrize("limits", [{"limit_messages": 50}, {"limit_messages": None, "limit_bytes": 5000}])
@pytest.mark.parametrize("drop", ["tail", "head", "random", "same_topic"])
def test_a_stall_that_is_flooded_holds_what_its_queue_has_room_for_and_counts_the_rest(
    drop: str, limits: dict[str, int | None]
) -> None:
    engine, released = flooded(drop, **limits)
    stats = engine.stats()
    assert (stats.queued, stats.dropped["queue"], len(released)) == (50, 390 - 50, 10)
    held = ended(engine)
    assert {release.fate.release_ns for release in held} == {511 * MS}
    numbers = [release.fate.seq for release in held]
    assert numbers == sorted(numbers)
    wanted = {"tail": range(10, 60), "head": range(350, 400), "same_topic": range(350, 400)}
    if drop in wanted:
        assert numbers == list(wanted[drop])
    fates = engine.take_fates()
    assert sum(fate.dropped == "queue" for fate in fates) == 340
    assert len(fates) == 400


def test_a_stall_holds_the_reliable_beyond_its_limit_and_no_line_that_moves_has_one() -> None:
    engine, _ = flooded(limit_messages=5)
    for seq in range(20):
        engine.submit(400 * MS, "session/control", bytes(100), seq)
    assert len([release for release in ended(engine) if release.topic == "session/control"]) == 20
    moving = LinkSettings.of({"forward": {"outage": STALL, "queue": {"limit_messages": 0}, "delay_s": 0.05}})
    fates = DirectionEngine.fates(moving, "forward", "a", range(0, 9 * MS, MS // 100), 100)
    assert not any(fate.dropped for fate in fates)


@pytest.mark.parametrize(
    ("change", "end_ms"),
    [
        ({"profile": "clean"}, 20),
        ({"forward.outage.schedule": "0.0:0.1"}, 120),
        ({"forward.outage.schedule": "0.1:0.1"}, 20),
        ({"forward.outage.mode": "drop"}, 510),
        ({"forward.queue.limit_messages": 60}, 510),
        ({"forward.delay_s": 0.002}, 510),
    ],
)
def test_what_a_stall_holds_goes_on_when_the_stall_that_is_in_force_ends(change: dict[str, Any], end_ms: int) -> None:
    link = LinkEngine(LinkSettings.of({"forward": {"outage": STALL, "queue": {"limit_messages": 50}}}), 0)
    for seq in range(80):
        link.forward.submit(11 * MS, "a", bytes(100), seq)
    link.reconfigure(link.settings.changed(change), 20 * MS)
    released = [*link.forward.submit(21 * MS, "a", bytes(100), 80), *ended(link.forward)]
    assert [release.fate.release_ns for release in released if release.fate.seq < 80] == [end_ms * MS] * 50
    fates = {fate.seq: fate for fate in link.take_fates()}
    assert sum(fate.dropped == "queue" for fate in fates.values() if fate.seq < 80) == 30
    # what comes later is treated by the new settings alone
    cause = {"forward.outage.mode": "outage", "forward.delay_s": "queue"}.get(next(iter(change)), "")
    assert fates[80].dropped == (cause or ("queue" if end_ms == 120 else ""))


@pytest.mark.parametrize("mode", ["drop", "hold"])
def test_a_command_that_an_outage_holds_holds_up_none_once_the_outage_is_cleared(mode: str) -> None:
    stall = {"schedule": ((0.0, 600.0),), "mode": mode}
    link = LinkEngine(LinkSettings.of({"forward": {"outage": stall}}), 0)
    assert link.forward.submit(MS, "session/control", b"start", 0) == ()
    settings = link.settings
    for change in ({"forward.queue.limit_messages": 9}, {"forward.outage.mode": "drop"}, {"forward.delay_s": 0.0}):
        settings = settings.changed(change)
        link.reconfigure(settings, 2 * MS)
    assert link.forward.due(3 * MS) == []
    link.reconfigure(settings.changed({"profile": "clean"}), 4 * MS)
    assert [release.payload for release in link.forward.submit(5 * MS, "session/control", b"arm", 1)] == [
        b"start",
        b"arm",
    ]


def test_a_session_that_begins_in_a_stall_of_the_session_before_ends_it() -> None:
    stall = {"schedule": ((0.010, 0.500),), "mode": "hold", "origin": "session"}
    link = LinkEngine(LinkSettings.of({"forward": {"outage": stall}}), 0)
    link.begin_session(0)
    assert link.forward.submit(11 * MS, "a", bytes(100), 0) == ()
    link.begin_session(20 * MS)
    assert [release.fate.seq for release in link.forward.submit(20 * MS, "a", bytes(100), 1)] == [0, 1]


def test_settings_that_are_stamped_before_the_newest_message_count_from_that_message() -> None:
    link = LinkEngine(LinkSettings.of({"forward": {"delay_s": 0.001}}), 0)
    link.forward.submit(10 * MS, "a", b"", 0)
    link.reconfigure(
        link.settings.changed({"forward.outage.schedule": "0.0:0.01", "forward.outage.mode": "hold"}), 5 * MS
    )
    released = [*link.forward.submit(16 * MS, "a", b"", 1), *ended(link.forward)]
    assert [release.fate.release_ns for release in released] == [11 * MS, 21 * MS]


def test_an_overtaking_message_waits_in_a_stall_as_the_others_do() -> None:
    settings = {"outage": STALL, "reordering": {"probability": 1.0}, "delay_s": 0.02, "queue": {"limit_messages": 7}}
    link = LinkSettings.of({"forward": settings})
    fates = DirectionEngine.fates(link, "forward", "a", range(11 * MS, 400 * MS, MS), 100)
    assert all(fate.delay_ns == 0 for fate in fates[:10])
    assert [fate.dropped for fate in fates[10:17]] == [""] * 7
    assert {fate.dropped for fate in fates[17:]} == {"queue"}
