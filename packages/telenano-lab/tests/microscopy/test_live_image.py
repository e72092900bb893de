"""The lines that a running rig sends of an image, put together."""

from typing import Any

import msgspec
import numpy as np
import pytest
from telenano_lab.microscopy.image_files import LiveImage

from telenano.wire import AfmScanline, Array


def line(
    number: int,
    direction: str,
    heights: list[float],
    lateral: list[float] | None = None,
    dissipated: list[float] | None = None,
) -> AfmScanline:
    y = (number - 1.0) * 10e-9
    fields: dict[str, Any] = {"amplitude_m": None, "phase_rad": None}
    if dissipated is not None:
        fields["dissipated_j"] = Array.from_numpy(np.array(dissipated))
    if lateral is not None:
        fields["lateral_force_n"] = Array.from_numpy(np.array(lateral))
    return msgspec.convert({
            "seq": 0, "t_ns": 0, "src": "afm_node@slave", "v": AfmScanline.version, "line": number,
            "lines": 3, "direction": direction, "start_m": (-15e-9, y, 0.0), "end_m": (15e-9, y, 0.0),
            "height_m": Array.from_numpy(np.array(heights)), **fields,
        }, AfmScanline)  # fmt: skip


def test_lines_make_an_image_with_its_sides_and_only_whole_lines_count() -> None:
    image = LiveImage()
    assert image.finished == 0
    for number in range(2):
        image.add(line(number, "trace", [1.0, 2.0, 3.0, 4.0], [5.0, 6.0, 7.0, 8.0]))
        assert image.finished == number
        image.add(line(number, "retrace", [1.5, 2.5, 3.5, 4.5], dissipated=[9.0, 9.0, 9.0, 9.0]))
        assert image.finished == number + 1
    assert (image.width_m, image.depth_m) == pytest.approx((40e-9, 30e-9), rel=1e-9, abs=0.0)
    assert image.trace_m[1].tolist() == [1.0, 2.0, 3.0, 4.0]
    assert image.retrace_m[0].tolist() == [1.5, 2.5, 3.5, 4.5]
    assert image.trace_n[0].tolist() == [5.0, 6.0, 7.0, 8.0]
    image.add(line(0, "trace", [1.0, 2.0, 3.0, 4.0], dissipated=[1e-18, 2e-18, 0.0, 0.0]))
    assert image.dissipated_j[0].tolist() == [1e-18, 2e-18, 0.0, 0.0]
    assert np.isnan(image.dissipated_j[1:]).all()
    # what never came is no number
    assert np.isnan(image.trace_m[2]).all()
    assert np.isnan(image.retrace_n).all()
