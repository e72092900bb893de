"""Compiled steps and small numerical tools that give the same bits on every processor."""
