"""The relay between two sites that can only dial out, and the end of a site that dials it."""
