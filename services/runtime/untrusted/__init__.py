"""What strangers gave, within bounds: YAML, files read in a child process, text for a terminal."""
