"""What particles take of the step of the instrument: little more than the step without them."""

import time
from collections.abc import Callable

import pytest
from particles import instrument, sweep

pytestmark = [
    pytest.mark.check("compares the time of steps, takes 13 s"),
    pytest.mark.drawn(0.0, "packages/telenano-lab/telenano_lab/assembly/", "telenano/afm/"),
]


@pytest.mark.parametrize(("y_m", "most"), [(0.5e-6, 1.6), (0.0, 2.5)])
def test_fifty_particles_take_a_share_of_a_step(y_m: float, most: float) -> None:
    """Fifty take a share more than one; the shortest of several turns, so that a busy machine counts less."""

    def turn(count: int) -> Callable[[], None]:
        return lambda: sweep(instrument(count), 300, y_m)

    runs, best = {1: turn(1), 50: turn(50)}, {1: float("inf"), 50: float("inf")}
    for number in range(8):
        for count, run in runs.items():
            begin = time.thread_time()
            run()
            if number:
                best[count] = min(best[count], time.thread_time() - begin)
    assert best[50] < most * best[1]
