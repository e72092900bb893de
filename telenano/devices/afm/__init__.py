"""Real and simulated instruments behind the guard of the AFM."""
