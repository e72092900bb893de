"""A reset starts nothing: whatever ended a contact, arming leaves tip and hand where they are."""

from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from itertools import pairwise
from typing import Any

import pytest
from reset_rig import HAND, MASTER_HALF, SLAVE_HALF, STILL_M, TIP, ResetRig

from telenano.sections.controller_section import LAWS

# The base is withdrawn to there [m], and goes back at this speed where no other is stated [m/s].
AWAY_M, SPEED_M_PER_S = -100e-9, 50e-9
Way = Callable[[ResetRig], None]


def _lost(rig: ResetRig) -> None:
    rig.lose(HAND, lost=True)
    rig.wait(0.5)
    rig.lose(HAND, lost=False)


def _then(*ways: Way) -> Way:
    def each(rig: ResetRig) -> None:
        for way in ways:
            way(rig)

    return each


def _imaged(rig: ResetRig) -> None:
    """Take a force curve from the withdrawn tip, which ends with the tip away again."""
    rig.command("stop", "afm_node")
    rig.wait(0.15)
    curve = {"program": "curve", "curve.start_m": -20e-9, "curve.load_n": 5e-9, "curve.speed_m_per_s": 1e-6}
    # A program is a person's order, and moves the tip by itself.
    rig.command("set", "afm_node", **curve)
    rig._say(goes=True)
    rig.wait(1.2)
    rig._say(goes=False)
    assert rig.states[-1].mode == "retracted"


# How a contact ends, or what is done while the tip is away: one stop, loss and standstill, and a new process of each
# node, because the hand must stay, too. Where the tip alone is judged, `tests/simulation` draws the others.
WAYS: dict[str, Way] = {
    "emergency stop": lambda rig: rig.estop("*"),
    "hand lost and plugged in again": _lost,
    "slave half stands still": lambda rig: rig.halt(SLAVE_HALF, 0.5),
    "hand's node started again": lambda rig: rig.kill(HAND),
    "master half started again": lambda rig: rig.kill(MASTER_HALF),
    "slave half started again": lambda rig: rig.kill(SLAVE_HALF),
    "instrument started again": lambda rig: rig.kill(TIP),
    "withdrawn": lambda rig: rig.command("stop", "afm_node"),
    "after a force curve": _imaged,
    "law changed while the tip is away": _then(
        lambda rig: rig.estop("*"),
        lambda rig: rig.wait(0.2),
        lambda rig: rig.command("set", "controller", law="wave"),
    ),
    "scale changed while the tip is away": _then(
        lambda rig: rig.estop("*"),
        lambda rig: rig.wait(0.2),
        lambda rig: rig.command("set", "controller", **{"virtual_impedance.position_scale": 1.4e-6}),
    ),
}


@contextmanager
def stopped(way: Way, law: str = "virtual_impedance") -> Iterator[ResetRig]:
    """Yield a rig whose contact was ended in a way, with the tip away."""
    with closing(ResetRig(law)) as rig:
        rig.begin()
        rig.contact()
        way(rig)
        rig.wait(0.45)
        yield rig


def assert_nothing_moves(rig: ResetRig, time_s: float = 0.3) -> None:
    """Arm without a word and see that tip and hand stay."""
    tips, hands = len(rig.tips), len(rig.hands)
    base_m, hand_m = rig.base_m, rig.hands[-1].place_m
    assert rig.arm() == {HAND: "ack", TIP: "ack"}
    rig.wait(time_s)
    assert rig.states[-1].mode == "follow"
    assert max(at.place_m for at in rig.tips[tips:]) <= base_m + 1e-13
    assert max(abs(at.place_m - hand_m) for at in rig.hands[hands:]) <= STILL_M
    assert not rig.faults()


@pytest.mark.drawn(0.35, "telenano/afm/", "telenano/hand/", "telenano/runtime/loop/")
@pytest.mark.grid(way="emergency stop")
@pytest.mark.parametrize("way", WAYS)
def test_arming_leaves_tip_and_hand_where_they_are(way: str) -> None:
    with stopped(WAYS[way]) as rig:
        assert_nothing_moves(rig)
        # The hand is set off, and moves the tip from there.
        hand_m, base_m = rig.hands[-1].place_m, rig.base_m
        rig._send("start", HAND)
        rig.press(0.1, 2.0)
        rig.wait(0.15)
        scale = (rig.base_m - base_m) / (rig.hands[-1].place_m - hand_m)
        assert scale == pytest.approx(1.4e-6 if way.startswith("scale") else 1.5e-6, rel=0.02, abs=0.0)
        assert not rig.faults()


