"""A process that computes without end is ended by the kernel, and one that waits is not."""

import signal
import subprocess
import sys

import pytest

from telenano.runtime.loop.hang_guard import HangGuard

RUN = """
import time
from telenano.runtime.loop import hang_guard
hang_guard.LIMIT_S = 0.2

def burn(cpu_s):
    begin = time.process_time()
    while time.process_time() - begin < cpu_s:
        pass

with hang_guard.HangGuard() as guard:
    {work}
burn(0.5)
print("ended by itself")
"""


def ended(work: str) -> tuple[int, str]:
    done = subprocess.run(
        [sys.executable, "-c", RUN.format(work=work)], capture_output=True, text=True, timeout=60, check=False
    )
    return done.returncode, done.stdout


@pytest.mark.parametrize(
    "work", ["burn(30)", "[guard.renew() or burn(0.05) for _ in range(3)]; burn(30)", "sum(range(10**10))"]
)
def test_a_step_without_an_end_ends_the_process(work: str) -> None:
    assert ended(work) == (-signal.SIGPROF, "")


@pytest.mark.parametrize("work", ["[burn(0.05) or guard.renew() for _ in range(20)]", "time.sleep(1)"])
def test_who_reports_or_waits_goes_on(work: str) -> None:
    assert ended(work) == (0, "ended by itself\n")


def test_nothing_is_left_behind() -> None:
    with HangGuard():
        assert signal.getitimer(signal.ITIMER_PROF)[0] > 0.0
    assert signal.getitimer(signal.ITIMER_PROF) == (0.0, 0.0)
