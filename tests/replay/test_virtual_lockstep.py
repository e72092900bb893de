"""The nodes on a virtual bus and the lockstep loop of the studies give the same session, tick by tick.

The bus has one constant delay on the link, 1 us on a site, and nothing that is late, lost or repeated unless a test
says so. How the two are aligned:

- Tick n of lockstep is the haptic/state number n + 1. On the bus the instrument is armed one tick later, because the
  guard refuses to arm before a position command has come, while lockstep arms with the first one; and a hand moves the
  tip from the tick on after an answer has reached it, which takes a round trip. Nothing else depends on the absolute
  tick, so the session of the bus starts as many ticks later and the rest is shifted by that.
- The command `start` takes effect at the next tick of the hand, which is session time 1 ms; lockstep begins at 0 ms,
  when the hand's force is still zero. What both have is compared: session times from 1 ms on.
- Values of the tip are those at the end of the tick: the last afm/state sent before the next haptic/state.
- A link delay of whole periods and a few transits on a site bring a message into the tick at whose very beginning it
  arrives in lockstep. On both sides the hand is sampled before that. The half period that `studies.md` adds to a
  delay is the hold of the law's integration, which is the same code here and there.

The arm is placed 1 ns before the second position command, so that the base moves for 1 ms - 1 ns and then 1 ns where
lockstep makes one step of 1 ms. In the spring's environment the base does not move then; in the contact the sum
of the two differs from the one step by rounding.

Without any delay the first command of lockstep comes at the time at which its instrument starts, so that the step in
which it is armed lasts 1 ns and its approach begins one tick late: 1e-5 of the force in the contact, whose approach is
still decaying in the session, and nothing on the spring, where there is none. So the contact is compared over a link of
4 ms, and the spring without delay.
"""

import dataclasses
from collections.abc import Callable, Collection, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from telenano_lab.studies.loops.cells import Cell, rig_of
from telenano_lab.studies.loops.links import symmetric_link
from telenano_lab.studies.loops.validate import read_course, scenario_of
from tried_laws import TRIED_LAWS

from services.afm_node import node as afm_node
from services.controller.slave_half import SlaveController
from services.haptic_node.node import HapticNode
from telenano.afm.safety import MODE_FOLLOW, MODE_HOLD
from telenano.extend.laws import LONGEST_BRIDGED_PERIODS
from telenano.lockstep.link import Schedule
from telenano.lockstep.trajectory import Trajectory
from telenano.sections.controller_section import LAWS, ControllerConfig
from telenano.virtual import EPOCH_OFFSET_NS, VirtualRig, constant_timing
from telenano.wire import Message, encode
from telenano.wire.messages import AfmCommand, SessionControl, TeleopForward

PERIOD_S = ControllerConfig().period_s
PERIOD_NS = round(PERIOD_S * 1e9)
SEED = 7
# before the session: time to arm, and to approach from 100 nm at 2 um/s
SETTLE_TICKS = 150
# the tip is pressed down and lifted off again
HAND_POINTS = ((0.02, 0.0), (0.2, 2.0), (0.8, 2.0), (0.9, 0.0))
SESSION_S = 1.0
# the first tick that is lost, in lockstep's ticks, and how many; during the press, a pause that is just bridged and one
# that just is not
Lost = tuple[tuple[int, int], ...]
FIRST_PAUSE, SECOND_PAUSE = SETTLE_TICKS + 300, SETTLE_TICKS + 550
BOTH_PAUSES: Lost = ((FIRST_PAUSE, LONGEST_BRIDGED_PERIODS - 1), (SECOND_PAUSE, LONGEST_BRIDGED_PERIODS))
STIFFNESS_N_PER_M = {"spring": 20.0, "tip_sample": 40.0}

SERIES = (
    "time_s",
    "hand_force_n",
    "hand_position_m",
    "reference_m",
    "rendered_force_n",
    "base_position_m",
    "tip_force_n",
    "separation_m",
    "in_contact",
    "instrument_mode",
    "hand_following",
)
# Greatest difference as a share of the greatest value. On the spring the two agree to the bit; over the contact the sum
# of two steps of the base instead of one is other by rounding.
TOLERANCE = {"spring": 0.0, "tip_sample": 1e-12}


class ConstantRig(VirtualRig):
    """A virtual rig that arms the instrument at its first chance, and whose link loses some forward signals."""

    lost: Collection[int] = ()
    _armed = False

    def __init__(self, *arguments: Any, **options: Any) -> None:
        super().__init__(*arguments, **options)
        # The hand of a lockstep is armed from the first tick on.
        hand = self.loops["haptic_node@master"].node
        assert isinstance(hand, HapticNode)
        hand._memory.guard = hand._memory.guard._replace(armed=True)

    def carry(self, topic: str, message: Message, payload: bytes, sent_ns: int) -> None:
        """Bring a message to its readers, and arm the AFM 1 ns before the command that follows the first position."""
        if isinstance(message, TeleopForward) and message.hand_seq in self.lost:
            return
        super().carry(topic, message, payload, sent_ns)
        if isinstance(message, AfmCommand) and message.mode == "position" and not self._armed:
            self._armed = True
            arm = _arm(message.t_ns)
            armed_ns = message.t_ns - EPOCH_OFFSET_NS + PERIOD_NS - 1
            self._deliver("launcher@slave", "afm_node@slave", "session/control", encode(arm), armed_ns, arm)


