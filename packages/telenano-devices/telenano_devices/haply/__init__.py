"""Haply's Inverse3 with a VerseGrip: the driver and an emulated service."""
