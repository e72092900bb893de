"""What real drivers cost and how old their samples are, against the emulated handle and the model of the T7.

Both devices are processes of their own: the firmware on a pseudo-terminal, a Modbus server on a socket. Figures are
ratios to the period or to a bare socket with the same bytes, in the same run. The driver runs as in a node: scheduling,
processor, memory. The emulated devices have that scheduling as well and would take its processor otherwise.

    python benchmarks/devices.py [--seconds S] [--board avr328p] [--scheduler normal]
"""

import argparse
import contextlib
import json
import os
import signal
import socket
import struct
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from telenano.devices.afm.instrument import modbus_driver
from telenano.devices.afm.modbus_frames import Conversation, Operation
from telenano.devices.hand.calibration import HandleCalibration
from telenano.devices.hand.serial_driver import SerialHandle
from telenano.extend.hands import MODE_OFF, DriveCommand
from telenano.runtime.loop.log import StructuredLog, configure_logging
from telenano.runtime.loop.realtime import apply_realtime, freeze_garbage, use_huge_pages
from telenano.sections.afm_parts import ModbusConfig
from telenano.sections.afm_section import AfmConfig
from telenano.sections.hand_section import LimitsConfig
from telenano.settings.scenario import RealtimeConfig
from telenano.signals import children

PERIOD_S = 1e-3
START_S = 60.0
PORT = 5037
PROCESSORS = os.sched_getaffinity(0)