@pytest.mark.check("runs every law")
@pytest.mark.drawn(0.15)
@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("way", ["emergency stop", "master half started again", "slave half stands still"])
def test_no_law_moves_tip_or_hand_when_it_is_armed(way: str, law: str) -> None:
    with stopped(WAYS[way], law) as rig:
        assert_nothing_moves(rig)


CHANGES: dict[str, Way] = {
    "law": lambda rig: rig.command("set", "controller", law="passivity"),
    "law without energy": lambda rig: rig.command("set", "controller", law="position_force"),
    "scale": lambda rig: rig.command("set", "controller", **{"virtual_impedance.position_scale": 3e-6}),
    "gain": lambda rig: rig.command("set", "controller", **{"virtual_impedance.force_gain": 40.0}),
    "stiffness of the law": lambda rig: rig.command(
        "set", "controller", **{"virtual_impedance.stiffness_n_per_m": 9.0}
    ),
    "clamp": lambda rig: rig.command("set", "controller", **{"clamp.enabled": True}),
    "place over the sample": lambda rig: rig.command("set", "afm_node", **{"lateral.x_m": 5e-9}),
    "hold, and commands again": lambda rig: rig.halt(SLAVE_HALF, 0.12),
    "hand held up": lambda rig: rig.halt(HAND, 0.12),
    "armed again": lambda rig: rig.arm(),
}


@pytest.mark.drawn(0.5)
@pytest.mark.grid(change="law")
@pytest.mark.parametrize("change", CHANGES)
def test_nothing_that_is_changed_while_the_hand_is_set_off_moves_the_tip(change: str) -> None:
    with stopped(WAYS["emergency stop"]) as rig:
        rig.arm()
        rig.wait(0.05)
        base_m, hand_m, hands = rig.base_m, rig.hands[-1].place_m, len(rig.hands)
        CHANGES[change](rig)
        rig.wait(0.4)
        assert rig.states[-1].mode == "follow"
        assert rig.base_m <= base_m + 1e-13
        # A spring of the law draws the hand to its rest, away from the sample.
        if "stiffness" not in change:
            assert max(abs(at.place_m - hand_m) for at in rig.hands[hands:]) <= STILL_M
        assert not rig.faults()


def test_a_hand_that_is_armed_again_while_the_tip_is_held_does_not_get_it_back() -> None:
    with closing(ResetRig()) as rig:
        rig.begin()
        rig.contact()
        rig.estop(HAND)
        rig.wait(0.08)
        assert rig.states[-1].mode == "hold"
        hands = len(rig.hands)
        hand_m = rig.hands[-1].place_m
        assert rig.arm(HAND) == {HAND: "ack"}
        rig.wait(0.4)
        assert rig.states[-1].mode == "retracted"
        assert max(abs(at.place_m - hand_m) for at in rig.hands[hands:]) <= STILL_M
        assert not rig.faults()


def test_a_hold_that_ends_brings_back_no_more_than_the_hand_has_moved() -> None:
    with closing(ResetRig()) as rig:
        rig.begin()
        rig.contact()
        rig.halt(SLAVE_HALF, 0.12)
        rig.wait(0.3)
        assert rig.states[-1].mode == "follow"
        assert not rig.faults()


@pytest.mark.grid(place_m=None)
@pytest.mark.parametrize("place_m", [None, -30e-9, 10.5e-9])
def test_the_word_takes_the_tip_to_the_stated_place_at_the_stated_speed(place_m: float | None) -> None:
    with stopped(WAYS["emergency stop"]) as rig:
        rig.arm()
        rig.wait(0.05)
        state = rig.states[-1]
        assert (state.return_place_m, state.return_speed_m_per_s) == (0.0, SPEED_M_PER_S)
        assert state.return_s == pytest.approx(2.0, rel=1e-6)
        goal_m = state.return_place_m if place_m is None else place_m
        speed_m_per_s = 200e-9
        tips = len(rig.tips)
        assert rig.arm(TIP, place_m=goal_m, speed_m_per_s=speed_m_per_s) == {TIP: "ack"}
        # Beyond the rest point it goes at 15 nm/s.
        needs_s = (min(goal_m, 0.0) - AWAY_M) / speed_m_per_s + max(goal_m, 0.0) / 15e-9
        (begun,) = [event for event in rig.events[-3:] if event.kind == "mode" and event.data.get("placing_s")]
        assert begun.data["placing_s"] == pytest.approx(needs_s, rel=0.02, abs=0.0)
        rig.wait(0.2)
        assert rig.states[-1].return_place_m is None
        way = rig.tips[tips:]
        steps = [(b.place_m - a.place_m) / (b.time_s - a.time_s) for a, b in pairwise(way)]
        assert max(steps) == pytest.approx(speed_m_per_s, rel=0.02, abs=0.0)
        rig.wait(needs_s)
        placed = [event for event in rig.events if event.data.get("placed")][-1]
        if place_m == 10.5e-9:
            # It ends where the tip feels the sample.
            assert -1e-9 < rig.base_m <= goal_m + 0.1e-9
        else:
            assert rig.base_m == pytest.approx(goal_m, rel=0.0, abs=0.1e-9)
            assert placed.data["base_position_m"] == pytest.approx(goal_m, rel=0.0, abs=0.1e-9)


