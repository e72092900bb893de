"""The loop of a node: clock, deadlines, commands, journal, and how a process begins and ends."""
