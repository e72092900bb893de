"""Sealed datagrams between two machines, for what a reader wants the newest of."""
