"""Driver of Force Dimension's omega, delta, sigma and lambda, and Novint's Falcon, by the vendor's DHD library.

Every call gets the device as its last argument. On failure a call returns -1, and dhdErrorGetLast has the reason. The
driver sets the device's own watchdog, because only that removes the force when this process dies.

The device has +x towards the person, +y to the right and +z up.
"""

import ctypes
import platform
from typing import Any

from telenano.extend.hands import Capabilities, DeviceError
from telenano_devices.impedance.coupling import ZERO, Vector
from telenano_devices.impedance.vendor_library import LibraryWire, VendorLibrary, text_of
from telenano_devices.impedance.wires import Declared, Frame, Mechanics

LIBRARY = VendorLibrary(
    "Force Dimension SDK (libdhd)",
    # DRD has all of DHD; the versions are those of the SDK.
    ("libdrd.so.3", "libdhd.so.3", "libdrd.so", "libdhd.so", "drd64.dll", "dhd64.dll", "libdhd.dylib"),
    (f"$FDSDK/lib/release/lin-{platform.machine()}-gcc", "~/.local/lib", "/usr/local/lib", "/usr/lib"),
    "haptic_node.dhd.library",
    "get the SDK at forcedimension.com (Software), unpack it, and set FDSDK to its folder; it needs libusb-1.0",
    """
    int dhdGetAvailableCount() int dhdOpen() int dhdOpenSerial(int) int dhdClose(char) int dhdStop(char)
    char* dhdErrorGetLastStr() int dhdGetSystemType(char) char* dhdGetSystemName(char)
    int dhdGetSerialNumber(ushort*, char) int dhdGetStatus(int*, char) uint dhdGetButtonMask(char)
    int dhdGetPosition(double*, double*, double*, char) int dhdGetOrientationFrame(double*, char)
    int dhdSetForce(double, double, double, char) int dhdEnableForce(uchar, char) int dhdSetMaxForce(double, char)
    int dhdEnableExpertMode() int dhdDisableExpertMode() int dhdSetWatchdog(uchar, char)
    """,
)
# 160 steps of 125 us are 20 ms.
_WATCHDOG_STEPS = 160
# Indices into the array of dhdGetStatus.
_CONNECTED = 1
_RESET = 3
_WRIST = 8
_ERROR = 9
_FORCE_OFF = 14
# Causes of a force that is off, by their code in dhdGetStatus.
_CAUSES = {
    1: "its force button",
    2: "its speed",
    3: "its watchdog",
    4: "the SDK",
    5: "its USB",
    6: "its dead-man button",
}
# The values of each make as CHAI3D declares them.
_OMEGA = Declared(12.0, 5000.0, 30.0, 0.075)
_DELTA = Declared(20.0, 5000.0, 30.0, 0.15)
_SIGMA = Declared(12.0, 4000.0, 30.0, 0.075)
_LAMBDA = Declared(12.0, 8000.0, 30.0, 0.1125)
_FALCON = Declared(8.0, 3000.0, 20.0, 0.04)
# The makes by the code of dhdGetSystemType.
_MAKES = {
    **dict.fromkeys((33, 34, 35, 36, 37), _OMEGA),
    63: _DELTA,
    **dict.fromkeys((104, 105, 206), _SIGMA),
    **dict.fromkeys((108, 109), _LAMBDA),
    60: _FALCON,
}


class DhdWire(LibraryWire):
    """An `ImpedanceWire` to one device of Force Dimension."""

    library = LIBRARY
    frame = Frame("y -x z")
    # Mechanics of the emulated omega of the tests.
    arm = Mechanics(mass_kg=0.25, damping_n_s_per_m=0.5)
    status_every_ns = 20_000_000
    name = "the device of Force Dimension"

    def __init__(self, settings: Any, **clock: Any) -> None:
        super().__init__(settings, **clock)
        self._id, self._has_wrist = ctypes.c_byte(-1), False
        self._place, self._rows = [ctypes.c_double() for _ in "xyz"], (ctypes.c_double * 9)()

    def close(self) -> None:
        """Set zero force, stop and close the device; the effect of closing alone on a force is not documented."""
        if self._lib is None or self._id.value < 0:
            return
        self._lib.dhdSetForce(0.0, 0.0, 0.0, self._id)
        self._lib.dhdStop(self._id)
        self._lib.dhdClose(self._id)
        self._id = ctypes.c_byte(-1)

    def come_up(self) -> Capabilities:
        lib, wanted = self._lib, self._settings.serial
        if lib.dhdGetAvailableCount() <= 0:
            text = "no device of Force Dimension is free: switch it on, plug it in, end other programs that use it"
            raise DeviceError(text)
        opened = self.call("dhdOpen") if wanted is None else self.call("dhdOpenSerial", wanted)
        self._id = ctypes.c_byte(opened)
        make = _MAKES.get(self.call("dhdGetSystemType", self._id), _FALCON)
        serial = ctypes.c_ushort()
        self.call("dhdGetSerialNumber", ctypes.byref(serial), self._id)
        name = text_of(lib.dhdGetSystemName(self._id), "device")
        identity = f"Force Dimension {name}, serial number {serial.value}"
        self._has_wrist = bool(self._status()[_WRIST])
        able = self.declared(identity, make, ("0", "1", "2", "3"), self._has_wrist)
        self.call("dhdEnableExpertMode")
        try:
            self.call("dhdSetWatchdog", _WATCHDOG_STEPS, self._id)
        finally:
            lib.dhdDisableExpertMode()
        self.call("dhdSetMaxForce", make.force_n, self._id)
        self.call("dhdEnableForce", 1, self._id)
        self.write(ZERO)
        return able

    def read(self) -> tuple[list[float], int, list[list[float]] | None]:
        self.call("dhdGetPosition", *map(ctypes.byref, self._place), self._id)
        place, buttons = [each.value for each in self._place], self._lib.dhdGetButtonMask(self._id)
        if not self._has_wrist:
            return place, buttons, None
        self.call("dhdGetOrientationFrame", self._rows, self._id)
        return place, buttons, [self._rows[3 * i : 3 * i + 3] for i in range(3)]

    def write(self, force: Vector) -> None:
        self.call("dhdSetForce", *force, self._id)

    def reason(self, result: int) -> str:
        return text_of(self._lib.dhdErrorGetLastStr(), "no reason") if result < 0 else ""

    def _status(self) -> list[int]:
        status = (ctypes.c_int * 17)()
        self.call("dhdGetStatus", status, self._id)
        return list(status)

    def trouble(self) -> str:
        status = self._status()
        if not status[_CONNECTED]:
            raise DeviceError(f"{self.name} is not connected: plug it in")
        if status[_RESET]:
            return f"{self.name} is not calibrated: put its handle into the pit until the light stays on"
        if status[_ERROR]:
            return f"{self.name} reports an error: switch it off and on"
        if status[_FORCE_OFF]:
            cause = _CAUSES.get(status[_FORCE_OFF], "itself")
            return f"{self.name} has no force, which was switched off by {cause}"
        return ""
