"""The adversary's draws: what they are stated to be, and again the same from the same seed."""

import math

import pytest

from telenano.testing.law_balance.balance_draws import ALL_KINDS, EVERYTHING, KINDS, MIXED, SILENCES, drawn

LIMIT_S = 0.2
SEED = 5


def test_the_same_number_is_the_same_order() -> None:
    for kind in ALL_KINDS:
        assert drawn(SEED, 3, kind) == drawn(SEED, 3, kind)
        assert drawn(SEED, 3, kind) != drawn(SEED, 4, kind)


def test_a_shorter_order_is_the_beginning_of_a_longer_one() -> None:
    for kind in ALL_KINDS:
        for case in range(5):
            long, short = drawn(SEED, case, kind), drawn(SEED, case, kind, longest_s=15.0)
            assert (long.hand, long.sample, long.line, long.seed) == (short.hand, short.sample, short.line, short.seed)
            assert short.events == long.events[: len(short.events)]


def test_silences_are_of_a_tenth_to_three_times_the_limit_and_reach_both_ends() -> None:
    lengths = [
        event.lasts_s / LIMIT_S for kind in SILENCES for case in range(40) for event in drawn(SEED, case, kind).events
    ]
    assert 0.1 <= min(lengths) < 0.3 and 2.8 < max(lengths) <= 3.0
    assert sum(length > 1.0 for length in lengths) > len(lengths) / 2


def test_events_follow_each_other_within_the_order() -> None:
    for kind in ALL_KINDS:
        for case in range(20):
            order = drawn(SEED, case, kind)
            ends_s = 0.0
            for event in order.events:
                assert ends_s <= event.start_s < order.duration_s and event.lasts_s >= 0.0
                ends_s = event.ends_s


def test_worlds_are_as_wide_as_stated() -> None:
    orders = [drawn(SEED, case, MIXED) for case in range(300)]
    hands = [order.hand.stiffness_n_per_m for order in orders if not order.hand.bare]
    assert 100.0 <= min(hands) < 150.0 and 2000.0 < max(hands) <= 3000.0
    assert {order.hand.push_n > 0.0 for order in orders} == {True, False}
    drifts = [order.sample.drift_m_per_s for order in orders]
    assert min(drifts) < -4e-10 and max(drifts) == 5e-10
    delays = [way for order in orders for way in (order.line.forward_s, order.line.backward_s)]
    assert min(delays) == 0.0 and 0.18 < max(delays) <= 0.2
    assert sum(order.duration_s >= 60.0 for order in orders) > len(orders) / 2
    takes = [order.sample for order in orders]
    assert any(sample.hysteresis for sample in takes) and any(sample.viscous_n_s_per_m for sample in takes)


def test_each_kind_has_events_of_that_kind_alone() -> None:
    for kind in KINDS:
        found = {event.kind for case in range(20) for event in drawn(SEED, case, kind).events}
        assert found <= {kind} | (set(SILENCES) if kind.startswith("end of travel") else set())


def test_an_unknown_kind_is_named() -> None:
    with pytest.raises(ValueError, match="letting go is not a kind of order: known are hold, let go, off"):
        drawn(SEED, 0, "letting go")


def test_what_is_worse_is_drawn_in_its_kind_alone_and_in_everything() -> None:
    def worse(kind: str) -> set[str]:
        found: set[str] = set()
        for order in (drawn(SEED, case, kind, longest_s=5.0) for case in range(40)):
            found |= {order.line.shape} - {"constant"}
            found |= {name for name in ("jump_m", "creep_m") if getattr(order.sample, name)}
            found |= {"bursts"} if order.line.burst > 1.0 else set()
            found |= {"servo"} if order.servo_hz else set()
            found |= {event.kind for event in order.events} & {"instrument stalls", "retune in contact"}
        return found

    assert [worse(kind) for kind in (*KINDS, MIXED)] == [set()] * (len(KINDS) + 1)
    assert worse("line that steps") == {"steps"} and worse("line that overtakes") == {"sawtooth", "random"}
    assert worse("line in bursts") == {"slots"} and worse("line that loses") == {"bursts"}
    assert worse("sample that jumps") == {"jump_m"} and worse("sample that creeps") == {"creep_m"}
    assert worse("instrument stalls") == {"instrument stalls"} and worse("slow servo") == {"servo"}
    assert worse("retune in contact") == {"retune in contact"} and worse("resonant arm") == set()
    assert worse(EVERYTHING) == {
        *("steps", "sawtooth", "random", "slots", "bursts", "jump_m", "creep_m", "servo"),
        *("instrument stalls", "retune in contact"),
    }


def test_an_arm_that_resonates_has_hardly_any_damping_and_is_driven_near_its_own_frequency() -> None:
    driven = 0
    for case in range(40):
        hand = drawn(SEED, case, "resonant arm").hand
        critical = 2.0 * math.sqrt(hand.mass_kg * hand.stiffness_n_per_m)
        assert hand.damping_n_s_per_m <= 0.0501 * critical and not hand.bare
        own_hz = math.sqrt(hand.stiffness_n_per_m / hand.mass_kg) / (2.0 * math.pi)
        driven += bool(hand.swing_n) and 0.7 <= hand.rate_hz / own_hz <= 1.3
    assert driven > 20
