"""A separate process for a driver, for work that must not wait for the loop of its node.

process = start_process("my_package.servo")     # in the driver, with pipes to its input and output
schedule_as_node("servo")                       # in that process, before its loop begins
"""

import contextlib
import os
import subprocess
import sys

from telenano.runtime.loop.log import StructuredLog, configure_logging
from telenano.runtime.loop.realtime import PROCESSORS_VARIABLE, apply_realtime, freeze_garbage, ordinary_scheduling
from telenano.settings.scenario import RealtimeConfig
from telenano.signals import children


def start_process(module: str) -> "subprocess.Popen[bytes]":
    """Start a module as a program, with pipes to its standard input and output.

    The start does not block the loop: it runs under ordinary scheduling, because with SCHED_FIFO the new process would
    have the same priority as the node on its processor.
    """
    with ordinary_scheduling():
        return children.start((sys.executable, "-m", module), stdin=subprocess.PIPE, stdout=subprocess.PIPE)


def schedule_as_node(name: str) -> None:
    """Request the scheduling of the nodes for this process, on any processor of the rig, not only that of its node."""
    if hasattr(os, "sched_setaffinity"):
        held = {int(part) for part in os.environ.get(PROCESSORS_VARIABLE, "").split(",") if part.isdigit()}
        with contextlib.suppress(OSError):
            os.sched_setaffinity(0, held or range(os.cpu_count() or 1))
    configure_logging()
    apply_realtime(RealtimeConfig(cpus="free"), StructuredLog(name), name)
    freeze_garbage(disable=False)
