"""Test doubles for the datagrams: two ends within one process, and datagrams that any holder of a key may send."""
