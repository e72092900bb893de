"""The relay between two sites that can only dial out, and the process of a site that dials it."""
