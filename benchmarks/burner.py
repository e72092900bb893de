"""A process that allocates memory and burns a core, beside what is measured."""

import contextlib
import os
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

from telenano.signals import children

# The process takes pages from the kernel, writes to each, gives them back, and then computes for about as long.
BURNER = """
import sys
size = int(sys.argv[1])
while True:
    block = bytearray(size)
    block[::4096] = b"1" * len(range(0, size, 4096))
    del block
    sum(range(1_000_000))
"""
BURNED_BYTES = 128 << 20


@contextlib.contextmanager
def burning(wanted: bool) -> Iterator[Callable[[], float]]:
    """Run the burning process beside the block if `wanted`; yield a function for its processor time so far [s]."""
    if not wanted:
        yield lambda: 0.0
        return
    burner = children.start([sys.executable, "-c", BURNER, str(BURNED_BYTES)], stdin=subprocess.DEVNULL)

    def used_s() -> float:
        after_name = Path(f"/proc/{burner.pid}/stat").read_text().rpartition(")")[2].split()
        return (int(after_name[11]) + int(after_name[12])) / os.sysconf("SC_CLK_TCK")

    try:
        yield used_s
    finally:
        burner.kill()
        burner.wait()
