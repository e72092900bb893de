"""What an environment to learn in is made of: episodes of pushing as compiled steps, steering, and an interval."""

from analysis.intervals import wilson
from services.afm_node.physics.particles.steering import steered
from studies.learning import engine

__all__ = ["engine", "steered", "wilson"]
