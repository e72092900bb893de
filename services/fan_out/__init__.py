"""The fan-out: one reader of each node of a rig on a machine, instead of one for each observer."""
