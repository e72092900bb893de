"""Swings of made-up forces: those of a recording are those that the page of the view calls OSCILLATES while it runs."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from telenano.analysis.swings import FELT_N, swings_of

# the rule of the page, in TypeScript, is held to the same signals by its own tests
SHARED = Path(__file__).resolve().parents[3] / "services/viz_node/web/test/swings.json"
SIGNALS = json.loads(SHARED.read_text())


def made(parts: list[list[float]], rate_hz: float) -> tuple[np.ndarray, np.ndarray]:
    time_s = np.arange(round(parts[-1][1] * rate_hz)) / rate_hz
    force_n = np.zeros_like(time_s)
    for start_s, end_s, level_n, amplitude_n, hertz, growth_per_s in parts:
        since_s = time_s - start_s
        swing = amplitude_n * np.exp(growth_per_s * since_s) * np.sin(2.0 * np.pi * hertz * since_s)
        force_n = np.where((since_s > -1e-9) & (time_s < end_s), level_n + swing, force_n)
    return time_s, force_n


@pytest.mark.parametrize("rate_hz", [100.0, 1000.0])
@pytest.mark.parametrize("signal", SIGNALS["signals"], ids=lambda signal: signal["name"])
def test_a_swing_is_found_where_the_page_finds_it(signal: dict[str, Any], rate_hz: float) -> None:
    assert SIGNALS["least"] == FELT_N
    found = swings_of(*made(signal["parts"], rate_hz))
    assert len(found) == len(signal["swings"])
    for swing, (start_s, end_s, hertz, peak_to_peak_n) in zip(found, signal["swings"], strict=True):
        assert (swing.start_s, swing.end_s) == pytest.approx((start_s, end_s), abs=0.5 / hertz)
        assert swing.frequency_hz == pytest.approx(hertz, rel=0.03)
        assert swing.peak_to_peak_n == pytest.approx(peak_to_peak_n, rel=0.15)


def test_noise_and_a_ripple_hide_no_swing_and_are_none() -> None:
    time_s, force_n = made([[0.0, 12.0, 1.0, 2.0, 0.7, 0.0]], 1000.0)
    noise_n = np.random.default_rng(3).normal(0.0, 0.03, time_s.size)
    assert swings_of(time_s, noise_n) == []
    ripple_n = 0.25 * np.sin(2.0 * np.pi * 9.0 * time_s)
    (found,) = swings_of(time_s, force_n + ripple_n + noise_n)
    assert found.frequency_hz == pytest.approx(0.7, rel=0.03)
    assert found.peak_to_peak_n == pytest.approx(4.3, rel=0.1)


def test_nothing_swings_in_nothing() -> None:
    assert swings_of(np.array([]), np.array([])) == []
    assert swings_of(np.array([1.0]), np.array([2.0])) == []
    assert swings_of(np.arange(9.0), np.full(9, np.nan)) == []
