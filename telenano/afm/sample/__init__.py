"""Samples as height maps: made ones, and those of files."""
