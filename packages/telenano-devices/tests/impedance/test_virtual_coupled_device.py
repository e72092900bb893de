"""A device that takes a force behind the real nodes, in virtual time: ratio, places, energy, and what takes the force.

An arm presses with 2 N, as in the second hold of Fig. 12, and is held there; the session of Fig. 12 as a whole is in
`test_impedance_lockstep.py`.
"""

import itertools
from typing import Any

import pytest
from telenano_devices.impedance.impedance import coupling_of

from telenano.sections import HapticConfig
from telenano.virtual import ARMED_S, STARTED_S, VirtualRig, constant_timing
from telenano.wire import HapticState, SessionEvent

HAND = "haptic_node@master"
# alpha_f F_s (1 + 1/K_f) = F_m, as on the paper's master
HOLD_RATIO = 1.05
# where an ordinary arm of 300 N/m means to be, so that it presses with 2 N
ARM_N_PER_M, MEANT_M = 300.0, 0.0182
SCENARIO = {
    "name": "coupled",
    "description": "a hand presses the tip onto mica through a virtual coupling",
    "duration_s": 60.0,
    "haptic_node": {
        "driver": "simulated_impedance",
        "coupling": {"rest_s": 0.05},
        "impedance": {"lateral_path": [{"time_s": 0.1, "x_m": 0.0}, {"time_s": 0.3, "x_m": 0.004, "y_m": -0.002}]},
        "operator": {
            "kind": "impedance",
            "path": [{"time_s": 0.05, "position_m": 0.0}, {"time_s": 0.3, "position_m": MEANT_M}],
        },
    },
    "afm_node": {"rest_distance_m": 10.0e-9},
}
CONFIG = HapticConfig.model_validate_json(
    '{"driver": "simulated_impedance", "coupling": {"rest_s": 0.05}, "operator": {"kind": "force_profile"}}'
)
DECLARED = CONFIG.to_simulated_hand().capabilities
COUPLING = coupling_of(CONFIG).to_settings(DECLARED)
K_N_PER_M = COUPLING.stiffness_n_per_m[2]


class Session:
    """A rig whose hand presses, and what its haptic node says."""

    def __init__(self, scenario: dict[str, Any]) -> None:
        self.rig = VirtualRig(None, 1, (), constant_timing(10_000), scenario)
        self.rig.run_until(ARMED_S)
        self.rig.command("arm", "*", place="hand")
        self.rig.run_until(STARTED_S)
        self.rig.command("start", "*", self.states()[-1])

    def states(self) -> list[HapticState]:
        return self.rig.received("haptic/state", HAND)

    def events(self) -> list[SessionEvent]:
        return [event for event in self.rig.received("session/event", HAND) if event.kind in ("mode", "fault")]

    def at(self, time_s: float) -> HapticState:
        self.rig.run_until(STARTED_S + time_s)
        return self.states()[-1]


def test_hold_and_place_are_those_of_theory_and_what_takes_the_force_is_said_in_one_event(
    request: pytest.FixtureRequest,
) -> None:
    session = Session(SCENARIO)
    request.addfinalizer(session.rig.close)
    first = session.rig.received("session/event", HAND)[0]
    assert "simulated inverse3" in first.text and "stable up to" in first.text
    hold = session.at(0.85)
    tip = session.rig.received("afm/state", "afm_node@slave")[-1]
    force_n, place_m, reference_m = -hold.operator_force_n[2], -hold.position_m[2], -hold.reference_m[2]
    assert hold.mode == "position"
    # The estimate is the hand's force, and the hand stands F / K beyond the reference of the law.
    assert force_n == pytest.approx(ARM_N_PER_M * (MEANT_M - place_m), rel=1e-3, abs=0.0)
    assert force_n == pytest.approx(2.0, rel=0.05, abs=0.0)
    assert force_n / (1e8 * tip.tip_force_n[2]) == pytest.approx(HOLD_RATIO, rel=0.005, abs=0.0)
    assert place_m == pytest.approx(reference_m + force_n / K_N_PER_M, rel=0.001, abs=0.0)
    # The tip is where the law's reference puts it, as on the paper's master.
    assert -tip.base_position_m[2] == pytest.approx(1.5e-6 * reference_m, rel=1e-3, abs=0.0)
    # the hand goes its way over the sample, and is felt there no harder than the damper is
    assert hold.position_m[:2] == pytest.approx((0.004, -0.002), rel=1e-3)
    assert hold.orientation is None and hold.buttons is None
    # The spring of the coupling holds its energy, the damper has the rest; none was made.
    energies = [state.coupling_energy_j for state in session.states()]
    assert energies[-1] > 0.5 * force_n**2 / K_N_PER_M * 0.99
    assert min(energy for energy in energies if energy is not None) > -1e-9
    _change_of_law(session)
    _jump(session)


