"""Sealed datagrams between two machines, for topics of which a reader needs the newest sample."""
