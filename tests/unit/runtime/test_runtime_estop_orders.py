"""An emergency stop ends every earlier wish to move, in every order of stops, arms, stalls, kills and retries."""

import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from stopped_devices import ARMED, HAND, MS, STOPPED, TIP, World

SECOND = 1000 * MS
# each as long as any of those who send
LONGEST_NS = 12 * SECOND


@contextmanager
def world(**options: Any) -> Iterator[World]:
    folder = tempfile.mkdtemp()
    try:
        yield World(Path(folder), **options)
    finally:
        shutil.rmtree(folder)


STALLS = st.sampled_from(
    [("stall", TIP), ("stall", HAND), ("go_on",), ("kill", TIP), ("kill", HAND), ("start",), ("withdraw",), ("cut",)]
)
ARMS = st.sampled_from(
    [("arm",), ("arm", TIP), ("arm", HAND), ("launch",), ("naive",), ("stop",), ("console_stop",), ("no_position",)]
)
GAPS_MS = st.sampled_from([0, 20, 100, 300, 700, 1100, 2500])
BEFORE = st.lists(st.tuples(GAPS_MS, st.one_of(ARMS, STALLS)), min_size=1, max_size=7)
AFTER = st.lists(st.tuples(GAPS_MS, STALLS), max_size=4)
# before the stop has reached anybody
AT_ONCE = AFTER.map(lambda more: [(0, ("stall", TIP)), (0, ("stall", HAND)), *more])


def act(here: World, action: tuple[str, ...], repeated_ns: int) -> None:
    kind, *nodes = action
    match kind:
        case "arm":
            here.arm(*nodes)
        case "launch":
            here.arm(launcher=True)
        case "naive":
            here.arm_naively(2 * SECOND)
        case "stop":
            here.stop(repeated_ns)
        case "console_stop":
            here.stop_at_console()
        case "no_position":
            here.no_position = not here.no_position
        case "stall":
            here.devices[nodes[0]].stands_still = True
        case "go_on":
            for device in here.devices.values():
                device.stands_still = False
        case "kill":
            here.devices[nodes[0]].is_dead = True
        case "start":
            for device in here.devices.values():
                if device.is_dead:
                    device.start()
        case "withdraw":
            here.withdraw()
        case "cut":
            here.is_linked = not here.is_linked


Order = list[tuple[int, tuple[str, ...]]]


def in_order(here: World, before: Order, after: Order, repeated_ns: int) -> None:
    """Take the actions, with a last emergency stop between them, until nobody sends any more."""
    for gap_ms, action in before:
        act(here, action, repeated_ns)
        here.run(gap_ms * MS)
    here.stop(repeated_ns)
    for gap_ms, action in after:
        here.run(gap_ms * MS)
        act(here, action, repeated_ns)
    here.no_position, here.is_linked = False, True
    here.run(repeated_ns)
    here.go_on()
    end_ns = here.clock.monotonic_ns() + LONGEST_NS
    here.run(SECOND)
    while here.clients and here.clock.monotonic_ns() < end_ns:
        here.run(200 * MS)
    # a launcher that was started after another stop of before waits for a person; it would have given up at the last
    assert here.clients == []


class Surroundings(NamedTuple):
    """How long a stop is repeated, and how long the way is [ms]; the rest is of `World` and of the end."""

    repeated_ms: int
    way_ms: int
    inlet_first: bool
    hears_stops: bool
    armed_again: bool


def check(before: Order, after: Order, around: Surroundings) -> None:
    options = {"inlet_first": around.inlet_first, "hears_stops": around.hears_stops}
    with world(way_ns=around.way_ms * MS, **options) as here:
        in_order(here, before, after, around.repeated_ms * MS)
        assert here.modes() == STOPPED
        if not around.armed_again:
            return
        # a person who sees that they are stopped, and arms them
        here.run(1500 * MS)
        client = here.arm()
        while here.clients:
            here.run(200 * MS)
        here.run(200 * MS)
        assert client.failure == ""
        assert here.modes() == ARMED
        assert not any(device.kept.exists() for device in here.devices.values())


SURROUNDINGS = st.builds(
    Surroundings,
    st.sampled_from([200, 1000, 5000]),
    st.sampled_from([0, 100, 400]),
    st.booleans(),
    st.booleans(),
    st.booleans(),
)
ORDERS = given(BEFORE, st.one_of(AFTER, AT_ONCE), SURROUNDINGS)
QUIET = [HealthCheck.too_slow, HealthCheck.data_too_large]


