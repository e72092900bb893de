"""Force and potential of the compact surface, each by itself."""

from telenano_laws.surface import Surface, force_and_potential


def force_nn(surface: Surface, cantilever: float, range_nm: float, position_nm: float) -> float:
    """Return F [nN] at a base position [nm]."""
    return force_and_potential(surface, cantilever, range_nm, position_nm)[0]


def potential(surface: Surface, cantilever: float, range_nm: float, position_nm: float) -> float:
    """Return V [nN nm] at a base position [nm]."""
    return force_and_potential(surface, cantilever, range_nm, position_nm)[1]
