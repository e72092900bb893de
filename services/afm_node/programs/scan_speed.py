"""The limit of the speed along a surface that is to be felt (Eq. 14)."""


def felt_speed_m_per_s(feature_m: float, bandwidth_hz: float) -> float:
    """Return the fastest motion of the tip at which features of that length are felt [m/s] (Eq. 14).

    >>> round(felt_speed_m_per_s(1e-9, 30.0) * 1e9, 9)  # nm/s
    30.0
    """
    return feature_m * bandwidth_hz
