"""Nodes of the rig, one package each, and what they share."""
