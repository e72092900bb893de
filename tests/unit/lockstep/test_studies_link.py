"""The schedule of the link against the link's own engine and against arithmetic."""

from typing import Any

import numpy as np
import pytest
from telenano_lab.studies.loops.links import Uneven, symmetric_link, uneven_ns, uneven_schedule

from telenano.lockstep import link
from telenano.lockstep.link import Schedule
from telenano.settings.link_settings import LinkSettings
from telenano.wire.errors import ConfigError

PERIOD_S = 1e-3


def test_constant_delay_is_half_the_round_trip_each_way() -> None:
    schedule = Schedule.of(symmetric_link(45.3e-3, 0.0, 0.0, 0), 100, PERIOD_S)
    sent = np.arange(100) * 1_000_000
    assert (schedule.forward_ns == sent + 22_650_000).all()
    assert (schedule.backward_ns == sent + 45_300_000).all()
    assert (schedule.forward_of == np.arange(100)).all()
    assert (schedule.backward_of == np.arange(100)).all()


def test_constant_delay_is_what_the_engine_says() -> None:
    settings = symmetric_link(33.3e-3, 0.0, 0.0, 0)
    quick = Schedule.of(settings, 50, PERIOD_S)
    # a jitter of no width changes nothing but the path taken
    slow = {"delay_s": 0.5 * 33.3e-3, "jitter": {"scale_s": 0.0, "distribution": "uniform"}}
    engine = Schedule.of(LinkSettings.of({"forward": slow, "backward": slow}), 50, PERIOD_S)
    for name in ("forward_ns", "forward_of", "backward_ns", "backward_of"):
        assert (getattr(quick, name) == getattr(engine, name)).all()


@pytest.mark.parametrize("burst", [None, 8.0])
def test_losses_over_a_constant_delay_are_what_the_engine_says(burst: float | None) -> None:
    settings = symmetric_link(33.3e-3, 0.0, 0.2, 4, burst)
    quick = Schedule.of(settings, 600, PERIOD_S)
    document = settings.model_dump(exclude_unset=True)
    for way in ("forward", "backward"):
        document[way]["jitter"] = {"scale_s": 0.0, "distribution": "uniform"}
    engine = Schedule.of(LinkSettings.of(document), 600, PERIOD_S)
    assert 200 < len(quick.backward_ns) < 500
    for name in ("forward_ns", "forward_of", "backward_ns", "backward_of", "window"):
        assert np.array_equal(getattr(quick, name), getattr(engine, name))


def test_readers_take_the_newest_only() -> None:
    schedule = Schedule.of(symmetric_link(20e-3, 8e-3, 0.2, 3), 2000, PERIOD_S)
    for times, numbers in ((schedule.forward_ns, schedule.forward_of), (schedule.backward_ns, schedule.backward_of)):
        assert (np.diff(times) >= 0).all()
        assert (np.diff(numbers) > 0).all()
    # 20 % are lost, and of those that remain the overtaken ones are of no use
    assert 0.1 * 2000 < len(schedule.forward_ns) < 0.8 * 2000


def test_loss_is_binomial() -> None:
    count = len(Schedule.of(symmetric_link(10e-3, 0.0, 0.2, 1), 5_000, PERIOD_S).forward_ns)
    assert abs(count - 4_000) < 4.0 * np.sqrt(5_000 * 0.2 * 0.8)


def test_bursts_lose_the_same_share_in_rows() -> None:
    ticks, loss, burst = 40_000, 0.2, 25.0
    arrived = Schedule.of(symmetric_link(10e-3, 0.0, loss, 1, burst), ticks, PERIOD_S).forward_of
    gaps = np.diff(arrived)
    rows = gaps[gaps > 1] - 1
    # about 320 rows whose lengths are geometric: the mean of so many is off by 6 % (one sigma)
    assert rows.mean() == pytest.approx(burst, rel=0.25, abs=0.0)
    assert 1.0 - len(arrived) / ticks == pytest.approx(loss, rel=0.3, abs=0.0)
    assert len(Schedule.of(symmetric_link(10e-3, 0.0, 1.0, 1, burst), 100, PERIOD_S).forward_ns) == 0


