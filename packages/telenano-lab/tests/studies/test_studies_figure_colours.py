"""The colours of verdicts can be told apart by the colour-blind and in grey."""

import itertools
from typing import get_args

import numpy as np
import numpy.typing as npt
import pytest

from telenano.analysis import VERDICT_COLOURS, Kind

Colour = npt.NDArray[np.float64]

# linear RGB as a dichromat sees it (G. M. Machado, M. M. Oliveira, L. A. F. Fernandes, IEEE TVCG 15, 2009, severity 1)
SEEN = {
    "trichromat": np.eye(3),
    "deuteranope": np.array(
        [[0.367322, 0.860646, -0.227968], [0.280085, 0.672501, 0.047413], [-0.011820, 0.042940, 0.968881]]
    ),
    "protanope": np.array(
        [[0.152286, 1.052583, -0.204868], [0.114503, 0.786281, 0.099216], [-0.003882, -0.048116, 1.051998]]
    ),
}
_XYZ = np.array(
    [[0.4124564, 0.3575761, 0.1804375], [0.2126729, 0.7151522, 0.0721750], [0.0193339, 0.1191920, 0.9503041]]
)
_WHITE = np.array([0.95047, 1.0, 1.08883])


def lab(colour: str, seen: Colour) -> Colour:
    """Return CIE L*a*b* of #rrggbb as somebody sees it."""
    srgb = np.array([int(colour[place : place + 2], 16) / 255.0 for place in (1, 3, 5)])
    linear = np.where(srgb <= 0.04045, srgb / 12.92, ((srgb + 0.055) / 1.055) ** 2.4)
    t = _XYZ @ np.clip(seen @ linear, 0.0, 1.0) / _WHITE
    f = np.where(t > (6.0 / 29.0) ** 3, np.cbrt(t), t / (3.0 * (6.0 / 29.0) ** 2) + 4.0 / 29.0)
    return np.array([116.0 * f[1] - 16.0, 500.0 * (f[0] - f[1]), 200.0 * (f[1] - f[2])])


def ciede2000(first: Colour, second: Colour) -> float:
    """Return the difference of two colours (G. Sharma, W. Wu, E. N. Dalal, Color Research and Application 30, 2005)."""
    (l1, a1, b1), (l2, a2, b2) = first, second
    mean_c = 0.5 * (np.hypot(a1, b1) + np.hypot(a2, b2))
    g = 0.5 * (1.0 - np.sqrt(mean_c**7 / (mean_c**7 + 25.0**7)))
    c1, c2 = np.hypot((1.0 + g) * a1, b1), np.hypot((1.0 + g) * a2, b2)
    h1, h2 = (np.degrees(np.arctan2(b, (1.0 + g) * a)) % 360.0 for a, b in ((a1, b1), (a2, b2)))
    turn = 0.0 if c1 * c2 == 0.0 else (h2 - h1 + 180.0) % 360.0 - 180.0
    dl, dc, dh = l2 - l1, c2 - c1, 2.0 * np.sqrt(c1 * c2) * np.sin(np.radians(turn / 2.0))
    ml, mc = 0.5 * (l1 + l2), 0.5 * (c1 + c2)
    mh = h1 + h2 if c1 * c2 == 0.0 else (h1 + turn / 2.0) % 360.0
    t = 1.0 - 0.17 * np.cos(np.radians(mh - 30.0)) + 0.24 * np.cos(np.radians(2.0 * mh))
    t += 0.32 * np.cos(np.radians(3.0 * mh + 6.0)) - 0.20 * np.cos(np.radians(4.0 * mh - 63.0))
    sl = 1.0 + 0.015 * (ml - 50.0) ** 2 / np.sqrt(20.0 + (ml - 50.0) ** 2)
    sc, sh = 1.0 + 0.045 * mc, 1.0 + 0.015 * mc * t
    rotation = (
        -2.0 * np.sqrt(mc**7 / (mc**7 + 25.0**7)) * np.sin(np.radians(60.0 * np.exp(-(((mh - 275.0) / 25.0) ** 2))))
    )
    squares = (dl / sl) ** 2 + (dc / sc) ** 2 + (dh / sh) ** 2 + rotation * (dc / sc) * (dh / sh)
    return float(np.sqrt(squares))


def test_the_difference_is_that_of_the_published_test_data() -> None:
    rows = (
        ((50.0, 2.6772, -79.7751), (50.0, 0.0, -82.7485), 2.0425),
        ((50.0, 2.5, 0.0), (50.0, 0.0, -2.5), 4.3065),
        ((60.2574, -34.0099, 36.2677), (60.4626, -34.1751, 39.4387), 1.2644),
        ((22.7233, 20.0904, -46.6940), (23.0331, 14.9730, -42.5619), 2.0373),
    )
    for first, second, expected in rows:
        assert ciede2000(np.array(first), np.array(second)) == pytest.approx(expected, abs=5e-5)


@pytest.mark.parametrize("reader", SEEN)
def test_the_colours_of_verdicts_differ_by_17_for_every_reader(reader: str) -> None:
    assert set(VERDICT_COLOURS) == set(get_args(Kind))
    for first, second in itertools.combinations(VERDICT_COLOURS, 2):
        found = ciede2000(*(lab(VERDICT_COLOURS[kind], SEEN[reader]) for kind in (first, second)))
        assert found >= 17.0, (first, second, found)


def test_stable_limit_cycle_and_diverged_differ_in_grey() -> None:
    light, middle, dark = (lab(VERDICT_COLOURS[kind], np.eye(3))[0] for kind in ("stable", "limit_cycle", "diverged"))
    assert light - middle > 20.0
    assert middle - dark > 20.0
