"""Recordings as a library: MCAP files written, read, checked, cut and exported; no socket and no process."""
