"""What an environment to learn in is made of: the push of a particle as compiled steps, steering, and an interval."""

from analysis.intervals import wilson
from services.afm_node.physics.particles.adhered_sphere import KINDS, hold_of
from services.afm_node.physics.particles.push import X, Y, packed, push_step
from services.afm_node.physics.particles.steering import steered
from services.afm_node.physics.particles.tip_shape import Spring, TipShape, tip_shape, touch_distance_m
from services.numerics.compiled import always_compiled

__all__ = [
    "KINDS",
    "Spring",
    "TipShape",
    "X",
    "Y",
    "always_compiled",
    "hold_of",
    "packed",
    "push_step",
    "steered",
    "tip_shape",
    "touch_distance_m",
    "wilson",
]
