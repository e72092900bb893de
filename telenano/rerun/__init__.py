"""The re-run of a node from the journal of its inputs, with a bit-by-bit comparison of its outputs."""
