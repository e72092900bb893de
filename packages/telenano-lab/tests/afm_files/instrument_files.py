"""Curves and grids of instruments with a known answer, as the tests write them."""

from pathlib import Path

import numpy as np
from recorded_maps import frequency_shift_hz
from telenano_lab.doubles.maker_files import STIFFNESS_N_PER_M, adhesive


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
