"""The simulated instrument: stage, cantilever, read-out, and what disturbs them."""