@pytest.mark.check("eighty drawn orders take 6 s")
@settings(max_examples=80, deadline=None, derandomize=True, suppress_health_check=QUIET)
@ORDERS
def test_whatever_came_before_an_emergency_stop_leaves_both_devices_latched(
    before: Order, after: Order, around: Surroundings
) -> None:
    check(before, after, around)


@pytest.mark.endurance
@pytest.mark.timeout(3600)
@settings(max_examples=1000, deadline=None, suppress_health_check=QUIET)
@ORDERS
def test_a_thousand_orders_leave_both_devices_latched(before: Order, after: Order, around: Surroundings) -> None:
    check(before, after, around)


MOVES = st.lists(st.tuples(GAPS_MS, st.one_of(ARMS, STALLS)), min_size=1, max_size=14)


@pytest.mark.check("eighty drawn orders take 3 s")
@settings(max_examples=80, deadline=None, derandomize=True, suppress_health_check=QUIET)
@given(MOVES, SURROUNDINGS)
def test_a_tip_follows_no_hand_that_is_not_armed_and_fresh(moves: Order, around: Surroundings) -> None:
    """`World` asserts it at each step, of the state of the hand itself."""
    options = {"inlet_first": around.inlet_first, "hears_stops": around.hears_stops}
    with world(way_ns=around.way_ms * MS, **options) as here:
        for gap_ms, action in moves:
            act(here, action, around.repeated_ms * MS)
            here.run(gap_ms * MS)


def test_an_armed_tip_waits_for_the_hand_whoever_is_armed_first() -> None:
    for order in ((TIP, HAND), (HAND, TIP)):
        with world() as here:
            here.arm(order[0])
            here.run(3 * SECOND)
            assert here.modes() == {TIP: "retracted", HAND: "free"}
            here.arm(order[1])
            here.run(SECOND)
            assert here.modes() == ARMED


def test_a_tip_that_is_armed_while_the_hand_is_in_emergency_stop_stays_withdrawn() -> None:
    with world() as here:
        here.arm()
        here.run(SECOND)
        here.stop(5 * SECOND)
        here.run(3 * SECOND)
        client = here.arm(TIP)
        here.run(10 * SECOND)
        assert (client.failure, here.modes()) == ("", {TIP: "retracted", HAND: "estop"})
        here.arm(HAND)
        here.run(SECOND)
        assert here.modes() == ARMED


INLETS = pytest.mark.parametrize("inlet_first", [True, False])
HEARING = pytest.mark.parametrize("hears_stops", [True, False])


@INLETS
@HEARING
@pytest.mark.parametrize(("held_up_ms", "stop_after_ms"), [(3000, 1000), (800, 400)])
def test_an_arm_that_waited_in_a_stopped_instrument_does_not_undo_a_later_stop(
    held_up_ms: int, stop_after_ms: int, inlet_first: bool, hears_stops: bool
) -> None:
    with world(inlet_first=inlet_first, hears_stops=hears_stops) as here:
        here.run(200 * MS)
        here.devices[TIP].stands_still = True
        client = here.arm(TIP)
        here.run(stop_after_ms * MS)
        here.stop(5 * SECOND)
        here.run((held_up_ms - stop_after_ms) * MS)
        here.go_on()
        here.run(LONGEST_NS)
        assert here.modes() == STOPPED
        # armed before the stop, or given up
        assert client.failure == "" or (client.void and "emergency stop" in client.failure)


@INLETS
@HEARING
def test_a_launcher_that_tries_anew_gives_up_at_a_stop(inlet_first: bool, hears_stops: bool) -> None:
    with world(inlet_first=inlet_first, hears_stops=hears_stops) as here:
        # no position to follow for the first two seconds, so that the tip is not placed until then
        here.no_position = True
        here.run(200 * MS)
        launcher = here.arm(launcher=True)
        here.run(SECOND)
        here.stop(5 * SECOND)
        here.run(SECOND)
        here.no_position = False
        here.run(LONGEST_NS)
        assert here.modes() == STOPPED
        assert launcher.void
        assert "emergency stop" in launcher.failure


def test_a_launcher_does_not_release_a_stop_from_before_its_session() -> None:
    with world() as here:
        here.stop(5 * SECOND)
        here.run(3 * SECOND)
        launcher = here.arm(launcher=True)
        here.run(30 * SECOND)
        assert here.modes() == STOPPED
        assert (launcher.failure, launcher.latched) == ("", HAND)
        # a person releases both, and the launcher goes on
        here.arm()
        here.run(3 * SECOND)
        assert here.clients == []
        assert launcher.failure == ""
        assert here.modes() == ARMED
        # and one that waits gives up at a stop
        here.stop(5 * SECOND)
        here.run(3 * SECOND)
        launcher = here.arm(launcher=True)
        here.run(2 * SECOND)
        here.stop(5 * SECOND)
        here.run(3 * SECOND)
        assert launcher.void
        assert here.modes() == STOPPED


