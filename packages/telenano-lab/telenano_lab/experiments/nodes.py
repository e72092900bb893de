"""The nodes of a rig that an experiment speaks to, by their names in the table of nodes."""

EXPERIMENT = "experiment@master"
HAND = "haptic_node@master"
RECORDER = "recorder@master"
TIP = "afm_node@slave"
