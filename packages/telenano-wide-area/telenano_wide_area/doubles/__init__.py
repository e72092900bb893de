"""Doubles for tests of the datagrams: two ends within one process, and what a machine with a key may send."""
