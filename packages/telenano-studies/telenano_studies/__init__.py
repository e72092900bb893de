"""Studies of delay and stability with telenano: maps, transparency, comparison and advice of laws, and the paper."""
