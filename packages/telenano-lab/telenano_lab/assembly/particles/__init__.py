"""Particles on a surface that the tip rides over or pushes."""
