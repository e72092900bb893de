"""Names of the nodes of a rig that an experiment communicates with."""

EXPERIMENT = "experiment@master"
HAND = "haptic_node@master"
RECORDER = "recorder@master"
TIP = "afm_node@slave"
