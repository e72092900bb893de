"""Haply's Inverse3 with a VerseGrip: driver and emulated service."""
