"""The socket at which a node takes emergency stops (ADR 0014)."""

import contextlib
from pathlib import Path

import zmq

from proto import WireError
from proto.messages import InputHealth
from proto.nodes import is_estop
from services.runtime.bus.bus import Subscriber
from services.runtime.bus.publisher import bind
from services.runtime.clock import Clock


class EstopInlet(Subscriber):
    """A SUB socket that the node binds itself, so that any number of senders can connect, at once and without a lock.

    It takes `session/control` of `estop@site` only, which `CommandHandler` lets stop and do nothing else.
    """

    def __init__(self, context: "zmq.Context[zmq.Socket[bytes]]", clock: Clock, node: str, endpoint: str) -> None:
        """Bind an ipc endpoint for `node`; EndpointError says why that fails."""
        super().__init__(context, clock, {endpoint: ["session/control"]}, connect=False, permit=_permit)
        self._path = Path(endpoint.removeprefix("ipc://"))
        bind(self.socket, endpoint, node)
        self.shared = False

    def input_health(self) -> tuple[InputHealth, ...]:
        """Return the sequence statistics of every sender; silence is nothing to report."""
        return tuple(health for health in super().input_health() if health.src)

    def close(self) -> None:
        """Close the socket and remove it from its folder, so that nobody takes the node for one that runs."""
        super().close()
        with contextlib.suppress(OSError):
            self._path.unlink()


def _permit(topic: str, src: str) -> None:
    if not is_estop(src):
        raise WireError("source", f"{topic}: {src} may not send at the inlet for emergency stops")
