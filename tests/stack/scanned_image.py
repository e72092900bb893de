"""A recording of an image that is known at every point: terraces of mica with a grain on them."""

from pathlib import Path
from typing import Any

import numpy as np

from telenano.recording.recorder_config import RecorderConfig
from telenano.recording.writer import RecordingWriter
from telenano.wire import encode
from telenano.wire.messages import AfmScanline, Array

POINTS = 96
SIZE_M = 120e-9
LINE_NS = 20_000_000
_EPOCH_NS = 10**18
_TIP = "afm_node@slave"


def heights_m(line: int) -> Any:
    """Return the heights of a line of the image [m], of shape (POINTS,)."""
    x, y = np.linspace(0.0, 1.0, POINTS), line / (POINTS - 1)
    terrace = 1e-9 * (np.floor(3.0 * (0.7 * x + 0.4 * y)))
    grain = 6e-9 * np.exp(-((x - 0.62) ** 2 + (y - 0.45) ** 2) / 0.012)
    return terrace + grain + 0.05e-9 * np.sin(60.0 * x + 9.0 * y)


def scanline(line: int) -> dict[str, Any]:
    """Return the fields of a line of the image."""
    y_m = (line / (POINTS - 1) - 0.5) * SIZE_M
    return {
        "line": line,
        "lines": POINTS,
        "direction": "trace",
        "start_m": (-SIZE_M / 2, y_m, 0.0),
        "end_m": (SIZE_M / 2, y_m, 0.0),
        "height_m": Array.from_numpy(heights_m(line)),
        "amplitude_m": None,
        "phase_rad": None,
    }


def scanned(folder: Path) -> Path:
    """Write a recording of an image, line by line."""
    writer = RecordingWriter.create("recorder@master", RecorderConfig(directory=folder))
    channel = writer.channel("afm/scanline", _TIP, "slave")
    for line in range(POINTS):
        t_ns = _EPOCH_NS + line * LINE_NS
        message = AfmScanline(seq=line, t_ns=t_ns, src=_TIP, v=1, **scanline(line))
        writer.write(channel, t_ns, t_ns, line, encode(message))
    writer.finish()
    return writer.path
