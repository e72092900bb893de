"""The checks of `telenano doctor` for serial ports; without a port there is nothing to say."""

import os
import re
from collections.abc import Iterator, Sequence
from pathlib import Path

from telenano.extend.checks import Finding
from telenano.files import holder_of

_TTYS = ("ttyACM", "ttyUSB")
_GOOD_LATENCY_MS = 1
_USB_SERIAL = Path("/sys/bus/usb-serial/devices")
# programs that open ports by themselves, and what they do there
_INTRUDERS = {
    "ModemManager": "writes AT commands to a new port for 10 s",
    "brltty": "takes adapters with CH340, CP210x and FT232 away",
}
_RULE = "install the udev rule of docs/devices.md"


def check_serial_ports(
    devices: Path = Path("/dev"), usb: Path = _USB_SERIAL, processes: Path = Path("/proc")
) -> list[Finding]:
    """Check the serial ports that a handle may be on: permission, adapters that hold bytes back, other programs."""
    ports = sorted(path for path in devices.glob("tty*") if path.name.startswith(_TTYS))
    if not ports:
        return []
    return [_access(ports), *_held(ports, processes), *_latency(ports, usb), *_intruders(processes)]


def _held(ports: Sequence[Path], processes: Path) -> Iterator[Finding]:
    for port in ports:
        holder = holder_of(str(port), processes)
        if holder:
            advice = f"end {holder} if it is not the rig: two programs cannot share a port"
            yield Finding("port in use", "warning", f"{port} is open in {holder}", advice)


def _access(ports: Sequence[Path]) -> Finding:
    closed = [str(port) for port in ports if not os.access(port, os.R_OK | os.W_OK)]
    if not closed:
        return Finding("serial ports", "ok", ", ".join(map(str, ports)))
    advice = f"run `sudo usermod -aG dialout $USER` and log in again, or {_RULE}"
    return Finding("serial ports", "warning", f"no permission for {', '.join(closed)}", advice)


def _latency(ports: Sequence[Path], usb: Path) -> Iterator[Finding]:
    for port in ports:
        timer = usb / port.name / "latency_timer"
        try:
            found_ms = int(timer.read_text())
        except (OSError, ValueError):
            # Only FTDI's driver has this file.
            continue
        found = f"{port}: {found_ms} ms"
        if found_ms <= _GOOD_LATENCY_MS:
            yield Finding("latency timer", "ok", found)
            continue
        advice = f"run `echo {_GOOD_LATENCY_MS} | sudo tee {timer}`, or {_RULE}"
        yield Finding("latency timer", "warning", f"{found}: the adapter holds samples back for that time", advice)


def _intruders(processes: Path) -> Iterator[Finding]:
    running = set()
    for folder in processes.iterdir():
        if re.fullmatch("[0-9]+", folder.name):
            try:
                running.add((folder / "comm").read_text().strip())
            except OSError:
                continue
    for name, what in _INTRUDERS.items():
        if name in running:
            yield Finding(name, "warning", f"runs, and {what}", f"{_RULE}, or stop it")
