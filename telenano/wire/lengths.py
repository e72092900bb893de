"""Lengths as the texts of events and commands state them."""


def in_nm(length_m: float) -> str:
    """Return a length [m] in nm, by four digits and to a picometre: what is closer to zero is rounding."""
    four_digits = float(f"{1e9 * length_m:.4g}")
    # The sum makes a negative zero positive.
    return f"{round(four_digits, 3) + 0.0:g} nm"
