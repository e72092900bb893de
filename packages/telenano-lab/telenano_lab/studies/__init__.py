"""Studies of delay and stability with telenano: maps, transparency, advice on laws, and the figures of the paper."""
