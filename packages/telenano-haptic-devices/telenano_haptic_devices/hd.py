"""3D Systems' Touch and its relatives, by OpenHaptics' libHD.

The scheduler of the library has a thread of its own, and calls back 500 or 1000 times a second; the coupling runs in
that callback, inside one frame of the library. Errors are on a stack, which is emptied after each frame. The library is
loaded once and never unloaded, which its users found to fail.

The device has +x to the right, +y up and +z towards the person, in mm.
"""

import ctypes
from typing import Any

from telenano.extend.hands import Capabilities, DeviceError
from telenano_haptic_devices.coupling import ZERO, Vector
from telenano_haptic_devices.impedance_wire import Turn
from telenano_haptic_devices.vendor_library import (
    LibraryWire,
    VendorLibrary,
    is_double,
)
from telenano_haptic_devices.wires import Declared, Frame, Mechanics, declared

# Parameters that libHD returns or takes, by the codes of its headers.
_BUTTONS = 0x2000
_POSITION = 0x2050
_TRANSFORM = 0x2052
_FORCE = 0x2700
_MODEL = 0x2501
_SERIAL = 0x2504
_USABLE = 0x2551
_STYLE = 0x2555
_STIFFNESS_N_PER_MM = 0x2602
_MAX_FORCE_N = 0x2603
# The capability of libHD that lets motors render a force.
_FORCE_OUTPUT = 0x4000
# States of the calibration that the driver acts on.
_CALIBRATED = 0x5000
_NEEDS_UPDATE = 0x5001
# The handle that stands for no device.
_INVALID = 0xFFFFFFFF
# A callback returns one of these to be called again, or not.
_CONTINUE = 1
_DONE = 0
# The priority of the callback in the scheduler of the library, its highest.
_PRIORITY = 65_535
# The driver looks at this interval whether the library's scheduler has called.
_WAIT_S = 0.01
# The scheduler has stopped when it has not called in this number of looks, one after the other: 50 ms. A process that
# stood still as a whole has missed one look.
_SILENT_LOOKS = 5
# The first call, and one that is not over, may take this number of looks.
_PATIENT_LOOKS = 50
_MM = 1e-3
# Forces are limited to this share of the most that the device takes, so that rounding does not exceed it.
_NEARLY = 1.0 - 1e-6
# What CHAI3D declares for the Touch.
_DAMPING_N_S_PER_M = 4.0
# the emulated Touch of the tests
_ARM = Mechanics(mass_kg=0.045, damping_n_s_per_m=0.05)
_FRAME = Frame("x -z y")


class ErrorInfo(ctypes.Structure):
    """HDErrorInfo, which hdGetError returns by value."""

    _fields_ = (("code", ctypes.c_uint), ("internal", ctypes.c_int), ("device", ctypes.c_uint))


# The types of arguments and results.
_U = ctypes.c_uint
_L = ctypes.c_ulong
_TEXT = ctypes.c_char_p
_REALS = ctypes.POINTER(ctypes.c_double)
_CALLBACK = ctypes.CFUNCTYPE(ctypes.c_uint, ctypes.c_void_p)
_CALLS: dict[str, tuple[type | None, tuple[type, ...]]] = {
    "hdGetError": (ErrorInfo, ()),
    "hdGetErrorString": (_TEXT, (_U,)),
    "hdInitDevice": (_U, (_TEXT,)),
    "hdDisableDevice": (None, (_U,)),
    "hdMakeCurrentDevice": (None, (_U,)),
    "hdEnable": (None, (_U,)),
    "hdDisable": (None, (_U,)),
    "hdCheckCalibration": (_U, ()),
    "hdUpdateCalibration": (None, (_U,)),
    "hdBeginFrame": (None, (_U,)),
    "hdEndFrame": (None, (_U,)),
    "hdGetDoublev": (None, (_U, _REALS)),
    "hdGetIntegerv": (None, (_U, ctypes.POINTER(ctypes.c_int))),
    "hdGetString": (_TEXT, (_U,)),
    "hdSetDoublev": (None, (_U, _REALS)),
    "hdScheduleAsynchronous": (_L, (_CALLBACK, ctypes.c_void_p, ctypes.c_ushort)),
    "hdUnschedule": (None, (_L,)),
    "hdSetSchedulerRate": (None, (_L,)),
    "hdStartScheduler": (None, ()),
    "hdStopScheduler": (None, ()),
}


LIBRARY = VendorLibrary(
    "OpenHaptics (libHD) of the Touch",
    ("libHD.so", "libHD.so.3.4", "libHD.so.3.0", "HD.dll"),
    ("/usr/lib", "/usr/lib64", "/usr/local/lib"),
    "haptic_node.hd.library",
    "get OpenHaptics and the Touch device driver at support.3dsystems.com; the driver's setup pairs the device first",
    _CALLS,
)


