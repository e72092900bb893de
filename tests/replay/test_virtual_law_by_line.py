"""A law by the line in virtual time: nodes change their law by what the line does, and the hand feels nothing of it."""

from typing import Any

import numpy as np
import pytest
from telenano_laws import by_line
from telenano_laws.by_line import HAND, MASTER, SLAVE, TIP, Candidate, Policy
from telenano_laws.by_line_command import carry_out

from telenano.runtime import Command
from telenano.sections import ControllerConfig
from telenano.virtual import VirtualRig

WATCHED = (("law/status", MASTER), ("node/health", MASTER), ("node/health", SLAVE), ("haptic/state", HAND))
TURN_S, DWELL_S = 0.1, 2.0
# an arm that leans on the tip: it is where its force is 1.1 N
ARM = {"kind": "impedance", "stiffness_n_per_m": 300.0, "damping_n_s_per_m": 10.0, "mass_kg": 0.5}
PATH = [{"time_s": 0.1, "position_m": 0.0}, {"time_s": 0.5, "position_m": 4e-3}]


def course(
    lines: list[tuple[str, float]], law: str, stiffness_n_per_m: float, monkeypatch: pytest.MonkeyPatch
) -> tuple[VirtualRig, list[tuple[float, str]]]:
    """Run over one line after the other; return the rig, and when which law was set [s]."""
    scenario = {
        "name": "course",
        "description": "the line changes under an arm that leans on the tip",
        "duration_s": 60.0,
        "haptic_node": {"operator": {**ARM, "path": PATH}},
        "controller": {"law": law},
        "delay_node": {"profile": lines[0][0], "seed": 1},
        "afm_node": {"environment": "spring", "spring": {"stiffness_n_per_m": stiffness_n_per_m}},
    }
    rig = VirtualRig(None, 1, (), scenario=scenario, counts_inputs=True)
    wanted = [Candidate("bounded_model"), Candidate("passivity")]
    policy = Policy(ControllerConfig(), stiffness_n_per_m, wanted, window_s=1.5)
    done: list[tuple[float, str]] = []
    seen, now_s = dict.fromkeys(WATCHED, 0), 0.9
    rig.run_until(0.45)
    rig.command("arm", "*", place="hand")
    rig.run_until(now_s)
    rig.command("start", "haptic_node")

    def send(command: Command) -> str:
        if command.name == "set":
            rig.command(command.name, command.target, **command.parameters)
            done.append((now_s, str(command.parameters["law"])))
        return ""

    for line, until_s in lines:
        if line != lines[0][0]:
            rig.command("set", "delay_node", profile=line)
        while now_s < until_s:
            now_s += TURN_S
            rig.run_until(now_s)
            new = [(message, *at) for at in WATCHED for message in rig.received(*at)[seen[at] :]]
            seen = {at: len(rig.received(*at)) for at in WATCHED}
            for message, topic, src in sorted(new, key=lambda row: int(row[0].t_ns)):
                decision = policy.take(topic, src, 1e-9 * message.t_ns, message)
                if decision is not None:
                    carry_out(policy, decision, send)
    return rig, done


def after(rig: VirtualRig, topic: str, src: str, first_ns: int) -> list[Any]:
    return [message for message in rig.received(topic, src) if message.t_ns >= first_ns]


@pytest.mark.check("five seconds of a rig in virtual time")
def test_the_law_changes_under_an_arm_without_a_jump(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(by_line, "DWELL_S", DWELL_S)
    rig, done = course([("leo_satellite", 4.5)], "passivity", 20.0, monkeypatch)
    try:
        ((_, law),) = done
        assert law == "bounded_model"
        statuses = {half: rig.received("law/status", half) for half in (MASTER, SLAVE)}
        assert all(some[-1].law == law and not some[-1].switching for some in statuses.values())
        begin_ns = next(one.t_ns for one in statuses[MASTER] if one.switching)
        hands, tips = after(rig, "haptic/state", HAND, begin_ns), after(rig, "afm/state", TIP, begin_ns)
        assert {hand.mode for hand in hands} == {"position"} and {tip.mode for tip in tips} == {"follow"}
        places, forces = (
            np.array([value[2] for value in row])
            for row in zip(*((hand.position_m, hand.operator_force_n) for hand in hands), strict=True)
        )
        shown = np.array([one.force_n[2] for one in after(rig, "haptic/command", MASTER, begin_ns)])
        force = abs(forces[0])
        assert force > 0.5
        # Over the change and the second after it: place of the hand, its force, and the force that it is shown.
        assert np.ptp(places) < 1e-4 and np.ptp(forces) < 0.05 * force
        assert np.abs(np.diff(shown)).max() < 0.05 * force
    finally:
        rig.close()
