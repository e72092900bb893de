"""Conversion between the paper's axis (x towards the sample) and a site's frame (z away from it), a change of sign."""

from telenano.wire.messages import Vector3


def to_paper_axis(vector: Vector3) -> float:
    """Return the paper's coordinate (towards the sample) of a vector in a site's frame (z away from it)."""
    return 0.0 - vector[2]


def to_site_frame(value: float) -> Vector3:
    """Return the vector in a site's frame of a coordinate along the paper's axis; 0.0 stays +0.0."""
    return (0.0, 0.0, 0.0 - value)
