"""Force Dimension's omega, delta, sigma and lambda, and Novint's Falcon, by the vendor's DHD library.

Every call takes the device as its last argument, which is always passed. On failure it returns -1, and the reason is in
dhdErrorGetLast. The device's own watchdog is set, because it alone takes the force away when this process dies.

Frames: the device has +x towards the person, +y to the right and +z up.
"""

import ctypes
import time
from collections.abc import Callable
from typing import NamedTuple

from telenano.extend.hands import MODE_OFF, MODE_POSITION, UPRIGHT, Capabilities, DeviceError, Quaternion
from telenano.hand import ZERO, Vector
from telenano_haptic_devices.impedance_wire import Turn, quaternion_of
from telenano_haptic_devices.servo import DeviceSample
from telenano_haptic_devices.settings import DhdConfig
from telenano_haptic_devices.vendor_library import DHD, declare, is_double, load, tell_session

_ID, _REAL, _INT, _BYTE = ctypes.c_byte, ctypes.c_double, ctypes.c_int, ctypes.c_ubyte
_REALS, _INTS = ctypes.POINTER(_REAL), ctypes.POINTER(_INT)
_CALLS: dict[str, tuple[type | None, tuple[type, ...]]] = {
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
# 160 steps of 125 us are 20 ms.
_WATCHDOG_STEPS = 160
# Indices of dhdGetStatus, and the words of its cause of a force that is off.
_CONNECTED, _RESET, _WRIST, _ERROR, _FORCE_OFF = 1, 3, 8, 9, 14
_CAUSES = {
    1: "its force button",
    2: "its speed",
    3: "its watchdog",
    4: "the SDK",
    5: "its USB",
    6: "its dead-man button",
}
_STATUS_EVERY_S = 0.02


class Declared(NamedTuple):
    """What CHAI3D declares for a make: greatest force [N], stiffness [N/m], damping [N s/m], radius [m]."""

    force_n: float
    stiffness_n_per_m: float
    damping_n_s_per_m: float
    radius_m: float


_OMEGA, _DELTA = Declared(12.0, 5000.0, 30.0, 0.075), Declared(20.0, 5000.0, 30.0, 0.15)
_SIGMA, _LAMBDA = Declared(12.0, 4000.0, 30.0, 0.075), Declared(12.0, 8000.0, 30.0, 0.1125)
_FALCON = Declared(8.0, 3000.0, 20.0, 0.04)
# By the code of dhdGetSystemType.
_MAKES = {
    **dict.fromkeys((33, 34, 35, 36, 37), _OMEGA),
    63: _DELTA,
    **dict.fromkeys((104, 105, 206), _SIGMA),
    **dict.fromkeys((108, 109), _LAMBDA),
    60: _FALCON,
}
# The emulated omega of the tests: chosen, not measured.
_EMULATED_DAMPING_N_S_PER_M, _EMULATED_MASS_KG = 0.5, 0.25


class DhdWire:
    """An `ImpedanceWire` to one device of Force Dimension; a test replaces its clock [ns] and how it waits."""

    def __init__(
        self,
        settings: DhdConfig,
        *,
        now_ns: Callable[[], int] = time.monotonic_ns,
        sleep: Callable[[float], None] = time.sleep,
    ) -> None:
        self._settings, self._now_ns, self._sleep = settings, now_ns, sleep
        self._lib: ctypes.CDLL | None = None
        self._id = _ID(-1)
        self._name = "the device of Force Dimension"
        self._has_wrist = False

    def open(self) -> Capabilities:
        if self._lib is None:
            self._lib = load(DHD, self._settings.library)
            declare(self._lib, DHD.what, _CALLS)
        lib = self._lib
        if lib.dhdGetAvailableCount() <= 0:
            text = "no device of Force Dimension is free: switch it on, plug it in, end other programs that use it"
            raise DeviceError(text)
        serial = self._settings.serial
        opened = lib.dhdOpen() if serial is None else lib.dhdOpenSerial(serial)
        self._id = _ID(self._checked(opened, "dhdOpen"))
        try:
            return self._come_up(lib)
        except DeviceError:
            self.close()
            raise

    def run(self, turn: Turn) -> None:
        """Read, step and send at an absolute cadence; a call that takes longer than a period sets the rate itself."""
        lib = self._lib
        if lib is None:
            raise DeviceError(f"{self._name} is not open")
        x, y, z = _REAL(), _REAL(), _REAL()
        place = ctypes.byref(x), ctypes.byref(y), ctypes.byref(z), self._id
        period_ns, deadman = round(1e9 / self._settings.rate_hz), self._settings.deadman_button
        due_ns = status_ns = self._now_ns()
        error = ""
        while True:
            taken_ns = self._now_ns()
            self._checked(lib.dhdGetPosition(*place), "dhdGetPosition")
            if taken_ns >= status_ns:
                status_ns = taken_ns + round(_STATUS_EVERY_S * 1e9)
                error = self._trouble(lib)
            buttons = lib.dhdGetButtonMask(self._id)
            held = deadman is None or bool(buttons >> deadman & 1)
            orientation = self._orientation(lib)
            at = (y.value, -x.value, z.value)
            force = turn(DeviceSample(at, taken_ns, orientation, buttons, held, taken_ns, error))
            if force is None:
                return
            self._set_force(lib, force)
            due_ns = max(due_ns + period_ns, self._now_ns() - period_ns)
            if (left_ns := due_ns - self._now_ns()) > 0:
                self._sleep(left_ns * 1e-9)

    def session(self, runs: bool) -> None:
        if self._lib is not None:
            tell_session(self._lib, runs)

    def close(self) -> None:
        """Set no force, stop and close; what closing alone does to a force is not documented."""
        if self._lib is None or self._id.value < 0:
            return
        self._lib.dhdSetForce(0.0, 0.0, 0.0, self._id)
        self._lib.dhdStop(self._id)
        self._lib.dhdClose(self._id)
        self._id = _ID(-1)

    def _come_up(self, lib: ctypes.CDLL) -> Capabilities:
        make = _MAKES.get(self._checked(lib.dhdGetSystemType(self._id), "dhdGetSystemType"), _FALCON)
        serial = ctypes.c_ushort()
        self._checked(lib.dhdGetSerialNumber(ctypes.byref(serial), self._id), "dhdGetSerialNumber")
        emulated = is_double(lib)
        name = (lib.dhdGetSystemName(self._id) or b"device").decode(errors="replace")
        self._name = f"Force Dimension {name}, serial number {serial.value}" + ", emulated" * emulated
        self._has_wrist = bool(self._status(lib)[_WRIST])
        self._checked(lib.dhdEnableExpertMode(), "dhdEnableExpertMode")
        try:
            self._checked(lib.dhdSetWatchdog(_WATCHDOG_STEPS, self._id), "dhdSetWatchdog")
        finally:
            lib.dhdDisableExpertMode()
        self._checked(lib.dhdSetMaxForce(make.force_n, self._id), "dhdSetMaxForce")
        self._checked(lib.dhdEnableForce(1, self._id), "dhdEnableForce")
        self._set_force(lib, ZERO)
        ends = (-make.radius_m, make.radius_m)
        return Capabilities(
            max_force_n=make.force_n,
            max_stiffness_n_per_m=make.stiffness_n_per_m,
            max_damping_n_s_per_m=make.damping_n_s_per_m,
            workspace_min_m=-make.radius_m,
            workspace_max_m=make.radius_m,
            modes=(MODE_OFF, MODE_POSITION),
            identity=self._name,
            force_source="estimate",
            kind="impedance",
            axes=3,
            lateral_m=(ends, ends),
            rate_hz=self._settings.rate_hz,
            damping_n_s_per_m=_EMULATED_DAMPING_N_S_PER_M * emulated,
            mass_kg=_EMULATED_MASS_KG * emulated,
            # The force is sent in the period of its sample; a period is allowed for the line.
            drive_delay_s=1.0 / self._settings.rate_hz,
            buttons=("0", "1", "2", "3"),
            deadman="" if self._settings.deadman_button is None else str(self._settings.deadman_button),
            has_orientation=self._has_wrist,
        )

    def _checked(self, code: int, call: str) -> int:
        if code < 0:
            assert self._lib is not None
            reason = (self._lib.dhdErrorGetLastStr() or b"no reason").decode(errors="replace")
            raise DeviceError(f"{self._name}: {call} failed: {reason}")
        return code

    def _set_force(self, lib: ctypes.CDLL, force: Vector) -> None:
        x, y, z = force
        self._checked(lib.dhdSetForce(-y, x, z, self._id), "dhdSetForce")

    def _status(self, lib: ctypes.CDLL) -> list[int]:
        status = (_INT * 17)()
        self._checked(lib.dhdGetStatus(status, self._id), "dhdGetStatus")
        return list(status)

    def _trouble(self, lib: ctypes.CDLL) -> str:
        """Return why the device must not be driven now, in words; empty if it may."""
        status = self._status(lib)
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

    def _orientation(self, lib: ctypes.CDLL) -> Quaternion:
        if not self._has_wrist:
            return UPRIGHT
        frame = (_REAL * 9)()
        self._checked(lib.dhdGetOrientationFrame(frame, self._id), "dhdGetOrientationFrame")
        d = tuple(tuple(frame[3 * i : 3 * i + 3]) for i in range(3))
        # R in the master frame is P D P^T, where P takes (x, y, z) to (y, -x, z).
        rows = (d[1], tuple(-value for value in d[0]), d[2])
        return quaternion_of(tuple((row[1], -row[0], row[2]) for row in rows))
