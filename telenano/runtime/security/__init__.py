"""Authentication and access control between machines: key pairs, allowed keys, and the state of every connection."""