INPUTS: dict[str, tuple[Callable[[ResetRig], Any], str]] = {
    "arm": (lambda rig: rig.arm(TIP), "another command came"),
    "set": (lambda rig: rig.command("set", "afm_node", **{"lateral.x_m": 1e-9}), "another command came"),
    "refused set": (lambda rig: rig.command("set", "afm_node", **{"no.such": 1}), "another command came"),
    "hand presses": (lambda rig: rig.press(0.05, 0.8), "the hand pressed"),
    "hand pulls": (lambda rig: rig.press(0.05, -0.8), "the hand pressed"),
    "hand moves": (lambda rig: rig.press(0.6, 0.4), "the hand moved"),
    "silence": (lambda rig: rig.halt(SLAVE_HALF, 0.1), "no fresh command of the hand came"),
    "withdrawal": (lambda rig: rig.command("stop", "afm_node"), ""),
    "emergency stop": (lambda rig: rig.estop("*"), ""),
    "hand lost": (lambda rig: rig.lose(HAND, lost=True), "no fresh command of the hand came"),
    "instrument lost": (lambda rig: rig.lose(TIP, lost=True), ""),
}


@pytest.mark.drawn(0.5)
@pytest.mark.grid(given="hand moves")
@pytest.mark.parametrize("given", INPUTS)
def test_any_input_ends_the_way_of_the_tip(given: str) -> None:
    act, why = INPUTS[given]
    with stopped(WAYS["emergency stop"]) as rig:
        rig.arm()
        rig.arm(TIP, place_m=0.0)
        rig.wait(0.3)
        assert -100e-9 < rig.base_m < -70e-9
        act(rig)
        rig.wait(0.1)
        rig._say(goes=False)
        ended_m, hand_m, tips = rig.base_m, rig.hands[-1].place_m, len(rig.tips)
        rig.wait(0.5)
        moved_m = 1.5e-6 * max(0.0, max(at.place_m for at in rig.hands) - hand_m)
        assert max(at.place_m for at in rig.tips[tips:]) <= ended_m + moved_m + 1e-13
        assert [event.data["ended"] for event in rig.events if "ended" in event.data] == ([why] if why else [])
        assert not rig.faults()


WORDS: tuple[tuple[dict[str, Any], str], ...] = (
    ({"place": "here"}, "place = here: must be hand"),
    ({"place": "hand", "place_m": 0.0}, "place = hand: must be hand, or absent"),
    ({"place_m": 1.0}, "place_m = 1.0: must lie within"),
    ({"place_m": True}, "place_m = True: must lie within"),
    ({"place_m": 0.0, "speed_m_per_s": 1.0}, "at most 2e-06 m/s (safety.base_speed_m_per_s)"),
    ({"place_m": 0.0, "speed_m_per_s": 0.0}, "must be above 0"),
    ({"speed_m_per_s": 1e-8}, "needs place_m, the place to go to"),
    ({"places": 0.0}, "unknown key places; arm takes place, place_m, speed_m_per_s"),
)


def test_a_word_that_is_none_is_refused_and_moves_nothing() -> None:
    with stopped(WAYS["withdrawn"]) as rig:
        for word, says in WORDS:
            tips = len(rig.tips)
            assert rig.arm(TIP, **word) == {TIP: "refused"}, word
            assert says in [event for event in rig.events if event.kind == "refused"][-1].text
            rig.wait(0.1)
            assert {(at.mode, at.place_m) for at in rig.tips[tips:]} == {("retracted", AWAY_M)}, word
