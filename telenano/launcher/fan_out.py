"""The fan-out process of a rig: it subscribes once to each node and serves all observers while the launcher runs."""

import contextlib
import os
import subprocess
import sys
from collections.abc import Iterator, Sequence

from telenano.launcher.plan import Plan
from telenano.runtime.bus.local_endpoint import LONGEST_IPC_PATH, fan_out_endpoint, remove_fan_out
from telenano.signals import children
from telenano.wire.nodes import FAN_OUT, NODES, module_of, name_of

_STOP_S = 2.0
_PARTS = ("rig", "endpoint", "launcher")


def endpoints_of(plan: Plan) -> list[str]:
    """Return the local endpoints of the nodes that run as long as the rig does.

    Endpoints are left out whose fan-out socket would have a path longer than the system allows.
    """
    rows = [row.key for row in NODES if row.part in _PARTS and row.key in plan.book.nodes]
    endpoints = [endpoint for node in rows if (endpoint := plan.book.local_endpoint(node)) is not None]
    return [each for each in endpoints if len(os.fsencode(fan_out_endpoint(each)[len("ipc://") :])) <= LONGEST_IPC_PATH]


@contextlib.contextmanager
def fan_out(plan: Plan, held: Sequence[int] = ()) -> Iterator[None]:
    """Run the fan-out process while the block runs. If it dies, later observers connect to the nodes themselves.

    Args:
        plan: The planned rig. A rig with sites on other machines, or whose nodes run already, has no fan-out.
        held: Descriptors that every process of the rig inherits.
    """
    if plan.attach or plan.site is not None or not plan.book.uses_runtime_directory:
        yield
        return
    # The process ends at the end of its standard input, so it also ends if the launcher is killed.
    endpoints = endpoints_of(plan)
    process = children.start(
        [sys.executable, "-m", module_of(name_of(FAN_OUT)), *endpoints],
        stdin=subprocess.PIPE,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        pass_fds=held,
        start_new_session=True,
    )
    try:
        yield
    finally:
        try:
            process.communicate(timeout=_STOP_S)
        except subprocess.TimeoutExpired:
            process.kill()
            process.communicate()
            remove_fan_out(endpoints)
