"""`telenano doctor`: whether this machine can run a rig, and what to do where it cannot."""
