"""Acceptance tests: they judge a device or an instrument from the recording of one motion of a minute."""
