"""Particles on a surface that the tip rides over or pushes: their contact mechanics and their layer."""
