"""The re-run of a node from the journal of its inputs, bit by bit."""
