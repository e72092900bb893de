"""The energy that a law generates at its two ports in random orders of adverse events."""
