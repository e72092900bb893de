"""Psychophysics: methods that choose the level of the next trial, and fits of the answers."""
