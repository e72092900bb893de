"""Scenario and settings of a process, from file, environment, and command line."""
