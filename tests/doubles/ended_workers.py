"""Says how a worker of a test run ended that did not end by itself: by which signal, or with which code."""

import contextlib
import signal
import subprocess
from typing import Any

import pytest

# A worker whose connection has ended has ended, or does so within this time [s].
_PATIENCE_S = 5.0


@pytest.hookimpl(optionalhook=True)
def pytest_testnodedown(node: Any, error: object | None) -> None:
    """Write the end of a worker that died, which pytest-xdist calls *not properly terminated*."""
    if error is None:
        return
    process: subprocess.Popen[bytes] = node.gateway._io.popen
    with contextlib.suppress(subprocess.TimeoutExpired):
        process.wait(_PATIENCE_S)
    code = process.returncode
    how = (
        "has not ended" if code is None else f"ended with {signal.Signals(-code).name if code < 0 else f'code {code}'}"
    )
    node.config.get_terminal_writer().line(f"\nthe worker {node.gateway.id}, process {process.pid}, {how}")
