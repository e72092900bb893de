"""Orders of stop, loss, restart, re-plug and arm, drawn by a seed: the tip goes nowhere by itself.

Each order is some events of a person, a machine or a cable, with times between them that are as long as what they meet:
a few milliseconds, a hold, a withdrawal. `reset_rig` judges the states of the devices.
"""

import random
from contextlib import closing

import pytest
from reset_rig import HAND, MASTER_HALF, SLAVE_HALF, TIP, ResetRig

from telenano.sections.controller_section import LAWS
from telenano.virtual import LINK_NODE

# The orders of one rig, which begins with the state that the one before has left.
ORDERS_OF_RIG = 20
WAITS_S = (0.004, 0.02, 0.06, 0.12, 0.3)
WORDS = ({}, {}, {}, {"place": "hand"}, {"place_m": 0.0}, {"place_m": -40e-9, "speed_m_per_s": 1e-6})


def _event(rig: ResetRig, draw: random.Random) -> str:
    """Let one thing happen; return what."""
    device = draw.choice((HAND, TIP))
    match draw.choice(
        ("estop", "arm", "arm", "arm", "press", "press", "lose", "halt", "restart", "stop", "set", "old arm")
    ):
        case "estop":
            target = draw.choice(("*", "*", HAND, TIP))
            rig.estop(target)
            return f"estop {target}"
        case "arm":
            targets = draw.choice(((HAND, TIP), (TIP, HAND), (TIP,), (HAND,)))
            word = draw.choice(WORDS)
            return f"arm {targets} {word}: {rig.arm(*targets, **word)}"
        case "old arm":
            return f"arm without a quotation: {rig.arm(device, quotes=False)}"
        case "press":
            force_n = draw.choice((-2.0, 0.4, 2.4))
            rig.press(draw.choice((0.05, 0.2)), force_n)
            return f"press {force_n}"
        case "lose":
            rig.lose(device, lost=True)
            rig.wait(draw.choice(WAITS_S))
            rig.lose(device, lost=False)
            return f"lose {device}"
        case "halt":
            key, time_s = draw.choice((HAND, TIP, MASTER_HALF, SLAVE_HALF, LINK_NODE)), draw.choice(WAITS_S)
            rig.halt(key, time_s)
            return f"halt {key} {time_s}"
        case "restart":
            key = draw.choice((HAND, TIP, MASTER_HALF, SLAVE_HALF))
            rig.kill(key)
            return f"restart {key}"
        case "stop":
            rig.command("stop", "afm_node")
            return "withdraw"
    changes = draw.choice(({"virtual_impedance.force_gain": 15.0}, {"clamp.enabled": True}))
    rig.command("set", "controller", **changes)
    return f"set {changes}"


def _orders(seed: int) -> None:
    """Carry out the orders of a rig, and judge each."""
    draw = random.Random(seed)
    law = draw.choice(list(LAWS))
    with closing(ResetRig(law, seed)) as rig:
        rig.begin()
        for number in range(ORDERS_OF_RIG):
            done = []
            for _ in range(draw.randint(3, 6)):
                done.append(_event(rig, draw))
                rig.wait(draw.choice(WAITS_S))
            faults = rig.faults()
            assert not faults, f"{law}, seed {seed}, order {number}: {faults[:3]} after {done}"
            rig.forget()


@pytest.mark.check("a minute of orders in virtual time")
@pytest.mark.parametrize("seed", [2])
def test_no_order_moves_the_tip_towards_the_sample_by_itself(seed: int) -> None:
    _orders(seed)


@pytest.mark.endurance
@pytest.mark.parametrize("seed", range(100, 200))
def test_two_thousand_orders(seed: int) -> None:
    _orders(seed)
