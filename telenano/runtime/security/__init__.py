"""Authentication and access control: key pairs, the list of allowed keys, and the state of every connection."""
