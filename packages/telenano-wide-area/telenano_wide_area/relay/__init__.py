"""The relay between two sites that can only dial out, and the process by which a site dials it."""