class HdWire(LibraryWire):
    """An `ImpedanceWire` to one Touch."""

    library = LIBRARY

    def __init__(self, settings: Any, **clock: Any) -> None:
        super().__init__(settings, **clock)
        self._device = _INVALID
        self._name = "the Touch"
        self._place, self._transform = (ctypes.c_double * 3)(), (ctypes.c_double * 16)()
        self._force, self._buttons = (ctypes.c_double * 3)(), ctypes.c_int()

    def run(self, turn: Turn) -> None:
        """Let the library's scheduler call `turn`, and wait until that or a fault ends it."""
        lib = self._lib
        if lib is None:
            raise DeviceError(f"{self._name} is not open")
        faults: list[BaseException] = []
        ended: list[bool] = []
        begun, done = [0], [0]

        def frame(data: int | None) -> int:
            begun[0] += 1
            try:
                if self._frame(lib, turn):
                    return _CONTINUE
                ended.append(True)
            except BaseException as fault:  # noqa: BLE001
                # It must not pass through the library's thread, and is raised again in this one.
                faults.append(fault)
            finally:
                done[0] += 1
            return _DONE

        kept = _CALLBACK(frame)
        handle = lib.hdScheduleAsynchronous(kept, None, _PRIORITY)
        self._check("hdScheduleAsynchronous")
        lib.hdStartScheduler()
        try:
            self._check("hdStartScheduler")
            seen = silent = 0
            while not (faults or ended):
                self._sleep(_WAIT_S)
                # A long call that has just ended is no silence: that counts from the last beginning or end of one.
                calls = begun[0] + done[0]
                seen, silent = calls, silent + 1 if calls == seen else 0
                if silent >= (_SILENT_LOOKS if 0 < begun[0] == done[0] else _PATIENT_LOOKS):
                    # What follows closes the device, which sets no force from this thread.
                    raise DeviceError(f"{self._name}: its scheduler has stopped (no call for {silent * _WAIT_S:g} s)")
        finally:
            lib.hdStopScheduler()
            lib.hdUnschedule(handle)
        if faults:
            raise faults[0]

    def close(self) -> None:
        """Set no force and give the device back; the library stays loaded."""
        if self._lib is None or self._device == _INVALID:
            return
        self._lib.hdBeginFrame(self._device)
        self._set_force(self._lib, ZERO)
        self._lib.hdEndFrame(self._device)
        self._lib.hdDisable(_FORCE_OUTPUT)
        self._lib.hdDisableDevice(self._device)
        self._device = _INVALID
        self._errors()

    def _come_up(self) -> Capabilities:
        lib, settings = self._lib, self._settings
        self._device = lib.hdInitDevice(None if settings.name is None else settings.name.encode())
        self._check("hdInitDevice")
        if self._device == _INVALID:
            raise DeviceError(f"{self._name}: hdInitDevice gave no device: is the port yours, and the device paired?")
        model = (lib.hdGetString(_MODEL) or b"Touch").decode(errors="replace")
        serial = (lib.hdGetString(_SERIAL) or b"").decode(errors="replace")
        self._errors()
        self._name = f"3D Systems {model}, serial number {serial}"
        lib.hdSetSchedulerRate(settings.rate_hz)
        self._check("hdSetSchedulerRate")
        lib.hdEnable(_FORCE_OUTPUT)
        self._check("hdEnable")
        usable, force, stiffness = (ctypes.c_double * 6)(), (ctypes.c_double * 1)(), (ctypes.c_double * 1)()
        lib.hdGetDoublev(_USABLE, usable)
        lib.hdGetDoublev(_MAX_FORCE_N, force)
        lib.hdGetDoublev(_STIFFNESS_N_PER_MM, stiffness)
        self._check("hdGetDoublev")
        left, low, far, right, high, near = (_MM * end for end in usable)
        able = declared(
            self._name,
            # The library refuses more than its greatest force, which a clamp to just that passes by its last digit.
            Declared(
                force[0] * _NEARLY,
                stiffness[0] / _MM,
                _DAMPING_N_S_PER_M,
                ends=((left, right), (-near, -far), (low, high)),
            ),
            settings.rate_hz,
            arm=_ARM if is_double(lib) else None,
            buttons=("1", "2", "3", "4"),
            deadman="" if settings.deadman_button is None else str(settings.deadman_button + 1),
            has_orientation=True,
        )
        self._name = able.identity
        return able

    def _frame(self, lib: Any, turn: Turn) -> bool:
        """Do one frame; return whether there is to be another."""
        taken_ns = self._now_ns()
        lib.hdMakeCurrentDevice(self._device)
        lib.hdBeginFrame(self._device)
        lib.hdGetDoublev(_POSITION, self._place)
        lib.hdGetDoublev(_TRANSFORM, self._transform)
        lib.hdGetIntegerv(_BUTTONS, ctypes.byref(self._buttons))
        try:
            self._check("hdBeginFrame")
            # Columns of the transform are the axes of the handle, in the frame of the device.
            rows = [[self._transform[4 * column + row] for column in range(3)] for row in range(3)]
            sample = _FRAME.sample(
                [_MM * value for value in self._place],
                taken_ns,
                buttons=self._buttons.value,
                deadman=self._settings.deadman_button,
                orientation=_FRAME.orientation(rows),
                error=self._trouble(lib),
            )
            force = turn(sample)
            self._set_force(lib, ZERO if force is None else force)
        finally:
            lib.hdEndFrame(self._device)
        self._check("hdEndFrame")
        return force is not None

    def _set_force(self, lib: Any, force: Vector) -> None:
        self._force[:] = list(_FRAME.to_device(force))
        lib.hdSetDoublev(_FORCE, self._force)

    def _trouble(self, lib: Any) -> str:
        state = lib.hdCheckCalibration()
        if state == _CALIBRATED:
            return ""
        if state == _NEEDS_UPDATE:
            style = ctypes.c_int()
            lib.hdGetIntegerv(_STYLE, ctypes.byref(style))
            lib.hdUpdateCalibration(style.value)
        return f"{self._name} is not calibrated: put its stylus into the inkwell, and take it out again"

    def _errors(self) -> list[int]:
        """Return the errors on the library's stack, the newest first, and leave it empty."""
        codes: list[int] = []
        while self._lib is not None and (code := self._lib.hdGetError().code) and len(codes) < 100:
            codes.append(code)
        return codes

    def _check(self, call: str) -> None:
        codes = self._errors()
        if codes:
            text = (self._lib.hdGetErrorString(codes[-1]) or b"unknown error").decode(errors="replace")
            raise DeviceError(f"{self._name}: {call} failed: {text} ({codes[-1]:#06x})")