def _arm(t_ns: int) -> SessionControl:
    return SessionControl(
        seq=0,
        t_ns=t_ns,
        src="launcher@slave",
        v=SessionControl.version,
        id="arm",
        command="arm",
        target="afm_node",
        parameters={"place": "hand"},
    )


def cell_of(law: str, environment: Any, round_trip_ms: float) -> Cell:
    stiffness = STIFFNESS_N_PER_M[environment]
    return Cell(law=law, environment=environment, round_trip_ms=round_trip_ms, stiffness_n_per_m=stiffness, seed=SEED)


def on_bus(cell: Cell, folder: Path, lost: Lost = (), settings: Sequence[str] = ()) -> Trajectory:
    """Run the nodes of a cell on the virtual bus and read the recording."""
    timing = constant_timing(round(0.5e6 * cell.round_trip_ms))
    rig = ConstantRig(folder, cell.seed, settings, timing, with_hand(cell))
    later = ticks_later(cell)
    rig.lost = {tick + later for first, count in lost for tick in range(first, first + count)}
    return course_of(rig, later)


def with_hand(cell: Cell) -> dict[str, Any]:
    """Return the scenario of a cell with the hand of these tests."""
    scenario = scenario_of(cell)
    points = [{"time_s": time, "force_n": force} for time, force in HAND_POINTS]
    scenario["haptic_node"]["operator"]["points"] = points
    return scenario


def ticks_later(cell: Cell) -> int:
    """Return how many ticks later than in lockstep the instrument of the bus follows."""
    return 2 + round(1e-3 * cell.round_trip_ms / PERIOD_S)


def course_of(rig: ConstantRig, later: int = 1) -> Trajectory:
    """Run the session of a rig to its end and read the recording."""
    started_s = (SETTLE_TICKS + 1 + later) * PERIOD_S
    rig.run_until(started_s)
    rig.command("start", "haptic_node")
    rig.run_until(started_s + SESSION_S)
    return read_course(rig.finish())


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory: pytest.TempPathFactory) -> Callable[[Cell], Trajectory]:
    """The session of a cell on the bus, run once."""
    made: dict[Cell, Trajectory] = {}

    def session(cell: Cell) -> Trajectory:
        if cell not in made:
            made[cell] = on_bus(cell, tmp_path_factory.mktemp("session"))
        return made[cell]

    return session


def in_lockstep(cell: Cell, lost: Lost = (), **guard: float) -> Trajectory:
    """Run the same cell in lockstep; `guard`: limits of the instrument that are not the cell's."""
    ticks = SETTLE_TICKS + round(SESSION_S / PERIOD_S)
    schedule = Schedule.of(symmetric_link(1e-3 * cell.round_trip_ms, 0.0, 0.0, cell.seed), ticks, PERIOD_S)
    kept = np.ones(len(schedule.forward_of), dtype=bool)
    for first, count in lost:
        kept &= (schedule.forward_of < first) | (schedule.forward_of >= first + count)
    schedule = schedule._replace(
        forward_ns=schedule.forward_ns[kept],
        forward_of=schedule.forward_of[kept],
        # with a constant delay the k-th answer is that to the k-th arrival
        backward_ns=schedule.backward_ns[kept],
        backward_of=np.arange(int(kept.sum()), dtype=np.int64),
    )
    rig = rig_of(cell, HAND_POINTS)
    instrument = rig.instrument._replace(safety=rig.instrument.safety._replace(**guard))
    return dataclasses.replace(rig, instrument=instrument).run(schedule, SETTLE_TICKS)


def common(bus: Trajectory, expected: Trajectory, name: str) -> tuple[npt.NDArray[Any], npt.NDArray[Any]]:
    """Return a series of both for the session times that both have; those are the same to the bit (tested)."""
    last_s = min(bus.time_s[-1], expected.time_s[-1])
    parts = [(run.time_s >= PERIOD_S) & (run.time_s <= last_s) for run in (bus, expected)]
    return getattr(bus, name)[parts[0]], getattr(expected, name)[parts[1]]


def differences(bus: Trajectory, expected: Trajectory) -> dict[str, float]:
    """Return, for the series that differ, the greatest difference as a share of the greatest value."""
    found = {}
    for name in SERIES:
        of_bus, of_lockstep = (values.astype(np.float64) for values in common(bus, expected, name))
        assert len(of_bus) == len(of_lockstep) == round(SESSION_S / PERIOD_S) - 1
        if not np.array_equal(of_bus, of_lockstep):
            found[name] = float(np.abs(of_bus - of_lockstep).max() / max(np.abs(of_lockstep).max(), 1e-300))
    return found


