"""The critical stiffness of a virtual coupling, by the eigenvalues of one sample time."""

import math

import numpy as np

from services.haptic_node.coupling import stable_stiffness_n_per_m


def period_map(device: tuple[float, float], period_s: float, k: float, b: float, delay: float) -> np.ndarray:
    """Return the matrix of one sample time: place, velocity, place before, and the forces on their way."""
    mass, damping = device
    whole = math.floor(delay + 1e-9)
    part = (delay - whole) * period_s

    def held(h: float) -> tuple[np.ndarray, np.ndarray]:
        phi = math.exp(-damping * h / mass)
        way = mass / damping * (1.0 - phi)
        return np.array([[1.0, way], [0.0, phi]]), np.array([(h - way) / damping, (1.0 - phi) / damping])

    first, by_first = held(part)
    rest, by_rest = held(period_s - part)
    size = 3 + whole + 1
    # the forces, the newest first: f[k-1], f[k-2], ...
    force = np.zeros(size)
    force[0], force[2] = -(k + b / period_s), b / period_s
    rows = [force, *np.eye(size)[3:]]
    matrix = np.zeros((size, size))
    matrix[:2, :2] = rest @ first
    matrix[:2] += np.outer(rest @ by_first, rows[whole + 1]) + np.outer(by_rest, rows[whole])
    matrix[2, 0] = 1.0
    for index in range(whole + 1):
        matrix[3 + index] = rows[index]
    return matrix


def critical_stiffness(device: tuple[float, float], rate_hz: float, b: float, delay: float) -> float:
    """Return the K [N/m] at which the spectral radius of a sample time is one."""
    low, high = 0.0, 10.0 * stable_stiffness_n_per_m(device[1], b, 1.0 / rate_hz, delay / rate_hz)
    for _ in range(60):
        middle = 0.5 * (low + high)
        grows = max(abs(np.linalg.eigvals(period_map(device, 1.0 / rate_hz, middle, b, delay)))) > 1.0 + 1e-12
        low, high = (low, middle) if grows else (middle, high)
    return low