def _change_of_law(session: Session) -> None:
    """The force is zero for a tenth of a second, and comes back without a jump where the hand is."""
    session.rig.command("set", "controller", session.states()[-1], law="position_force")
    session.at(0.86)
    before = len(session.states())
    assert session.at(0.94).mode == "off"
    assert all(state.motor_force_n == (0.0, 0.0, 0.0) for state in session.states()[before:])
    assert [event.text for event in session.events()].count(
        "the law changes: no force meanwhile, and control begins again where the hand is"
    ) == 1
    assert session.at(1.3).mode == "position"
    forces = [state.motor_force_n[2] for state in session.states()[before:]]
    slew = COUPLING.max_slew_n_per_s
    assert max(abs(b - a) for a, b in itertools.pairwise(forces)) <= slew * 1e-3 * (1.0 + 1e-9)
    # The arm has come to where it meant to be, and the tip stayed: what presses now is what it moves from there.
    assert forces[-1] > 0.1


def _jump(session: Session) -> None:
    """A lost encoder: hand without force and off at once, tip left where it is, until a person arms."""
    device: Any = session.rig.loops[HAND].node.device
    plant = device.state.plant
    x, y, z = plant.position_m
    device.state.plant = plant._replace(position_m=(x + 0.01, y, z))
    counted = len(session.events())
    found = session.at(1.33)
    base_m = session.rig.received("afm/state", "afm_node@slave")[-1].base_position_m[2]
    assert found.mode == "off" and found.motor_force_n == (0.0, 0.0, 0.0)
    assert [event.text for event in session.events()[counted:]] == [
        "the device is refused until armed: its position jumped, as that of a lost encoder does"
    ]
    assert session.at(1.4).mode == "off"
    assert session.rig.received("afm/state", "afm_node@slave")[-1].base_position_m[2] == pytest.approx(
        base_m, abs=1e-12
    )
    session.rig.command("arm", "haptic_node", session.states()[-1])
    # The tip was held for a hand that is not armed, and is withdrawn: it stays until a person arms it as well.
    assert session.at(1.6).mode == "off"
    tip = session.rig.received("afm/state", "afm_node@slave")[-1]
    assert tip.mode == "retracted"
    session.rig.command("arm", "afm_node", tip)
    assert session.at(1.8).mode == "position"


@pytest.mark.parametrize(
    "law",
    [
        "virtual_impedance",
        *(
            pytest.param(law, marks=pytest.mark.endurance)
            for law in ("position_force", "wave", "passivity", "model_mediated", "smith")
        ),
    ],
)
def test_tip_of_a_hand_that_is_lost_holds_and_is_withdrawn_as_after_the_death_of_its_node(
    law: str, request: pytest.FixtureRequest
) -> None:
    session = Session({**SCENARIO, "controller": {"law": law}})
    request.addfinalizer(session.rig.close)
    assert session.at(0.6).mode == "position"
    before = len(session.rig.received("afm/state", "afm_node@slave"))
    place_m = session.rig.received("afm/state", "afm_node@slave")[-1].base_position_m[2]
    plant = session.rig.loops[HAND].node.device.state  # type: ignore[attr-defined]
    plant.plant = plant.plant._replace(position_m=(0.0, 0.0, plant.plant.position_m[2] + 0.01))
    lost = session.at(1.3)
    assert (lost.device, lost.mode, lost.motor_force_n) == ("lost", "off", (0.0, 0.0, 0.0))
    tips = session.rig.received("afm/state", "afm_node@slave")[before:]
    assert [mode for mode, _ in itertools.groupby(tip.mode for tip in tips)] == [
        "follow",
        "hold",
        "retracting",
        "retracted",
    ]
    # 50 ms without a command, 200 ms of hold; the slave half of some laws goes on by itself for a while
    held = [tip for tip in tips if tip.mode == "hold"]
    assert 197 <= len(held) <= 320
    assert {tip.base_position_m[2] for tip in held} == {held[0].base_position_m[2]}
    assert held[0].base_position_m[2] == pytest.approx(place_m, abs=3e-9)
    texts = [event.text for event in session.rig.received("session/event", "afm_node@slave")]
    assert sum(text.startswith("the AFM is in mode hold: command_deadline") for text in texts) == 1, texts
    # Both may be armed once the hand has been silent for a second; the arm is now where it presses too hard.
    session.rig.command("arm", "*", session.at(1.7), place="hand")
    counts = len(session.states()), len(session.rig.received("afm/state", "afm_node@slave"))
    session.at(2.0)
    assert "position" in {state.mode for state in session.states()[counts[0] :]}
    assert "follow" in {tip.mode for tip in session.rig.received("afm/state", "afm_node@slave")[counts[1] :]}
