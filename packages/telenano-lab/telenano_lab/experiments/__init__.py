"""Experiments: trials of people or simulated operators over conditions, their journal, and its tables and analysis."""
