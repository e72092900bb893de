"""The player: a process that replaces nodes and plays their recorded messages on the bus."""
