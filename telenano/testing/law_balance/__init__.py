"""The energy that a law makes at its two ports when an adversary draws the order of events."""
