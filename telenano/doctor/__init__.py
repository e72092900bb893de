"""`telenano doctor`: check whether this machine can run a rig, and advise what to do if it cannot."""
