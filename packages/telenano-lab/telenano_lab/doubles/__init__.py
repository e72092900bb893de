"""Test doubles for this package and for readers of its files: files of makers, and journals of experiments."""
