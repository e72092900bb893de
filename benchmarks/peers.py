"""Where the rig stands among bare transports: the same eight hops, bytes, rate and scheduling over each, and the rig.

    pip install 'telenano[peers]'
    python benchmarks/peers.py [--rounds N] [--duration S] [--smoke] [--json]

Four transports carry bytes of the sizes of our messages through five processes that do nothing else (`chains.py`),
under the scheduling that the rig's nodes ask for: Unix-domain sockets, ZeroMQ with a subscriber that takes everything,
iceoryx2 (a sample in shared memory, and a notified event) and zenoh (sessions between neighbours over Unix-domain
sockets). The rig has in addition its physics, checks, guards, journals and recorder. All take turns; the medians of the
rounds are compared.
"""

import argparse
import ctypes
import importlib.util
import json
import statistics
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from chains import OpenEnd, ages_ms, measure_ends, measure_sockets, measure_zeromq
from cycles import Cycle
from loop import measure_rig

from telenano.runtime.loop.realtime import shallow_idle

_MOST_BYTES = 1024


class IceoryxEnd:
    """An end over iceoryx2: samples in shared memory each way, and an event that wakes the receiver."""

    def __init__(self, place: str, link: int, side: int) -> None:
        import iceoryx2

        iceoryx2.set_log_level(iceoryx2.LogLevel.Error)
        node = self._node = iceoryx2.NodeBuilder.new().create(iceoryx2.ServiceType.Ipc)

        def services(way: int) -> tuple[Any, Any]:
            def named(kind: str) -> Any:
                name = iceoryx2.ServiceName.new(f"{place}/{link}/{way}/{kind}")
                return node.service_builder(name)

            samples = named("samples").publish_subscribe(iceoryx2.Slice[ctypes.c_uint8])
            return samples.open_or_create(), named("event").event().open_or_create()

        (out, told), (into, heard) = services(side), services(1 - side)
        self._publisher = out.publisher_builder().initial_max_slice_len(_MOST_BYTES).create()
        self._notifier, self._listener = told.notifier_builder().create(), heard.listener_builder().create()
        self._subscriber = into.subscriber_builder().create()
        # The services are kept, because the later of their two ends opens what the earlier one made.
        self._services = (out, told, into, heard)

    def recv(self, _size: int) -> bytes:
        while (sample := self._subscriber.receive()) is None:
            self._listener.blocking_wait()
        return ctypes.string_at(sample.payload_ptr, sample.payload().number_of_elements)

    def send(self, payload: bytes) -> None:
        sample = self._publisher.loan_slice_uninit(len(payload))
        ctypes.memmove(sample.payload_ptr, payload, len(payload))
        sample.assume_init().send()
        self._notifier.notify()


class ZenohEnd:
    """An end over zenoh with its own session; the near side of a link listens, the far side connects."""

    def __init__(self, place: str, link: int, side: int) -> None:
        import zenoh

        config = zenoh.Config()
        where = json.dumps([f"unixsock-stream/{place}.{link}"])
        settings = {
            "mode": '"peer"',
            "scouting/multicast/enabled": "false",
            "listen/endpoints": where if side == 0 else "[]",
            "connect/endpoints": "[]" if side == 0 else where,
            # The other side may come later.
            "connect/timeout_ms": "-1",
        }
        for key, value in settings.items():
            config.insert_json5(key, value)
        self._session = zenoh.open(config)
        self._publisher = self._session.declare_publisher(f"hop/{side}", express=True)
        self._subscriber = self._session.declare_subscriber(f"hop/{1 - side}", zenoh.handlers.FifoChannel(16))

    def recv(self, _size: int) -> bytes:
        return bytes(self._subscriber.recv().payload.to_bytes())

    def send(self, payload: bytes) -> None:
        self._publisher.put(payload)


def over(kind: Callable[[str, int, int], Any]) -> Callable[[int], list[Cycle]]:
    """Return a function that measures a chain of such ends, in its own folder and under its own names."""

    def measured(ticks: int) -> list[Cycle]:
        with tempfile.TemporaryDirectory() as folder:
            place = str(Path(folder, f"p{time.time_ns()}"))
            opened: OpenEnd = lambda link, side: kind(place, link, side)  # noqa: E731
            return measure_ends(opened, ticks, placed=True)

    return measured


# By name: the module that the transport needs from PyPI, and the function that measures it.
PEERS: dict[str, tuple[str, Callable[[int], list[Cycle]]]] = {
    "Unix-domain sockets": ("", lambda ticks: measure_sockets(ticks, placed=True)),
    "ZeroMQ": ("", lambda ticks: measure_zeromq(ticks, placed=True)),
    "iceoryx2": ("iceoryx2", over(IceoryxEnd)),
    "zenoh": ("zenoh", over(ZenohEnd)),
}


def measure(rounds: int, duration_s: float) -> dict[str, Any]:
    """Return the age of the loop [ms] over each transport and of the rig, medians of the rounds."""
    there = {name: run for name, (module, run) in PEERS.items() if not module or importlib.util.find_spec(module)}
    ages: dict[str, list[dict[str, float]]] = {name: [] for name in (*there, "rig")}
    for _ in range(rounds):
        for name, run in there.items():
            with shallow_idle():
                found = ages_ms(run(round(duration_s * 1000)))
            ages[name].append({"p50": statistics.median(found), "p99": found[int(0.99 * len(found))]})
        ages["rig"].append(measure_rig(duration_s, trace=False).age_ms)
    age_ms = {
        name: {key: statistics.median(turn[key] for turn in turns) for key in ("p50", "p99")}
        for name, turns in ages.items()
    }
    ratio = {name: {key: age_ms["rig"][key] / age[key] for key in age} for name, age in age_ms.items()}
    missing = [name for name in PEERS if name not in there]
    return {"age_ms": age_ms, "rig_ratio": ratio, "missing": missing}


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--rounds", type=int, default=3, help="turns of all")
    parser.add_argument("--duration", type=float, default=4.0, help="length of each turn [s]")
    parser.add_argument("--smoke", action="store_true", help="the shortest run, to see that it works")
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    given = parser.parse_args()
    found = measure(1, 1.5) if given.smoke else measure(given.rounds, given.duration)
    if found["missing"]:
        print(f"without {', '.join(found['missing'])}: pip install 'telenano[peers]'", file=sys.stderr)
    if given.json:
        print(json.dumps(found))
        return
    print(f"{'':24}{'p50 [ms]':>10}{'p99 [ms]':>10}{'rig / it':>10}{'at p99':>8}")
    for name, age in found["age_ms"].items():
        ratio = found["rig_ratio"][name]
        print(f"{name:24}{age['p50']:10.3f}{age['p99']:10.3f}{ratio['p50']:10.2f}{ratio['p99']:8.2f}")


if __name__ == "__main__":
    main()
