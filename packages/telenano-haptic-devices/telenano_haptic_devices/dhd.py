"""Force Dimension's omega, delta, sigma and lambda, and Novint's Falcon, by the vendor's DHD library.

Every call takes the device as its last argument, which is always passed. On failure it returns -1, and the reason is in
dhdErrorGetLast. The device's own watchdog is set, because it alone takes the force away when this process dies.

The device has +x towards the person, +y to the right and +z up.
"""

import ctypes
import platform
from typing import Any

from telenano.extend.hands import Capabilities, DeviceError
from telenano_haptic_devices.coupling import UPRIGHT, ZERO, Quaternion, Vector
from telenano_haptic_devices.impedance_wire import Turn
from telenano_haptic_devices.vendor_library import (
    LibraryWire,
    VendorLibrary,
    is_double,
)
from telenano_haptic_devices.wires import Cadence, Declared, Frame, Mechanics, declared

# The types of arguments and results.
_ID = ctypes.c_byte
_REAL = ctypes.c_double
_INT = ctypes.c_int
_BYTE = ctypes.c_ubyte
_REALS = ctypes.POINTER(_REAL)
_INTS = ctypes.POINTER(_INT)
_CALLS: dict[str, tuple[type, tuple[type, ...]]] = {
    "dhdGetAvailableCount": (_INT, ()),
    "dhdErrorGetLast": (_INT, ()),
    "dhdErrorGetLastStr": (ctypes.c_char_p, ()),
    "dhdOpen": (_INT, ()),
    "dhdOpenSerial": (_INT, (_INT,)),
    "dhdClose": (_INT, (_ID,)),
    "dhdStop": (_INT, (_ID,)),
    "dhdGetSystemType": (_INT, (_ID,)),
    "dhdGetSystemName": (ctypes.c_char_p, (_ID,)),
    "dhdGetSerialNumber": (_INT, (ctypes.POINTER(ctypes.c_ushort), _ID)),
    "dhdGetPosition": (_INT, (_REALS, _REALS, _REALS, _ID)),
    "dhdGetOrientationFrame": (_INT, (_REALS, _ID)),
    "dhdGetButtonMask": (ctypes.c_uint, (_ID,)),
    "dhdGetStatus": (_INT, (_INTS, _ID)),
    "dhdSetForce": (_INT, (_REAL, _REAL, _REAL, _ID)),
    "dhdEnableForce": (_INT, (_BYTE, _ID)),
    "dhdSetMaxForce": (_INT, (_REAL, _ID)),
    "dhdEnableExpertMode": (_INT, ()),
    "dhdDisableExpertMode": (_INT, ()),
    "dhdSetWatchdog": (_INT, (_BYTE, _ID)),
}
LIBRARY = VendorLibrary(
    "Force Dimension SDK (libdhd)",
    # DRD has all of DHD; the versions are those of the SDK.
    ("libdrd.so.3", "libdhd.so.3", "libdrd.so", "libdhd.so", "drd64.dll", "dhd64.dll", "libdhd.dylib"),
    (f"$FDSDK/lib/release/lin-{platform.machine()}-gcc", "~/.local/lib", "/usr/local/lib", "/usr/lib"),
    "haptic_node.dhd.library",
    "get the SDK at forcedimension.com (Software), unpack it, and set FDSDK to its folder; it needs libusb-1.0",
    _CALLS,
)
_FRAME = Frame("y -x z")
# 160 steps of 125 us are 20 ms.
_WATCHDOG_STEPS = 160
# indices of dhdGetStatus
_CONNECTED = 1
_RESET = 3
_WRIST = 8
_ERROR = 9
_FORCE_OFF = 14
# What dhdGetStatus has as the cause of a force that is off.
_CAUSES = {
    1: "its force button",
    2: "its speed",
    3: "its watchdog",
    4: "the SDK",
    5: "its USB",
    6: "its dead-man button",
}
_STATUS_EVERY_NS = 20_000_000
# The values of each make are those that CHAI3D declares.
_OMEGA = Declared(12.0, 5000.0, 30.0, 0.075)
_DELTA = Declared(20.0, 5000.0, 30.0, 0.15)
_SIGMA = Declared(12.0, 4000.0, 30.0, 0.075)
_LAMBDA = Declared(12.0, 8000.0, 30.0, 0.1125)
_FALCON = Declared(8.0, 3000.0, 20.0, 0.04)
# By the code of dhdGetSystemType.
_MAKES = {
    **dict.fromkeys((33, 34, 35, 36, 37), _OMEGA),
    63: _DELTA,
    **dict.fromkeys((104, 105, 206), _SIGMA),
    **dict.fromkeys((108, 109), _LAMBDA),
    60: _FALCON,
}
# the emulated omega of the tests
_ARM = Mechanics(mass_kg=0.25, damping_n_s_per_m=0.5)


