"""The process that serves the operator's page of a rig or a recording."""
