"""The supervisor of a rig, or of one site of it."""
