"""Measure the time from the start of `telenano estop` to the AFM's emergency stop, relative to an interpreter's start.

    python benchmarks/estop.py [--rounds N] [--command "session estop"] [--against FOLDER] [--json]

A rig runs (`telenano up fig12`). Each round arms the devices and starts the command as its own process. The time runs
from before its start to the `t_ns` of the first afm/state in emergency stop, and also to the end of the command. The
baseline is `python -c pass` in the same round, from before its start to its end. Half of the rounds run on the machine
as it is, the other half beside one busy process for each processor. With `--against` each round also stops the rig by
the command of another checkout, before or after this one in turn: `against` is the ratio of the two, round by round.
"""

import argparse
import contextlib
import json
import os
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

import zmq

from telenano.console.send_commands import send_control
from telenano.runtime.bus.address_book import AddressBook
from telenano.runtime.loop.commands import Command
from telenano.settings.included import DEFAULT_SITE_FILE
from telenano.signals import children
from telenano.wire.errors import TelenanoError

AFM = "afm_node@slave"
# The mode of an afm/state, as msgpack encodes it.
STOPPED, FOLLOWS = b"\xa4mode\xa5estop", b"\xa4mode\xa6follow"
PATIENCE_S = 90.0


@contextlib.contextmanager
def running_rig(folder: Path) -> Iterator[None]:
    """Run a rig whose files are in `folder`, until the block ends."""
    arguments = ["up", "--scenario", "fig12", "--duration", "600", "--out", str(folder / "out"), "--json"]
    with children.start([sys.executable, "-m", "telenano", *arguments], stdout=subprocess.DEVNULL) as rig:
        try:
            yield
        finally:
            rig.terminate()


@contextlib.contextmanager
def busy_processors() -> Iterator[None]:
    """Keep every processor busy until the block ends."""
    spinning = [children.start([sys.executable, "-c", "while True: pass"]) for _ in range(os.cpu_count() or 1)]
    try:
        yield
    finally:
        for process in spinning:
            process.kill()
            process.wait()


class Afm:
    """The states of the AFM of a running rig."""

    def __init__(self, context: "zmq.Context[zmq.Socket[bytes]]") -> None:
        self._socket = context.socket(zmq.SUB)
        self._socket.subscribe(b"afm/state")
        self._socket.connect(AddressBook.load(DEFAULT_SITE_FILE).endpoint(AFM))

    def wait_for(self, mode: bytes) -> int:
        """Wait for a state in a mode, as encoded on the wire, and return its t_ns; SystemExit after PATIENCE_S."""
        end = time.monotonic() + PATIENCE_S
        while time.monotonic() < end:
            if self._socket.poll(1000):
                payload = self._socket.recv_multipart()[1]
                if mode in payload:
                    # {"seq": ..., "t_ns": uint 64
                    at = payload.index(b"\xa4t_ns\xcf") + 6
                    return int.from_bytes(payload[at : at + 8], "big")
        raise SystemExit(f"no afm/state with {mode!r} within {PATIENCE_S:g} s")

    def discard(self) -> None:
        while self._socket.poll(0):
            self._socket.recv_multipart()

    def close(self) -> None:
        self._socket.close(linger=0)


def arm() -> None:
    """Arm both devices, which may first need a moment of fresh commands."""
    end = time.monotonic() + PATIENCE_S
    for device in ("haptic_node", "afm_node"):
        while time.monotonic() < end:
            with contextlib.suppress(TelenanoError):
                command = Command("arm", device, parameters={"place": "hand"} if device == "afm_node" else {})
                answers = send_control(command, DEFAULT_SITE_FILE, "master", lambda event: None)
                if all(event.kind == "ack" for event in answers.values()):
                    break


def one_stop(afm: Afm, command: list[str], folder: Path | None) -> tuple[float, float]:
    """Arm and stop the rig; return the times to the stop and to the end of the command [s].

    `folder` is the checkout whose command is used; None for this one.
    """
    arm()
    afm.wait_for(FOLLOWS)
    afm.discard()
    environment = os.environ | ({} if folder is None else {"PYTHONPATH": str(folder)})
    begun_ns, begun = time.time_ns(), time.monotonic()
    process = children.start(
        [sys.executable, "-m", "telenano", *command], stdout=subprocess.DEVNULL, env=environment, cwd=folder
    )
    stopped_ns = afm.wait_for(STOPPED)
    if process.wait() != 0:
        raise SystemExit(f"telenano {' '.join(command)} ended with {process.returncode}")
    return (stopped_ns - begun_ns) * 1e-9, time.monotonic() - begun


def one_round(afm: Afm, command: list[str], against: Path | None, number: int) -> dict[str, float]:
    """Return the times to the stop, to the end of the command, and of the baseline [s]; with `against`, of both."""
    begun = time.monotonic()
    children.run([sys.executable, "-c", "pass"], check=True)
    times = {"interpreter": time.monotonic() - begun}
    folders = [None] if against is None else [None, against][:: 1 if number % 2 else -1]
    for folder in folders:
        stop_s, end_s = one_stop(afm, command, folder)
        times |= {"stop": stop_s, "end": end_s} if folder is None else {"other_stop": stop_s, "other_end": end_s}
    return times


def summary(rounds: list[dict[str, float]]) -> dict[str, float]:
    """Return median and maximum of each time [s], and the ratio of the medians of stop and baseline."""
    found = {}
    for name in rounds[0]:
        values = [each[name] for each in rounds]
        found[f"{name}_p50_s"], found[f"{name}_max_s"] = statistics.median(values), max(values)
    found["ratio_p50"] = found["stop_p50_s"] / found["interpreter_p50_s"]
    if "other_stop" in rounds[0]:
        found["against_p50"] = statistics.median(each["stop"] / each["other_stop"] for each in rounds)
    return found


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description="Time of an emergency stop from the shell.")
    parser.add_argument("--rounds", type=int, default=20, help="rounds idle, and as many beside busy processors")
    parser.add_argument("--command", default="estop", help='"estop" or "session estop"')
    parser.add_argument("--against", type=Path, metavar="FOLDER", help="another checkout, to compare its command")
    parser.add_argument("--smoke", action="store_true", help="the shortest run, to see that it works")
    parser.add_argument("--json", action="store_true")
    given = parser.parse_args()
    if given.smoke:
        given.rounds = 1
    results = {}
    with tempfile.TemporaryDirectory() as folder, zmq.Context() as context:
        os.environ["TELENANO_RUNTIME_DIR"] = f"{folder}/run"
        with running_rig(Path(folder)), contextlib.closing(Afm(context)) as afm:
            afm.wait_for(FOLLOWS)
            words, numbers = given.command.split(), range(given.rounds)
            results["idle"] = summary([one_round(afm, words, given.against, number) for number in numbers])
            with busy_processors():
                results["busy"] = summary([one_round(afm, words, given.against, number) for number in numbers])
    if given.json:
        print(json.dumps(results))
        return
    for name, row in results.items():
        print(f"{name}: " + ", ".join(f"{key} {value:.3f}" for key, value in row.items()))


if __name__ == "__main__":
    main()
