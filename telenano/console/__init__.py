"""Commands to a running rig from outside it: by a console, or as an emergency stop."""