def test_window_holds_all_that_is_in_flight() -> None:
    schedule = Schedule.of(symmetric_link(300e-3, 40e-3, 0.0, 1), 3000, PERIOD_S)
    lag = schedule.forward_ns // 1_000_000 - schedule.forward_of
    assert schedule.window > lag.max()
    answered = np.searchsorted(schedule.forward_ns, schedule.backward_ns, side="right")
    assert schedule.window > (answered - schedule.backward_of).max()
    assert schedule.window & (schedule.window - 1) == 0


def test_link_that_loses_all_has_no_arrivals() -> None:
    schedule = Schedule.of(symmetric_link(10e-3, 0.0, 1.0, 0), 100, PERIOD_S)
    assert len(schedule.forward_ns) == len(schedule.backward_ns) == 0


def test_corrupted_messages_are_refused_by_their_reader() -> None:
    settings = LinkSettings.of({"forward": {"corruption": {"probability": 0.5}}})
    assert 300 < len(Schedule.of(settings, 1000, PERIOD_S).forward_ns) < 700
    assert link.FORWARD_TOPIC == "teleop/forward"


@pytest.mark.parametrize(("delay", "jitter", "loss"), [(-1e-3, 0.0, 0.0), (0.0, -1e-3, 0.0), (0.0, 0.0, 1.01)])
def test_impossible_links_are_refused(delay: float, jitter: float, loss: float) -> None:
    with pytest.raises(ConfigError, match="forward"):
        symmetric_link(delay, jitter, loss, 0)


SLOTS = {"slots": {"min_interval_s": 0.03, "max_interval_s": 0.03}}
HELD = {"outage": {"mode": "hold", "schedule": [[0.05, 0.04]], "period_s": 0.1}}


@pytest.mark.parametrize("settings", [SLOTS, HELD], ids=["slots", "held outage"])
def test_what_the_link_lets_out_together_has_one_answer(settings: dict[str, Any]) -> None:
    schedule = Schedule.of(LinkSettings.of({"forward": settings}), 1000, PERIOD_S)
    times_ns = schedule.forward_ns
    together = np.flatnonzero(np.diff(times_ns) == 0)
    assert len(together) > 200
    # every signal arrives, and of those that come together only the last is answered
    assert (schedule.forward_of == np.arange(len(times_ns))).all()
    assert not set(together) & set(schedule.backward_of)
    assert len(schedule.backward_of) == len(times_ns) - len(together)


@pytest.mark.parametrize(
    ("kind", "released_ms"),
    [
        ("slots", [3.0, 3.0, 3.0, 6.0, 6.0, 6.0]),
        ("outages", [3.0, 3.0, 3.0, 3.0, 4.0, 5.0]),
        ("bursts", [3.0, 3.1, 3.2, 6.0, 6.1, 6.2]),
        ("sawtooth", [0.0, 2.0, 4.0, 3.0, 5.0, 7.0]),
    ],
)
def test_an_uneven_link_lets_signals_out_when_its_kind_says(kind: Uneven, released_ms: list[float]) -> None:
    found = uneven_ns(np.arange(6) * 1_000_000, kind, 3_000_000)
    assert (found == np.rint(1e6 * np.array(released_ms)).astype(np.int64)).all()


def test_an_uneven_schedule_has_one_answer_to_what_comes_together_and_none_to_what_was_overtaken() -> None:
    slots = uneven_schedule(20e-3, "slots", 30e-3, 300, PERIOD_S)
    assert set(np.diff(slots.forward_ns)) == {0, 30_000_000}
    assert len(slots.backward_ns) == 10
    assert (slots.backward_of % 30 == 29).all()
    overtaken = uneven_schedule(20e-3, "sawtooth", 30e-3, 300, PERIOD_S)
    assert (np.diff(overtaken.forward_of) > 0).all()
    assert len(overtaken.forward_of) < 300
