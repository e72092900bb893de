"""Acceptance: a device or an instrument is judged from the recording of one motion of a minute."""
