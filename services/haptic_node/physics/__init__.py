"""The simulated haptic device: motor, arm, and the operator who holds it."""