@pytest.mark.check("takes 8 s")
@pytest.mark.drawn(0.15)
@pytest.mark.usefixtures("loop")
@pytest.mark.parametrize(("environment", "round_trip_ms"), [("spring", 0.0), ("tip_sample", 4.0)])
@pytest.mark.grid(law="passivity")
@pytest.mark.parametrize("law", TRIED_LAWS)
def test_the_nodes_and_lockstep_agree(
    undisturbed: Callable[[Cell], Trajectory], law: str, environment: str, round_trip_ms: float
) -> None:
    cell = cell_of(law, environment, round_trip_ms)
    expected = in_lockstep(cell)
    found = differences(undisturbed(cell), expected)
    assert all(share <= TOLERANCE[environment] for share in found.values()), found
    # the session shows something of the law
    assert expected.in_contact.any()
    assert expected.tip_force_n.max() > 1.5e-8
    assert expected.hand_following.all()
    assert set(expected.instrument_mode) == {MODE_FOLLOW}


@pytest.mark.check("takes 1.1 s")
@pytest.mark.drawn(0.25, "telenano/lockstep/", "telenano/laws/", "services/controller/")
@pytest.mark.usefixtures("loop")
@pytest.mark.grid(law="passivity")
@pytest.mark.parametrize("law", TRIED_LAWS)
def test_they_agree_about_a_silent_link(tmp_path: Path, law: str) -> None:
    """Through the first pause the instrument steps by itself, and in the second one it holds."""
    cell = cell_of(law, "spring", 4.0)
    expected = in_lockstep(cell, BOTH_PAUSES)
    found = differences(on_bus(cell, tmp_path, BOTH_PAUSES), expected)
    # In a step that a slave half with a loop of its own adds, the base moves for the 2 us that the site takes here, and
    # for 1 ns in lockstep: 0.0037 of the greatest value was measured, with `wave`.
    assert all(share < (0.005 if LAWS[law].local_loop else 0.0 + 1e-300) for share in found.values()), found
    held_s = expected.time_s[expected.instrument_mode == MODE_HOLD]
    # a slave half with a loop of its own has gone on for as long as its last signal counted
    assert (held_s.size == 0) == LAWS[law].local_loop
    assert (held_s > (SECOND_PAUSE - SETTLE_TICKS) * PERIOD_S).all()


@pytest.mark.check("takes 1.6 s")
@pytest.mark.drawn(0.27, "telenano/lockstep/", "telenano/laws/", "services/controller/")
@pytest.mark.usefixtures("loop")
@pytest.mark.grid(law="passivity")
@pytest.mark.parametrize("law", TRIED_LAWS)
def test_a_changed_gain_is_seen(undisturbed: Callable[[Cell], Trajectory], law: str) -> None:
    """One per cent of a law's force gain, or where it has none of its force scale, is no rounding."""
    cell = cell_of(law, "spring", 0.0)
    section = cell.controller().law_config()
    name = "force_gain" if hasattr(section, "force_gain") else "force_scale"
    changed = cell.model_copy(update={"settings": ((f"{law}.{name}", 1.01 * getattr(section, name)),)})
    found = differences(undisturbed(cell), in_lockstep(changed))
    assert found["hand_position_m"] > 1e-4
    assert found["tip_force_n"] > 1e-4


@pytest.mark.check("takes 1.1 s")
@pytest.mark.usefixtures("plain_loop")
def test_a_changed_longest_pause_is_seen(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Where the slave half has a memory: one that starts anew at every signal begins without energy to press."""
    cell = cell_of("passivity", "spring", 4.0)
    pause = ((FIRST_PAUSE, 10),)
    expected = in_lockstep(cell, pause)
    timing = cell.controller().slave_timing()._replace(longest_periods=1)
    monkeypatch.setattr(SlaveController, "timing_of", lambda node, config: timing)
    assert differences(on_bus(cell, tmp_path, pause), expected)


@pytest.mark.check("takes 1.9 s")
def test_a_changed_wait_of_the_instrument_is_seen(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """With its own steps half a period later, the instrument finds the silence too long one tick later."""
    cell, lost = cell_of("virtual_impedance", "spring", 4.0), ((FIRST_PAUSE, LONGEST_BRIDGED_PERIODS + 1),)
    # a limit that falls between the two places of a step in its tick
    deadline_s = (LONGEST_BRIDGED_PERIODS + 0.4) * PERIOD_S
    settings = [f"afm_node.safety.command_deadline_s={deadline_s}"]
    expected = in_lockstep(cell, lost, command_deadline_s=deadline_s)
    assert differences(on_bus(cell, tmp_path / "same", lost, settings), expected) == {}
    monkeypatch.setattr(afm_node, "command_wait_ns", lambda period_ns: 2 * period_ns)
    assert "instrument_mode" in differences(on_bus(cell, tmp_path, lost, settings), expected)
