"""The checks of `telenano doctor` for real devices: serial ports, if there are any, and a networked instrument."""

import os
import re
import socket
from collections.abc import Iterator, Sequence
from pathlib import Path

from telenano.extend.checks import Finding

_TTYS = ("ttyACM", "ttyUSB")
_GOOD_LATENCY_MS = 1
_PATIENCE_S = 2.0
_USB_SERIAL = Path("/sys/bus/usb-serial/devices")
# Programs that open serial ports on their own, and the effect.
_INTRUDERS = {
    "ModemManager": "writes AT commands to a new port for 10 s",
    "brltty": "takes adapters with CH340, CP210x and FT232 away",
}
_RULE = "install the udev rule of packages/telenano-devices/docs/devices.md"


def check_serial_ports(
    devices: Path = Path("/dev"), usb: Path = _USB_SERIAL, processes: Path = Path("/proc")
) -> list[Finding]:
    """Check the serial ports for a handle: permission, adapters that delay bytes, and other programs that use them."""
    ports = sorted(path for path in devices.glob("tty*") if path.name.startswith(_TTYS))
    if not ports:
        return []
    return [_access(ports), *_held(ports, processes), *_latency(ports, usb), *_intruders(processes)]


def check_instrument(calibration: Path, patience_s: float = _PATIENCE_S) -> Finding:
    """Check whether the instrument of a calibration file accepts a connection; raise ConfigError for an invalid file.

    No request is sent, because a rig may be driving the instrument.
    """
    from telenano.devices.afm.instrument import calibration_of_file

    network = calibration_of_file(calibration).network
    where = f"{network.host}:{network.port}"
    try:
        with socket.create_connection((network.host, network.port), timeout=patience_s):
            return Finding("instrument", "ok", f"{where} accepts a connection")
    except socket.gaierror:
        text, advice = "the name is not known", f"correct network.host in {calibration}, or give an address"
    except TimeoutError:
        text = f"no answer within {patience_s:g} s"
        advice = f"check power and cable, that {network.host} is in the network of this machine, and the firewall"
    except ConnectionRefusedError:
        text = "there is a machine, and it refuses the port"
        advice = f"a T7 listens on 502, a guard on a port of yours: correct network.port in {calibration}, or start it"
    except OSError as error:
        text, advice = f"not reached: {error.strerror or error}", "check cable, address and network mask"
    return Finding("instrument", "problem", f"{where}: {text}", advice)


def _held(ports: Sequence[Path], processes: Path) -> Iterator[Finding]:
    from telenano.devices.hand.port import holder_of

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
            # Only the driver of FTDI has this file.
            continue
        text = f"{port}: {found_ms} ms"
        if found_ms <= _GOOD_LATENCY_MS:
            yield Finding("latency timer", "ok", text)
            continue
        advice = f"run `echo {_GOOD_LATENCY_MS} | sudo tee {timer}`, or {_RULE}"
        yield Finding("latency timer", "warning", f"{text}: the adapter holds samples back for that time", advice)


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
