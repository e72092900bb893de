"""Figures and pages that the studies write."""
