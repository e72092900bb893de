"""One reader of each node of a rig on one machine, instead of one for each observer."""