def test_a_device_that_was_stopped_and_armed_before_the_session_is_armed_by_a_launcher() -> None:
    with world() as here:
        here.stop(5 * SECOND)
        here.run(3 * SECOND)
        here.arm()
        here.run(SECOND)
        # at the end of that session
        here.withdraw()
        here.run(SECOND)
        assert here.modes() == {TIP: "retracted", HAND: "free"}
        assert here.arm(launcher=True).failure == ""
        here.run(SECOND)
        assert here.modes() == ARMED


@pytest.mark.parametrize("waited_ms", [0, 700])
def test_a_command_that_waited_for_its_turn_is_as_old_as_the_wish(waited_ms: int) -> None:
    with world() as here:
        here.stop(5 * SECOND)
        here.run(500 * MS)
        client = here.arm(waited_ns=waited_ms * MS)
        here.run(SECOND)
        assert client.void == (waited_ms > 500)
        assert here.modes() == (STOPPED if client.void else ARMED)


def test_a_device_that_stood_still_for_longer_than_the_stop_was_repeated_latches_before_it_obeys() -> None:
    with world() as here:
        here.arm()
        here.run(SECOND)
        assert here.modes() == ARMED
        here.devices[TIP].stands_still = True
        here.run(100 * MS)
        here.stop(5 * SECOND)
        here.run(8 * SECOND)
        here.go_on()
        here.run(40 * MS)
        assert here.modes() == STOPPED
        assert [e.text for e in here.heard if e.src == TIP and "was kept" in e.text]


@pytest.mark.parametrize("stopped_first", [True, False])
def test_a_device_that_is_killed_comes_back_latched_whether_it_knew_of_the_stop(stopped_first: bool) -> None:
    with world() as here:
        here.arm()
        here.run(SECOND)
        if stopped_first:
            here.stop(5 * SECOND)
            here.run(200 * MS)
        here.devices[TIP].is_dead = here.devices[HAND].is_dead = True
        here.run(200 * MS)
        if not stopped_first:
            here.stop(200 * MS)
            here.run(SECOND)
        here.go_on()
        here.run(80 * MS)
        assert here.modes() == STOPPED


def test_a_quotation_of_an_earlier_run_is_none_of_this_one() -> None:
    with world() as here:
        here.stop(5 * SECOND)
        here.run(SECOND)
        old = here.devices[TIP].loop._commands.latch.quotation
        here.devices[TIP].is_dead = True
        here.run(40 * MS)
        here.go_on()
        here.run(200 * MS)
        new = here.devices[TIP].loop._commands.latch.quotation
        # a count alone would be the same
        old = f"{old.partition('-')[0]}-{new.partition('-')[2]}"
        for number, quoted in enumerate((old, new)):
            quotes = {"validity_s": 1.0, "node_latch": {TIP: quoted}}
            here.send("console@master")(
                "session/control", id=f"x{number}", command="arm", target=TIP, parameters={}, **quotes
            )
            here.run(200 * MS)
            # it is armed, and waits for the hand, which is stopped
            assert here.devices[TIP].mode == ("retracted" if quoted == new else "estop")


def test_an_arm_that_was_carried_out_is_not_said_to_be_in_force_after_a_stop() -> None:
    with world() as here:
        fields = {"id": "once", "command": "arm", "target": TIP, "parameters": {}}
        here.send("console@master")("session/control", **fields)
        here.run(200 * MS)
        here.stop(5 * SECOND)
        here.run(200 * MS)
        here.send("console@master")("session/control", **fields)
        here.run(200 * MS)
        assert [event.kind for event in here.heard if event.id == "once"] == ["ack", "refused"]
        assert here.modes() == STOPPED


def test_a_program_of_the_instrument_is_a_wish_to_move() -> None:
    with world() as here:
        here.stop(5 * SECOND)
        here.run(SECOND)
        here.arm(TIP)
        here.run(SECOND)
        here.withdraw()
        here.run(SECOND)
        # issued before the stop, by who quotes nothing
        fields = {"id": "scan", "command": "set", "target": TIP, "parameters": {"program": "curve"}}
        here.send("console@master")("session/control", **fields)
        here.run(SECOND)
        (refused,) = [event for event in here.heard if event.id == "scan"]
        assert refused.text.startswith("set is refused: it does not refer to the newest emergency stop, which came ")
        assert here.devices[TIP].mode == "retracted"
