"""An environment to learn in: a particle that a tip pushes to a goal, felt and not seen."""
