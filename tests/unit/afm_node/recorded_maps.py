"""Recorded maps with a known answer, as the tests write them."""

import math
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]
STIFFNESS_N_PER_M = 2.0


def force_n(z_m: Any, x_m: Any, y_m: Any) -> Any:
    """Return the force of a smooth wall of height 2 nm above the bottom, whose range changes with x and y [N]."""
    reach = 1e-9 * (1.0 + 0.2 * np.sin(2e7 * x_m) * np.cos(1.5e7 * y_m))
    return 4e-9 * np.exp(-z_m / reach)


def adhesive(z_m: Any) -> tuple[Any, Any]:
    """Return the force of an approach that snaps in at 4 nm and of a retraction that lets go at 9 nm [N]."""
    z = np.asarray(z_m, dtype=np.float64)
    contact = 1.0e-9 * (3e-9 - z) / 1e-9
    down = np.where(z > 4e-9, 0.0, contact)
    return down, np.where(z > 9e-9, 0.0, np.maximum(contact, -5e-9))


def members(**changes: Any) -> dict[str, Any]:
    """Return the members of a map of 5 x 4 x 41 points over 100 x 60 nm and 20 nm."""
    x, y, z = np.linspace(-50e-9, 50e-9, 5), np.linspace(-30e-9, 30e-9, 4), np.linspace(0.0, 20e-9, 41)
    value = force_n(z[None, None, :], x[:, None, None], y[None, :, None])
    made = {
        "value": value, "x": x, "y": y, "z": z, "unit": "N", "length_unit": "m", "sign": 1, "axis": "base",
        "stiffness_n_per_m": STIFFNESS_N_PER_M, "source": "made",
    }  # fmt: skip
    return {key: value for key, value in {**made, **changes}.items() if value is not None}


def hysteretic(**changes: Any) -> dict[str, Any]:
    """Return the members of one curve with both branches, 0.1 nm apart."""
    z = np.linspace(0.0, 20e-9, 201)
    both = np.stack(adhesive(z), axis=1)[None, None]
    return members(value=both, x=np.zeros(1), y=np.zeros(1), z=z, **changes)


def write_npz(path: Path, made: dict[str, Any]) -> Path:
    np.savez(path, **made)
    return path


def write_curves(path: Path, nx: int, ny: int, *, stiffness: float | None = STIFFNESS_N_PER_M) -> Path:
    """Write curves as afmformats does in HDF5, their bottoms on a tilted sample and their forces with an offset."""
    import h5py

    with h5py.File(path, "w") as file:
        file.attrs.update({"software": "made", "software version": "1"})
        for number in range(nx * ny):
            i, j = number % nx, number // nx
            height = np.linspace(20e-9, 0.0, 201)
            down, up = adhesive(height)
            bottom = 3e-6 + 1.3e-9 * i
            group = file.create_group(str(number))
            group["force"] = 0.4e-9 + np.concatenate([down, up[::-1]])
            group["height (measured)"] = bottom + np.concatenate([height, height[::-1]])
            group["segment"] = np.repeat(np.array([0, 1], dtype=np.uint8), 201)
            group["time"] = np.arange(402) * 1e-3
            group.attrs.update({
                "enum": number, "imaging mode": "force-distance", "point count": 402, "grid index x": i,
                "grid index y": j, "grid shape x": nx, "grid shape y": ny, "grid size x": 4e-8, "grid size y": 2e-8,
                **({} if stiffness is None else {"spring constant": stiffness}),
            })  # fmt: skip
    return path


def frequency_shift_hz(z_m: Any) -> Any:
    """Return a frequency shift with its minimum of -8 Hz at 0.4 nm [Hz]."""
    u = np.asarray(z_m) / 0.4e-9
    return -8.0 * u * np.exp(1.0 - u)


def write_3ds(
    path: Path, nx: int = 4, ny: int = 3, points: int = 64, *, lines: int | None = None, **changes: str
) -> Path:
    """Write a grid of Nanonis: z swept from 2 nm down to 0 over each pixel, frequency shift there and back."""
    header = {
        "Grid dim": f'"{nx} x {ny}"',
        "Grid settings": "1.0E-7;2.0E-7;4.0E-9;3.0E-9;0.0E+0",
        "Sweep Signal": '"Z (m)"',
        "Fixed parameters": '"Sweep Start;Sweep End"',
        "Experiment parameters": '"X (m);Y (m);Z (m)"',
        "# Parameters (4 byte)": "5",
        "Experiment size (bytes)": str(3 * 4 * points),
        "Points": str(points),
        "Channels": '"Current (A);Frequency Shift (Hz);Frequency Shift [bwd] (Hz)"',
        **changes,
    }
    text = "".join(f"{key}={value}\r\n" for key, value in header.items()) + ":HEADER_END:\r\n"
    records = []
    for j in range(ny if lines is None else lines):
        for i in range(nx):
            z = np.linspace(2e-9, 0.0, points)
            df = frequency_shift_hz(z) * (1.0 + 0.01 * i)
            records.append(
                np.concatenate([[2e-9, 0.0, 1e-9 * i, 1e-9 * j, 5e-9], 1e-12 * np.exp(-z / 1e-9), df, 0.9 * df])
            )
    path.write_bytes(text.encode() + np.array(records).astype(">f4").tobytes())
    return path


def near(force: float, expected: float, error_n: float) -> bool:
    return math.isfinite(force) and abs(force - expected) <= error_n
