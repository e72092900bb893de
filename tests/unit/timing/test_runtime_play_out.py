"""The play-out buffer: a delay that hardly varies, for what it costs."""

import random

import numpy as np
import pytest

from telenano.timing.play_out import PlayOut

MS = 1_000_000


def played(delays_ns: list[int], buffer: PlayOut, offset_ns: int = 0) -> np.ndarray:
    """Return the delays after the buffer [ns], of samples sent each millisecond."""
    sent = [n * MS for n in range(len(delays_ns))]
    return np.array(
        [buffer.release_ns(at + offset_ns, at + delay) - at for at, delay in zip(sent, delays_ns, strict=True)]
    )


def test_jitter_is_taken_out_for_a_hundredth_that_comes_too_late() -> None:
    draw = random.Random(3)
    delays = [20 * MS + round(draw.expovariate(1.0) * MS) for _ in range(40_000)]
    after = played(delays, PlayOut())[10_000:]
    late = np.mean(np.array(delays[10_000:]) == after)
    assert late == pytest.approx(0.01, rel=0.3)
    target = np.quantile(delays, 0.99)
    assert np.median(after) == pytest.approx(target, abs=0.3 * MS)
    assert np.subtract(*np.quantile(after, (0.9, 0.1))) < 0.4 * np.subtract(*np.quantile(delays, (0.9, 0.1)))
    # nothing is handed on before it has come
    assert (after >= np.array(delays[10_000:])).all()


def test_clocks_that_differ_change_nothing_and_a_new_route_is_followed() -> None:
    delays = [30 * MS] * 2000 + [10 * MS] * 60_000
    after = played(delays, PlayOut())
    assert (after == played(delays, PlayOut(), offset_ns=10**15)).all()
    assert after[1999] == pytest.approx(30 * MS, abs=0.3 * MS)
    assert after[-1] == pytest.approx(10 * MS, abs=0.3 * MS)
    # and never more than the readers' deadline leaves room for
    spikes = [10 * MS if n % 2 else 200 * MS for n in range(4000)]
    in_time = played(spikes, PlayOut())[1::2]
    assert in_time.max() <= 50 * MS
