"""Samples as height maps, computed or read from files."""
