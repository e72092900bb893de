"""The critical stiffness of a virtual coupling, by the eigenvalues of one sample time."""

import math

import numpy as np
from telenano_devices.impedance.coupling import stable_stiffness_n_per_m


def period_map(
    device: tuple[float, float], period_s: float, k: float, b: float, delay: float, pole: float = 0.0
) -> np.ndarray:
    """Return the matrix of one sample time: place, velocity, place and rate before, and the forces on their way.

    pole: of the low-pass of the rate.
    """
    mass, damping = device
    whole = math.floor(delay + 1e-9)
    part = (delay - whole) * period_s

    def held(h: float) -> tuple[np.ndarray, np.ndarray]:
        y = damping * h / mass
        # the differences below cancel where the device has hardly any damping
        once = -math.expm1(-y) / y if y > 1e-3 else 1.0 - y / 2.0 + y**2 / 6.0 - y**3 / 24.0
        twice = (1.0 - once) / y if y > 1e-3 else 0.5 - y / 6.0 + y**2 / 24.0 - y**3 / 120.0
        return np.array([[1.0, h * once], [0.0, math.exp(-y)]]), np.array([h**2 / mass * twice, h / mass * once])

    first, by_first = held(part)
    rest, by_rest = held(period_s - part)
    size = 4 + whole + 1
    rate = np.zeros(size)
    rate[0], rate[2], rate[3] = (1.0 - pole) / period_s, -(1.0 - pole) / period_s, pole
    # the forces, the newest first: f[k-1], f[k-2], ...
    force = -b * rate
    force[0] -= k
    rows = [force, *np.eye(size)[4:]]
    matrix = np.zeros((size, size))
    matrix[:2, :2] = rest @ first
    matrix[:2] += np.outer(rest @ by_first, rows[whole + 1]) + np.outer(by_rest, rows[whole])
    matrix[2, 0], matrix[3] = 1.0, rate
    for index in range(whole + 1):
        matrix[4 + index] = rows[index]
    return matrix


def radius(device: tuple[float, float], period_s: float, k: float, b: float, delay: float, filter_hz: float) -> float:
    """Return by what a motion changes in a sample time, the low-pass of the rate being at filter_hz, 0 for none."""
    pole = math.exp(-2.0 * math.pi * filter_hz * period_s) if filter_hz else 0.0
    return float(max(abs(np.linalg.eigvals(period_map(device, period_s, k, b, delay, pole)))))


def critical_stiffness(device: tuple[float, float], rate_hz: float, b: float, delay: float) -> float:
    """Return the K [N/m] at which the spectral radius of a sample time is one."""
    low, high = 0.0, 10.0 * stable_stiffness_n_per_m(device[1], b, 1.0 / rate_hz, delay / rate_hz)
    for _ in range(60):
        middle = 0.5 * (low + high)
        grows = max(abs(np.linalg.eigvals(period_map(device, 1.0 / rate_hz, middle, b, delay)))) > 1.0 + 1e-12
        low, high = (low, middle) if grows else (middle, high)
    return low
