"""The launcher of one site on real sockets, for tests of requests from another site."""

import os
import threading
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from telenano.runtime import AddressBook


class _NoChildren:
    """The processes of a site that has none: every method returns an empty dict."""

    def __getattr__(self, name: str) -> Callable[..., dict[str, int]]:
        return lambda *arguments, **named: {}


class SiteLauncher:
    """The launcher of the slave's site, without nodes, in a thread that stops while `runs` is not set.

    Args:
        book: The endpoints of the rig.
        folder: The folder of its recordings.
        sender: The object that sends pieces of them, as made by the entry of a package.
    """

    def __init__(self, book: "AddressBook", folder: Path, sender: Any) -> None:
        self._book, self._folder, self._sender = book, folder, sender
        self.runs, self._ends, self._ready = threading.Event(), threading.Event(), threading.Event()
        self._thread = threading.Thread(target=self._run)

    def _run(self) -> None:
        from telenano.launcher.site_node import SiteNode
        from telenano.launcher.supervisor import Supervisor
        from telenano.runtime.loop.node_loop import NodeLoop
        from telenano.runtime.wiring.participant import NO_REALTIME, Participant

        wake, write = os.pipe()
        with Participant.open("launcher@slave", self._book, wake) as participant:
            bus = participant.bus(SiteNode.inputs)
            processes: Any = _NoChildren()
            supervisor = Supervisor(participant.clock, (), processes)
            node = SiteNode(participant.context(bus), supervisor, self._folder, self._sender)
            loop = NodeLoop(node, bus, NO_REALTIME)
            self._ready.set()
            while not self._ends.is_set():
                self.runs.wait()
                loop.turn()
        os.close(wake)
        os.close(write)

    def __enter__(self) -> "SiteLauncher":
        self.runs.set()
        self._thread.start()
        assert self._ready.wait(10.0)
        return self

    def __exit__(self, *error: object) -> None:
        self._ends.set()
        self.runs.set()
        self._thread.join()
