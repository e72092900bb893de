"""Doubles for tests of this package and of what reads its files: files of makers, and journals of experiments."""
