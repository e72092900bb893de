"""The recording of a session and its readers."""
