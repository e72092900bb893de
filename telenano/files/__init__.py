"""Files that people and other programs write: read within limits, and written whole or not at all."""
