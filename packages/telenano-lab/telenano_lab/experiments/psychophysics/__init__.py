"""Psychophysics: methods that choose the level of the next trial, and fits of what was answered."""
