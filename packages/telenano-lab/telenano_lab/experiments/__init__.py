"""Experiments: trials of people or simulated operators over conditions, their journal, and what is made from it."""
