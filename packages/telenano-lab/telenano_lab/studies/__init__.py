"""Studies of delay and stability with telenano: maps, transparency, which law to take, and the paper."""
