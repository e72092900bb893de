"""The recorder: the process that writes everything on the bus into MCAP files."""
