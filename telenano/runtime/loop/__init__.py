"""The loop of a node: deadlines, deferred tasks, commands, journal, health, and real-time scheduling."""
