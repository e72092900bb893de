"""Figures and pages of the studies."""
