"""Real and simulated haptic devices behind the guard of the hand."""
