"""The hand of a simulated participant who steers the tip across the sample, both in lockstep and on a rig.

It is the scripted hand of `telenano study push` (`telenano_lab.assembly.push_hand`), which perceives what comes back
over the link. It moves the stylus as a person does in the controller's rate mode, in which the displacement of the
stylus is the velocity of the tip.
"""

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from telenano.sections import AfmConfig, ControllerConfig, HapticConfig
from telenano.settings import LinkSettings, LoadedScenario
from telenano_lab.assembly import Hand, new_hand, push_of
from telenano_lab.experiments.extend import Course
from telenano_lab.experiments.operators import Profile
from telenano_lab.studies.loops.push_study import SPEED_M_PER_S

# Delay until the hand begins to steer, when the tip has touched the sample.
_TOUCHED_S = 1.0
# The hand leaves a particle that is nearer to the goal than this share of the tolerance.
_LEAVES = 0.5


def steering_of(
    document: Mapping[str, Any], goal: Course, tolerance_m: float, who: Profile, seed: int
) -> Callable[[float], Hand]:
    """Return a function that makes the hand of a trial from the period [s].

    Args:
        document: The checked scenario, whose sample has a particle.
        goal: Target place of the particle.
        tolerance_m: Radius of the target circle [m].
        who: The simulated participant.
        seed: The seed of its errors.
    """
    loaded = LoadedScenario.of(document, "a trial")
    plant = loaded.section("afm_node", AfmConfig).to_lockstep_params("a trial", 0.0).plant
    lateral = loaded.section("haptic_node", HapticConfig).lateral_in_force
    link = loaded.section("delay_node", LinkSettings)
    trip_s = link.forward.delay_s + link.backward.delay_s
    # Time constant of the arm, a spring that moves a damper.
    arm_s = (lateral.damping_n_s_per_m + loaded.section("controller", ControllerConfig).lateral.damping_n_s_per_m) / (
        lateral.stiffness_n_per_m
    )
    push = push_of(
        plant,
        goal_m=(float(goal.values[-1, 0]), float(goal.values[-1, 1])),
        speed_m_per_s=SPEED_M_PER_S,
        reaction_s=who.reaction_time_s,
        answers_s=trip_s + arm_s,
        leaves_m=_LEAVES * tolerance_m,
    )

    def make(period_s: float) -> Hand:
        random = np.random.Generator(np.random.PCG64(seed))
        return new_hand(push, random, round((_TOUCHED_S + 2.0 * trip_s) / period_s), period_s)

    return make