class DhdWire(LibraryWire):
    """An `ImpedanceWire` to one device of Force Dimension."""

    library = LIBRARY

    def __init__(self, settings: Any, **clock: Any) -> None:
        super().__init__(settings, **clock)
        self._id = _ID(-1)
        self._name = "the device of Force Dimension"
        self._has_wrist = False

    def run(self, turn: Turn) -> None:
        """Read, step and send at an absolute cadence; a call that takes longer than a period sets the rate itself."""
        lib = self._lib
        if lib is None:
            raise DeviceError(f"{self._name} is not open")
        x, y, z = _REAL(), _REAL(), _REAL()
        place = ctypes.byref(x), ctypes.byref(y), ctypes.byref(z), self._id
        cadence, deadman = Cadence(self._settings.rate_hz, self._now_ns, self._sleep), self._settings.deadman_button
        status_ns, error = self._now_ns(), ""
        while True:
            taken_ns = self._now_ns()
            self._checked(lib.dhdGetPosition(*place), "dhdGetPosition")
            if taken_ns >= status_ns:
                status_ns, error = taken_ns + _STATUS_EVERY_NS, self._trouble()
            buttons, turned = lib.dhdGetButtonMask(self._id), self._orientation()
            at = (x.value, y.value, z.value)
            force = turn(_FRAME.sample(at, taken_ns, buttons=buttons, deadman=deadman, orientation=turned, error=error))
            if force is None:
                return
            self._set_force(force)
            cadence.wait()

    def close(self) -> None:
        """Set no force, stop and close; what closing alone does to a force is not documented."""
        if self._lib is None or self._id.value < 0:
            return
        self._lib.dhdSetForce(0.0, 0.0, 0.0, self._id)
        self._lib.dhdStop(self._id)
        self._lib.dhdClose(self._id)
        self._id = _ID(-1)

    def _come_up(self) -> Capabilities:
        lib, wanted = self._lib, self._settings.serial
        if lib.dhdGetAvailableCount() <= 0:
            text = "no device of Force Dimension is free: switch it on, plug it in, end other programs that use it"
            raise DeviceError(text)
        opened = lib.dhdOpen() if wanted is None else lib.dhdOpenSerial(wanted)
        self._id = _ID(self._checked(opened, "dhdOpen"))
        make = _MAKES.get(self._checked(lib.dhdGetSystemType(self._id), "dhdGetSystemType"), _FALCON)
        serial = ctypes.c_ushort()
        self._checked(lib.dhdGetSerialNumber(ctypes.byref(serial), self._id), "dhdGetSerialNumber")
        name = (lib.dhdGetSystemName(self._id) or b"device").decode(errors="replace")
        able = declared(
            f"Force Dimension {name}, serial number {serial.value}",
            make,
            self._settings.rate_hz,
            arm=_ARM if is_double(lib) else None,
            buttons=("0", "1", "2", "3"),
            deadman="" if self._settings.deadman_button is None else str(self._settings.deadman_button),
            has_orientation=bool(self._status()[_WRIST]),
        )
        self._name, self._has_wrist = able.identity, able.has_orientation
        self._checked(lib.dhdEnableExpertMode(), "dhdEnableExpertMode")
        try:
            self._checked(lib.dhdSetWatchdog(_WATCHDOG_STEPS, self._id), "dhdSetWatchdog")
        finally:
            lib.dhdDisableExpertMode()
        self._checked(lib.dhdSetMaxForce(make.force_n, self._id), "dhdSetMaxForce")
        self._checked(lib.dhdEnableForce(1, self._id), "dhdEnableForce")
        self._set_force(ZERO)
        return able

    def _checked(self, code: int, call: str) -> int:
        if code < 0:
            reason = (self._lib.dhdErrorGetLastStr() or b"no reason").decode(errors="replace")
            raise DeviceError(f"{self._name}: {call} failed: {reason}")
        return code

    def _set_force(self, force: Vector) -> None:
        self._checked(self._lib.dhdSetForce(*_FRAME.to_device(force), self._id), "dhdSetForce")

    def _status(self) -> list[int]:
        status = (_INT * 17)()
        self._checked(self._lib.dhdGetStatus(status, self._id), "dhdGetStatus")
        return list(status)

    def _trouble(self) -> str:
        """Return why the device must not be driven now, in words; empty if it may."""
        status = self._status()
        if not status[_CONNECTED]:
            raise DeviceError(f"{self._name} is not connected: plug it in")
        if status[_RESET]:
            return f"{self._name} is not calibrated: put its handle into the pit until the light stays on"
        if status[_ERROR]:
            return f"{self._name} reports an error: switch it off and on"
        if status[_FORCE_OFF]:
            cause = _CAUSES.get(status[_FORCE_OFF], "itself")
            return f"{self._name} has no force, which was switched off by {cause}"
        return ""

    def _orientation(self) -> Quaternion:
        if not self._has_wrist:
            return UPRIGHT
        frame = (_REAL * 9)()
        self._checked(self._lib.dhdGetOrientationFrame(frame, self._id), "dhdGetOrientationFrame")
        return _FRAME.orientation([frame[3 * i : 3 * i + 3] for i in range(3)])
