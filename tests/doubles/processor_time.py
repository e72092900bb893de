"""Comparison of the processor times of two pieces of work, on a machine that others use as well."""

import gc
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

ROUNDS = 20


def ratio_of_costs(work: Callable[[], object], reference: Callable[[], object], *, below: float) -> float:
    """Return the ratio of the least processor times of both; repeat both until it is below a bound, at most 20 times.

    On a shared processor, cold caches and page tables only increase the time, so one undisturbed run shows the cost.
    The garbage collector is off, as in a node, because its time grows with the number of tests run before.
    """
    costs: tuple[list[float], list[float]] = ([], [])
    with without_collector():
        for _ in range(ROUNDS):
            for cost, call in zip(costs, (work, reference), strict=True):
                cost.append(_cost_s(call))
            if (ratio := min(costs[0]) / min(costs[1])) < below:
                break
    return ratio


def _cost_s(work: Callable[[], object]) -> float:
    started = time.process_time()
    work()
    return time.process_time() - started


@contextmanager
def without_collector() -> Iterator[None]:
    """Let the garbage collector rest while the block runs."""
    was_enabled = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if was_enabled:
            gc.enable()
