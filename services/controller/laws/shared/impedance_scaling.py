"""Impedance scaling (Eq. 13): what a mass, a damper and a spring at the tip are at the hand."""


def impedance_scaled(
    alpha: float, mass_kg: float, damping_n_s_per_m: float, stiffness_n_per_m: float
) -> tuple[float, float, float]:
    """Return the factors of x'', x' and x in Eq. 13: alpha^4 m [kg], alpha^2 b [N s/m], alpha^2 k [N/m].

    >>> impedance_scaled(10.0, 2.0, 3.0, 4.0)
    (20000.0, 300.0, 400.0)
    """
    return alpha**4 * mass_kg, alpha**2 * damping_n_s_per_m, alpha**2 * stiffness_n_per_m
