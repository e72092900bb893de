"""Assembly of particles: find them in an image, follow their drift, plan the pushes, and carry them out."""
