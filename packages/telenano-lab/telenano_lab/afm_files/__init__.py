"""Readers of images, force curves and force maps from the AFMs of other makers."""
