"""Clocks and ages: how old a sample is, how far two clocks are apart, when a message is played out."""
