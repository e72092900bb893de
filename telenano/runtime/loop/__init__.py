"""The loop of a node: deadlines, commands, journal, and the state that it keeps."""