def quantiles(values: list[float]) -> dict[str, float]:
    """Return median, 99 % quantile and maximum of values."""
    ordered = sorted(values)
    return {"p50": ordered[len(ordered) // 2], "p99": ordered[len(ordered) * 99 // 100], "max": ordered[-1]}


def paced(tick: Callable[[], None], seconds: float) -> list[float]:
    """Call tick a thousand times a second; return the time inside each call over the period."""
    spent = []
    due = time.perf_counter()
    for _ in range(round(seconds / PERIOD_S)):
        due += PERIOD_S
        time.sleep(max(0.0, due - time.perf_counter()))
        began = time.perf_counter()
        tick()
        spent.append((time.perf_counter() - began) / PERIOD_S)
    return spent


def settle() -> None:
    """Treat the memory of this process as a node treats its own before its loop."""
    freeze_garbage()
    use_huge_pages()


def as_anybody() -> None:
    """Run a child as if started from its own terminal: it asks for the scheduling of a device itself."""
    os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
    os.sched_setaffinity(0, PROCESSORS)


def started(arguments: list[str], ready: Callable[[], bool]) -> "subprocess.Popen[bytes]":
    """Start an emulated device, and return its process once it is ready.

    Raises SystemExit if the device ends or is not ready within START_S.
    """
    command = [sys.executable, "-m", "telenano", "device", "simulate", *arguments]
    process = children.start(command, stdout=subprocess.DEVNULL, preexec_fn=as_anybody)
    until = time.monotonic() + START_S
    while not ready():
        if process.poll() is not None or time.monotonic() > until:
            raise SystemExit(f"{' '.join(arguments)} did not start")
        time.sleep(0.05)
    return process


def handle_figures(folder: Path, seconds: float, board: str) -> dict[str, Any]:
    """Return the age of the samples and the cost of the serial driver."""
    link, calibration = folder / "handle", folder / "handle.yaml"
    process = started(
        ["handle", "--board", board, "--link", str(link), "--calibration", str(calibration)], link.is_symlink
    )
    ages: list[float] = []
    try:
        driver = SerialHandle(str(link), 1_000_000, HandleCalibration.from_file(calibration), LimitsConfig())

        def tick() -> None:
            driver.write(DriveCommand(MODE_OFF, 0.0, 0.0))
            driver.read(-1.0, PERIOD_S)
            ages.append(driver.report.age_s / PERIOD_S)

        driver.open()
        settle()
        spent = paced(tick, seconds)
        driver.close()
    finally:
        process.terminate()
        process.wait()
    bad = sum(driver.reader.errors.values())
    figures = {"age_over_period": quantiles(ages), "inside_driver_over_period": quantiles(spent)}
    return {**figures, "frames_missing": driver.missed, "frames_bad": bad, "commands_dropped": driver.dropped}


def serving() -> bool:
    """Return whether the model of the T7 accepts connections."""
    with socket.socket() as probe:
        return probe.connect_ex(("127.0.0.1", PORT)) == 0


def stage_figures(folder: Path, seconds: float, latency_s: float, *, stop: bool) -> dict[str, Any]:
    """Return age and cost of the Modbus driver, and those with a stopped server (`stop`) or those of bare exchanges."""
    calibration = folder / "stage.yaml"
    arguments = ["t7", "--port", str(PORT), "--latency", str(latency_s), "--calibration", str(calibration)]
    process = started(arguments, serving)
    driver: Any = modbus_driver(ModbusConfig(calibration=str(calibration)), AfmConfig().to_params().safety)
    ages: list[float] = []

    def tick() -> None:
        driver.exchange(driver.safe_position_m)
        ages.append(driver.report.age_s / PERIOD_S)

    try:
        driver.open()
        settle()
        before = driver.exchanges
        spent = paced(tick, seconds)
        fresh = (driver.exchanges - before) / len(spent)
        figures = {
            "fresh_a_tick": fresh,
            "age_over_period": quantiles(ages),
            "inside_exchange_over_period": quantiles(spent),
        }
        if stop:
            process.send_signal(signal.SIGSTOP)
            figures["inside_exchange_stopped_over_period"] = quantiles(paced(tick, 0.5))
            figures["lost_when_stopped"] = driver.report.status == "lost"
            process.send_signal(signal.SIGCONT)
        else:
            figures.update(wire_figures(seconds))
    finally:
        driver.close()
        process.terminate()
        process.wait()
    return figures


def broken_figures(folder: Path, seconds: float, *, garbage: bool) -> dict[str, Any]:
    """Return the time inside `exchange` while the server is gone, or while another server answers with garbage."""
    calibration = folder / "stage.yaml"
    process = started(["t7", "--port", str(PORT), "--calibration", str(calibration)], serving)
    driver: Any = modbus_driver(ModbusConfig(calibration=str(calibration)), AfmConfig().to_params().safety)
    stop = threading.Event()
    server: threading.Thread | None = None
    try:
        driver.open()
        settle()
        process.kill()
        process.wait()
        if garbage:
            server = threading.Thread(target=serve_garbage, args=(stop,), daemon=True)
            server.start()
        spent = paced(lambda: driver.exchange(driver.safe_position_m), seconds)
        name = "garbage" if garbage else "killed"
        return {f"inside_exchange_{name}_over_period": quantiles(spent), "lost": driver.report.status == "lost"}
    finally:
        stop.set()
        if server is not None:
            server.join()
        driver.close()


def serve_garbage(stop: threading.Event) -> None:
    """Answer every request with bytes that are not Modbus."""
    with socket.create_server(("127.0.0.1", PORT), reuse_port=True) as server:
        server.settimeout(0.05)
        while not stop.is_set():
            try:
                line, _ = server.accept()
            except TimeoutError:
                continue
            with line:
                line.settimeout(0.05)
                try:
                    while not stop.is_set() and line.recv(4096):
                        line.sendall(bytes(range(64)))
                except OSError:
                    continue


def wire_figures(seconds: float) -> dict[str, Any]:
    """Compare consecutive exchanges: ours, two requests in the place of one, and a bare socket."""
    write, reads = (
        Operation(1000, 2, struct.unpack(">2H", struct.pack(">f", 0.0))),
        (Operation(0, 2), Operation(1000, 2)),
    )
    with socket.create_connection(("127.0.0.1", PORT)) as line:
        line.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        conversation = Conversation(1)

        def ask(request: bytes) -> None:
            line.sendall(request)
            while conversation.answer(line.recv(4096)) is None:
                continue

        def bare() -> None:
            line.sendall(frame)
            line.recv(4096)

        frame = conversation.feedback((write, *reads))

        def split() -> None:
            with contextlib.suppress(BlockingIOError):
                line.recv(4096)
            line.sendall(frame)

        line.setblocking(False)
        line.sendall(frame)
        floor = quantiles(paced(split, seconds))
        line.setblocking(True)
        time.sleep(0.05)
        line.recv(4096)

        def one() -> None:
            ask(conversation.feedback((write, *reads)))

        def two() -> None:
            ask(conversation.write(1000, write.words))
            ask(conversation.read(0, 2))

        taken: dict[str, list[float]] = {"bare": [], "one": [], "two": []}
        until = time.perf_counter() + seconds
        while time.perf_counter() < until:
            for name, exchange in (("bare", bare), ("one", one), ("two", two)):
                began = time.perf_counter()
                exchange()
                taken[name].append(time.perf_counter() - began)
    medians = {name: quantiles(values)["p50"] for name, values in taken.items()}
    return {
        "inside_bare_socket_over_period": floor,
        "exchange_over_bare": medians["one"] / medians["bare"],
        "two_requests_over_one": medians["two"] / medians["one"],
    }


def main() -> None:
    """Print the results, one JSON object per device, or one for all."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=5.0, help="length of each part [s]")
    parser.add_argument("--board", action="append", choices=("posix", "avr328p"), help="what runs the handle (repeat)")
    parser.add_argument("--scheduler", choices=("auto", "normal"), default="auto", help="as in a node; default: auto")
    parser.add_argument("--smoke", action="store_true", help="the shortest run, to see that it works")
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    given = parser.parse_args()
    if given.smoke:
        given.seconds = 0.3
    configure_logging()
    apply_realtime(RealtimeConfig(scheduler=given.scheduler), StructuredLog("benchmark"), "afm_node@slave")
    seconds, boards = given.seconds, given.board or ["posix"]
    found: dict[str, Any] = {}
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for board in boards:
            found[f"handle, {board}"] = handle_figures(folder, seconds, board)
        found["stage, at once"] = stage_figures(folder, seconds, 0.0, stop=False)
        found["stage, 1.2 ms, then stopped"] = stage_figures(folder, seconds, 1.2e-3, stop=True)
        found["stage, killed"] = broken_figures(folder, seconds, garbage=False)
        found["stage, garbage"] = broken_figures(folder, seconds, garbage=True)
    for row in [found] if given.json else [{name: figures} for name, figures in found.items()]:
        print(json.dumps(row))


if __name__ == "__main__":
    main()
