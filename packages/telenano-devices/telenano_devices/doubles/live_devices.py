"""The emulated device of each driver as a process or library of its own, which a test can disturb while it runs."""

import os
import re
import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any, Self

from telenano_devices.doubles import libraries
from telenano_devices.impedance.emulated_arm import HandMotion

# The line for the emulated service that does the same as each word of the doubles.
LINES: dict[str, Callable[[float], str]] = {
    "unplugged": lambda value: "pull" if value else "plug",
    "uncalibrated": lambda value: "lose-home" if value else "home",
    "not_a_number": lambda value: "nan" if value else "number",
    "frozen": lambda value: "freeze" if value else "thaw",
    "latency_s": lambda value: f"late {value:g}",
    "drive_delay_s": lambda value: f"drive-late {value:g}",
    "push_n": lambda value: f"push {value:g}",
    "hand_m": lambda value: f"arm {value:g}",
    "loose": lambda value: "loose",
}
_ROW_S = 0.005


class LiveDevice:
    """An emulated Inverse Service as a process of its own, or a double of libdhd or libHD for a servo's process.

    Args:
        kind: haply, dhd or hd.
        folder: The folder of the file with orders for a double.
        options: Options of `telenano device simulate haply`.
    """

    def __init__(self, kind: str, folder: Path, *options: str) -> None:
        self.kind, self._options = kind, options
        self._process: subprocess.Popen[str] | None = None
        self._offset_m, self._sign = 0.0, 1.0
        self._orders = folder / f"{kind}.orders"
        self.address = ""
        # Environment variables that the process of a servo needs for a double.
        self.environment: dict[str, str] = {}
        if kind == "haply":
            self.start()
        else:
            self._orders.touch()
            self.tell("TELENANO_DOUBLE_ORDERS", self._orders)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self.kill()
        for name in self.environment:
            os.environ.pop(name, None)

    def tell(self, name: str, path: Path) -> None:
        """Set a variable to a file, for the servos that this process starts and those of a rig with `environment`."""
        self.environment[name] = os.environ[name] = str(path)

    @property
    def settings(self) -> dict[str, Any]:
        """Return the keys of the driver's section for this device."""
        if self.kind == "haply":
            return {"service": self.address}
        return {"library": str(libraries.build(self.kind))}

    @property
    def options(self) -> list[str]:
        """Return the options with which `telenano up` drives this device."""
        keys = [f"device={self.kind}", *(f"{self.kind}.{name}={value}" for name, value in self.settings.items())]
        return [word for key in keys for word in ("--set", f"haptic_node.{key}")]

    def start(self) -> None:
        """Start the emulated service, on its former port if it had one."""
        port = self.address.rsplit(":", 1)[-1] or "0"
        command = [sys.executable, "-m", "telenano", "device", "simulate", "haply", "--port", port, *self._options]
        self._process = subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True
        )
        assert self._process.stdout is not None
        self.address = re.findall(r"ws://\S+:\d+", self._process.stdout.readline())[0]

    def kill(self) -> None:
        """Kill -9 the emulated service; a double ends with its servo."""
        if self._process is None:
            return
        self._process.send_signal(signal.SIGKILL)
        self._process.wait()
        for pipe in (self._process.stdin, self._process.stdout):
            if pipe is not None:
                pipe.close()
        self._process = None

    def do(self, what: str, value: float = 1.0) -> None:
        """Give the device an order, in the words of the doubles, such as `push_n` 2.0."""
        if self._process is None:
            with self._orders.open("a") as file:
                file.write(f"{what} {value:g}\n")
            return
        if what == "offset_m":
            line, self._offset_m = f"jump {value - self._offset_m:g}", value
        elif what == "sign":
            line, self._sign = "sign" if value != self._sign else "", value
        else:
            line = LINES[what](value)
        assert self._process.stdin is not None
        self._process.stdin.write(line + "\n")
        self._process.stdin.flush()


def write_hand(path: Path, kind: str, person: Callable[[float], HandMotion], seconds: float) -> None:
    """Write the motion of a person during a session of some seconds [s] for a double, in the frame of its vendor."""

    def vendor(vector: tuple[float, float, float]) -> str:
        x, y, z = vector
        return "{:.9g} {:.9g} {:.9g}".format(*((-y, x, z) if kind == "dhd" else (x, z, -y)))

    with path.open("w") as file:
        for index in range(round(seconds / _ROW_S) + 1):
            at = person(index * _ROW_S)
            spring = f"{at.stiffness_n_per_m:g} {at.damping_n_s_per_m:g}"
            ends = f"{vendor(at.force_n)} {at.buttons} {int(at.plugged)}"
            file.write(f"{index * _ROW_S:.4f} {vendor(at.place_m)} {spring} {ends}\n")
