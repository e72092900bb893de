"""Files of a line that are wrong or of another kind, by a generator: the reason names what was found, and no guess."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from telenano_lab.networks.line_log import LineLog, read_log

from telenano.wire import ConfigError

HEAD = "sent_s,delay_ms\n"
FIRST = "1433000000000"


def one_way(extra_ms: Callable[[np.ndarray], np.ndarray], seed: int) -> str:
    """Return a log of 600 s with a message each 50 ms, of 30 ms and more, plus a course over its time [0, 1]."""
    draw = np.random.default_rng(seed)
    sent = 0.05 * np.arange(12_000)
    delay = 30.0 + draw.gamma(2.0, 1.0, len(sent)) + extra_ms(sent / sent[-1])
    return HEAD + "".join(f"{at:.3f},{one:.4f}\n" for at, one in zip(sent, delay, strict=True))


def of_mm_link(shells: str, draw: np.random.Generator, *, departs: bool = True) -> str:
    """Return what mm-link writes: its head, arrivals (+), chances (#), departures (-) and drops (d)."""
    lines = [f"# mahimahi mm-link (uplink) [a.trace] > a.log\n# mahimahi config: {shells}\n# base timestamp: {FIRST}\n"]
    for n in range(4000):
        at, wait = int(FIRST) + 20 * n, int(draw.integers(1, 30))
        lines.append(f"{at} + 1504\n{at + wait} # 1504\n")
        if departs:
            lines.append(f"{at} d 1 1504\n" if n % 50 == 7 else f"{at + wait} - 1504 {wait}\n")
    return "".join(lines)


def read(text: str, folder: Path) -> LineLog:
    path = folder / "line.csv"
    path.write_text(text, encoding="utf-8")
    return read_log([path])


@pytest.mark.parametrize("seed", range(2))
@pytest.mark.parametrize(
    ("course", "named", "never"),
    [
        (lambda t: 60.0 * t, r"evenly, by \+(99\S*|100|101) ppm", "step"),
        (lambda t: 30.0 * (1.0 - t), r"evenly, by -(50|49|51)", "step"),
        (lambda t: 40.0 * (t > 0.37), r"one step near (22\d|21\d)", "ppm|drift"),
        (lambda t: 40.0 * np.sqrt(t) + 20.0 * np.sin(9.0 * t), "Why, the log does not say", "ppm|one step"),
    ],
)
def test_a_delay_that_changes_is_told_as_it_does(
    course: Callable[[np.ndarray], np.ndarray], named: str, never: str, seed: int, tmp_path: Path
) -> None:
    with pytest.raises(ConfigError, match=named) as refused:
        read(one_way(course, seed), tmp_path)
    said = str(refused.value).partition("other. ")[2]
    assert not [word for word in never.split("|") if word in said]


def test_a_capacity_trace_of_several_chances_in_a_millisecond_delays_nothing(tmp_path: Path) -> None:
    trace = "".join(f"{n // 2 + 1}\n" for n in range(120_000))
    with pytest.raises(ConfigError, match=r"capacity trace of mahimahi, of a line of 24 Mbit/s, that delays nothing"):
        read(trace, tmp_path)


def test_a_capacity_trace_of_a_slow_line_is_read(tmp_path: Path) -> None:
    draw = np.random.default_rng(1)
    times = np.cumsum(draw.integers(1, 40, 4000))
    assert np.nanmedian(read("".join(f"{at}\n" for at in times), tmp_path).segments[0].delay_s) > 0.0


@pytest.mark.parametrize(("shells", "fixed_s"), [("[delay 100 ms] ", 0.1), ("", 0.0)])
def test_a_log_of_mm_link_has_the_fixed_delay_of_its_head(shells: str, fixed_s: float, tmp_path: Path) -> None:
    log = read(of_mm_link(shells, np.random.default_rng(3)), tmp_path)
    delays = log.segments[0].delay_s
    assert len(delays) == 4000
    assert np.isnan(delays).sum() == 80
    assert fixed_s + 0.001 <= np.nanmin(delays) <= np.nanmax(delays) <= fixed_s + 0.030
    assert any("mm-link" in remark for remark in log.cuts)


def test_a_log_of_mm_link_without_a_departure_says_so(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="in which no packet departed"):
        read(of_mm_link("", np.random.default_rng(3), departs=False), tmp_path)
