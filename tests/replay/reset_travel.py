"""How far tip and hand move after an emergency stop in contact, when both are armed and nobody touches the hand.

    python tests/replay/reset_travel.py [KEY=VALUE ...]

presses, lets go in contact, stops, arms with the parameters, waits, and prints the travel of both since the arming.
"""

import sys
from typing import Any

from telenano.virtual import ARMED_S, STARTED_S, VirtualRig
from telenano.wire.nodes import HAND, TIP

# A hand presses for half a second and then rests in contact [s, N].
PRESS = ((0.0, 0.0), (0.05, 2.4), (0.5, 2.4), (0.55, 0.0), (99.0, 0.0))
STOP_S, ARM_S, END_S = 1.2, 1.6, 4.6


def scenario(law: str) -> dict[str, Any]:
    """Return a scenario whose hand presses and then rests."""
    points = [{"time_s": time_s, "force_n": force_n} for time_s, force_n in PRESS]
    return {
        "name": "reset",
        "description": "A hand presses, and rests in contact",
        "duration_s": 60.0,
        "haptic_node": {"operator": {"kind": "force_profile", "points": points}},
        "controller": {"law": law},
        "afm_node": {"rest_distance_m": 10.0e-9},
    }


def base_m(state: Any) -> float:
    """Return the place of the base, towards the sample [m]."""
    return -float(state.base_position_m[2])


def main(words: list[str]) -> None:
    """Print the travel after an arming with these parameters."""
    pairs = dict(word.split("=", 1) for word in words)
    law = pairs.pop("law", "virtual_impedance")
    parameters = {key: float(value) if key.endswith(("_m", "_s")) else value for key, value in pairs.items()}
    rig = VirtualRig(None, 1, (), scenario=scenario(law))
    rig.run_until(ARMED_S)
    rig.command("arm", "*", place="hand")
    rig.run_until(STARTED_S)
    rig.command("start", "haptic_node")
    rig.run_until(STOP_S)
    pressed, hand = rig.received("afm/state", TIP)[-1], rig.received("haptic/state", HAND)[-1]
    sys.stdout.write(
        f"{law}: before the stop: base {1e9 * base_m(pressed):.2f} nm, in contact {pressed.in_contact}, "
        f"hand {-1e3 * hand.position_m[2]:.2f} mm\n"
    )
    rig.command("estop", "*")
    rig.run_until(ARM_S)
    tips, hands = len(rig.received("afm/state", TIP)), len(rig.received("haptic/state", HAND))
    quoted: dict[str, Any] = {}
    for number, node in enumerate((HAND, TIP)):
        rig.command("arm", node, **parameters)
        rig.run_until(ARM_S + 0.02 * (number + 1))
        refusal = rig.received("session/event", node)[-1]
        quoted[node] = {"node_latch": {node: refusal.data["latch"]}, "node_t_ns": {node: refusal.t_ns}}
    for node, quotation in quoted.items():
        fields = {"id": f"again-{node[:3]}", "command": "arm", "target": node, "parameters": parameters, **quotation}
        rig._launcher.publish("session/control", **fields)
    rig.run_until(END_S)
    states, samples = rig.received("afm/state", TIP)[tips:], rig.received("haptic/state", HAND)[hands:]
    bases = [base_m(state) for state in states]
    forces = [state.tip_force_n[2] for state in states]
    places = [-sample.position_m[2] for sample in samples]
    speeds = [abs(sample.velocity_m_per_s[2]) for sample in samples]
    sys.stdout.write(
        f"after arming with {parameters or 'no word'}: mode {states[-1].mode}, base {1e9 * bases[0]:.2f} nm to "
        f"{1e9 * bases[-1]:.2f} nm, nearest {1e9 * max(bases):.2f} nm; force {1e9 * min(forces):.2f} to "
        f"{1e9 * max(forces):.2f} nN; hand moved {1e3 * (max(places) - min(places)):.3f} mm at up to "
        f"{1e3 * max(speeds):.3f} mm/s\n"
    )
    rig.close()


if __name__ == "__main__":
    main(sys.argv[1:])
