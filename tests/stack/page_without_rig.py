"""The page, its server and a browser without the processes of a rig, whose state a test sets: quick, and repeatable.

with served(SaidRig()) as (rig, address):
    rig.is_stopped = True
"""

import threading
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from typing import Any

import msgspec
from browser_page import PAGE_FOLDER, until

from telenano.testing import free_ports
from telenano.testing.filled_messages import examples
from telenano.wire.topics import TOPICS

TOKEN, OBSERVER_TOKEN = "operator-token-0123", "observer-token-0123"
HAND, TIP = "haptic_node@master", "afm_node@slave"


class SaidRig:
    """Says what hand and tip of a rig would say, and obeys a stop and an arm at once.

    `is_stopped`: both are in emergency stop; `is_deaf`: the hand is not pushed by the force of the page; `is_silent`:
    neither says anything; `asked`: the commands that came, with `estop` among them; `delay_s`: how long one takes;
    `way_s`: how long a way back takes, which is `way` in afm/state, where it stays wanted; `words`: the
    parameters of each arm; `hand` and `tip`: what their states say otherwise; `program`: what afm/program says;
    `event`: what session/event says once.
    """

    def __init__(self) -> None:
        self.is_stopped = self.is_deaf = self.is_silent = False
        self.asked: list[str] = []
        self.delay_s = self.way_s = 0.0
        self.way: dict[str, float] = {}
        self.hand: dict[str, Any] = {}
        self.tip: dict[str, Any] = {}
        self.program: dict[str, Any] = {}
        self.event: dict[str, Any] = {}
        self.words: list[Mapping[str, Any]] = []
        self._force_n = 0.0

    def push(self, force_n: float, across_n: tuple[float, float]) -> None:
        self._force_n = force_n

    def news(self) -> list[Any]:
        """Return what both nodes say now."""
        from services.viz_node.feed import seen

        if self.is_silent:
            return []
        pushed_n = 0.0 if self.is_deaf or self.is_stopped else self._force_n
        health = {"state": "running", "overruns": 0, "replay": False, "force_limit_n": None}
        rests = {"tip_force_n": (0.0, 0.0, 0.0), "separation_m": 6e-9, "deflection_m": 0.0}
        apart = {"in_contact": False, "meniscus": False}
        said: list[tuple[str, str, dict[str, Any]]] = [
            (
                "haptic/state",
                HAND,
                {
                    "session_s": 1.0,
                    "estop": self.is_stopped,
                    "position_m": (0.0, 0.0, 0.0),
                    "reference_m": (0.0, 0.0, 0.0),
                },
            ),
            ("afm/state", TIP, {"mode": "estop" if self.is_stopped else "follow", **rests, **apart, **self.way}),
            ("node/health", HAND, health),
            ("node/health", TIP, {**health, "force_limit_n": 2e-7}),
        ]
        said[0][2]["operator_force_n"] = (0.0, 0.0, -pushed_n)
        said[0][2].update(self.hand)
        said[1][2].update(self.tip)
        if self.program:
            said.append(("afm/program", TIP, self.program))
        if self.event:
            said.append(("session/event", TIP, {**self.event, "data": {}}))
            self.event = {}
        # what comes back at the hand's scale
        felt_n = said[1][2]["tip_force_n"][2] * 1e8
        said.append(("haptic/command", "controller@master", {"force_n": (0.0, 0.0, felt_n)}))
        found = []
        for topic, src, changes in said:
            now_ns = time.time_ns()
            message = msgspec.structs.replace(examples(TOPICS[topic])["ordinary"], t_ns=now_ns, src=src, **changes)
            found.append(seen(topic, src, now_ns, message))
        return found

    def send(
        self,
        command: str,
        target: str,
        parameters: Mapping[str, Any],
        is_wanted: Callable[[], bool],
        issued_ns: int,
        by: str,
    ) -> dict[str, tuple[str, str]]:
        self.asked.append(command)
        time.sleep(self.delay_s)
        if command == "arm":
            self.is_stopped = False
            self.words.append(parameters)
            end_s = time.monotonic() + (self.way_s if parameters else 0.0)
            while time.monotonic() < end_s:
                if not is_wanted():
                    return {TIP: ("refused", "going back was ended: the tip stays where it is")}
                time.sleep(0.01)
        return {TIP: ("refused", "the tip is stopped") if self.is_stopped else ("ack", "done")}

    def estop(self, by: str) -> dict[str, tuple[str, str]]:
        self.asked.append("estop")
        self.is_stopped = True
        return {HAND: ("ack", "stopped"), TIP: ("ack", "stopped")}


@contextmanager
def served(rig: SaidRig) -> Iterator[tuple[SaidRig, str]]:
    """Serve the page of such a rig; yield the rig and the address without its token."""
    from lone_page_server import LonePageServer

    from services.viz_node.commander import forms
    from telenano.serving.access import Access

    (port,) = free_ports(1)
    access = Access(TOKEN, OBSERVER_TOKEN)
    place: dict[str, Any] = {"host": "127.0.0.1", "port": port, "page": PAGE_FOLDER}
    server = LonePageServer(rig.push, access, news=rig.news, commander=rig, forms=forms, **place)
    thread = threading.Thread(target=server.run)
    thread.start()
    try:
        until(lambda: server.listens, "a server that listens")
        yield rig, f"http://127.0.0.1:{port}/"
    finally:
        server.end()
        thread.join()
