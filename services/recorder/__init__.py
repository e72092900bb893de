"""The recorder: the process that writes all messages on the bus to MCAP files."""
