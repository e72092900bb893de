"""The force between tip and sample, and tables of it."""
