"""Driver of 3D Systems' Touch and its relatives, by OpenHaptics' libHD.

The scheduler of the library has a thread of its own, and calls back 500 or 1000 times a second; the coupling runs in
that callback, inside one frame of the library. The library keeps its errors on a stack, which the driver empties after
each frame. The library is loaded once and never unloaded, because its users found that unloading fails.

The device has +x to the right, +y up and +z towards the person, in mm.
"""

import ctypes
from typing import Any

from telenano.extend.hands import Capabilities, DeviceError
from telenano_devices.impedance.coupling import ZERO, Vector
from telenano_devices.impedance.impedance_wire import Turn
from telenano_devices.impedance.vendor_library import LibraryWire, VendorLibrary, text_of
from telenano_devices.impedance.wires import Declared, Frame, Mechanics

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
# The capability of libHD by which the motors render a force.
_FORCE_OUTPUT = 0x4000
# States of the calibration that the driver acts on.
_CALIBRATED = 0x5000
_NEEDS_UPDATE = 0x5001
# The handle that means no device.
_INVALID = 0xFFFFFFFF
# Results of a callback: call it again, or not.
_CONTINUE = 1
_DONE = 0
# The priority of the callback in the scheduler of the library, its highest.
_PRIORITY = 65_535
# Interval of the looks whether the library's scheduler has called back.
_WAIT_S = 0.01
# The scheduler counts as stopped after this many looks in a row without a call: 50 ms. A stall of the whole process
# costs only one look.
_SILENT_LOOKS = 5
# The first call, and a call that has not returned, may take this many looks.
_PATIENT_LOOKS = 50
_MM = 1e-3
# Forces are limited to this share of the device's greatest force, so that rounding does not exceed it.
_NEARLY = 1.0 - 1e-6
# The damping that CHAI3D declares for the Touch.
_DAMPING_N_S_PER_M = 4.0


class ErrorInfo(ctypes.Structure):
    """HDErrorInfo, which hdGetError returns by value."""

    _fields_ = (("code", ctypes.c_uint), ("internal", ctypes.c_int), ("device", ctypes.c_uint))


_CALLBACK = ctypes.CFUNCTYPE(ctypes.c_uint, ctypes.c_void_p)
LIBRARY = VendorLibrary(
    "OpenHaptics (libHD) of the Touch",
    ("libHD.so", "libHD.so.3.4", "libHD.so.3.0", "HD.dll"),
    ("/usr/lib", "/usr/lib64", "/usr/local/lib"),
    "haptic_node.hd.library",
    "get OpenHaptics and the Touch device driver at support.3dsystems.com; the driver's setup pairs the device first",
    """
    ErrorInfo hdGetError() char* hdGetErrorString(uint) uint hdInitDevice(char*) void hdDisableDevice(uint)
    void hdMakeCurrentDevice(uint) void hdEnable(uint) void hdDisable(uint) uint hdCheckCalibration()
    void hdUpdateCalibration(uint) void hdBeginFrame(uint) void hdEndFrame(uint) void hdGetDoublev(uint, double*)
    void hdGetIntegerv(uint, int*) char* hdGetString(uint) void hdSetDoublev(uint, double*)
    ulong hdScheduleAsynchronous(callback, void*, ushort) void hdUnschedule(ulong) void hdSetSchedulerRate(ulong)
    void hdStartScheduler() void hdStopScheduler()
    """,
    {"ErrorInfo": ErrorInfo, "callback": _CALLBACK},
)


class HdWire(LibraryWire):
    """An `ImpedanceWire` to one Touch."""

    library = LIBRARY
    frame = Frame("x -z y")
    # Mechanics of the emulated Touch of the tests.
    arm = Mechanics(mass_kg=0.045, damping_n_s_per_m=0.05)
    name = "the Touch"

    def __init__(self, settings: Any, **clock: Any) -> None:
        super().__init__(settings, **clock)
        self._device = _INVALID
        self._place, self._transform = (ctypes.c_double * 3)(), (ctypes.c_double * 16)()
        self._force, self._buttons = (ctypes.c_double * 3)(), ctypes.c_int()

    def run(self, turn: Turn) -> None:
        """Let the library's scheduler call `turn`, and wait until `turn` or a fault ends it.

        Raises:
            DeviceError: The device is not open, the scheduler has stopped, or a call has failed.
        """
        if self._lib is None:
            raise DeviceError(f"{self.name} is not open")
        # One element at the end: None if the servo has ended, or the exception of the last call.
        ends: list[BaseException | None] = []
        begun, done = [0], [0]

        def frame(data: int | None) -> int:
            begun[0] += 1
            try:
                if self._frame(turn):
                    return _CONTINUE
                ends.append(None)
            except BaseException as fault:  # noqa: BLE001
                # The exception must not pass through the library's thread; it is raised again in this one.
                ends.append(fault)
            finally:
                done[0] += 1
            return _DONE

        kept = _CALLBACK(frame)
        handle = self.call("hdScheduleAsynchronous", kept, None, _PRIORITY)
        self._lib.hdStartScheduler()
        try:
            self.check("hdStartScheduler")
            seen = silent = 0
            while not ends:
                self._sleep(_WAIT_S)
                # Silence counts from the last beginning or end of a call, so that a long call is none.
                calls = begun[0] + done[0]
                seen, silent = calls, silent + 1 if calls == seen else 0
                if silent >= (_SILENT_LOOKS if 0 < begun[0] == done[0] else _PATIENT_LOOKS):
                    # The caller then closes the device, which sets zero force from this thread.
                    raise DeviceError(f"{self.name}: its scheduler has stopped (no call for {silent * _WAIT_S:g} s)")
        finally:
            self._lib.hdStopScheduler()
            self._lib.hdUnschedule(handle)
        if ends[0] is not None:
            raise ends[0]

    def close(self) -> None:
        """Set zero force and release the device; the library stays loaded."""
        if self._lib is None or self._device == _INVALID:
            return
        self._lib.hdBeginFrame(self._device)
        self.write(ZERO)
        self._lib.hdEndFrame(self._device)
        self._lib.hdDisable(_FORCE_OUTPUT)
        self._lib.hdDisableDevice(self._device)
        self._device = _INVALID
        self._errors()

    def come_up(self) -> Capabilities:
        name = self._settings.name
        self._device = self.call("hdInitDevice", None if name is None else name.encode())
        if self._device == _INVALID:
            raise DeviceError(f"{self.name}: hdInitDevice gave no device: is the port yours, and the device paired?")
        model, serial = text_of(self._lib.hdGetString(_MODEL), "Touch"), text_of(self._lib.hdGetString(_SERIAL))
        self._errors()
        self.name = f"3D Systems {model}, serial number {serial}"
        self.call("hdSetSchedulerRate", self._settings.rate_hz)
        self.call("hdEnable", _FORCE_OUTPUT)
        left, low, far, right, high, near = (_MM * end for end in self._doubles(_USABLE, 6))
        (force_n,), (stiffness,) = self._doubles(_MAX_FORCE_N, 1), self._doubles(_STIFFNESS_N_PER_MM, 1)
        ends = (left, right), (-near, -far), (low, high)
        # The library refuses more than its greatest force, which a clamp to exactly that may exceed in its last digit.
        make = Declared(force_n * _NEARLY, stiffness / _MM, _DAMPING_N_S_PER_M, ends=ends)
        return self.declared(self.name, make, ("1", "2", "3", "4"), True)

    def _frame(self, turn: Turn) -> bool:
        """Process one frame, which `read` begins; return whether to continue."""
        try:
            continues = self.answered(turn)
        finally:
            self._lib.hdEndFrame(self._device)
        self.check("hdEndFrame")
        return continues

    def read(self) -> tuple[list[float], int, list[list[float]]]:
        self._lib.hdMakeCurrentDevice(self._device)
        self._lib.hdBeginFrame(self._device)
        self._lib.hdGetDoublev(_POSITION, self._place)
        self._lib.hdGetDoublev(_TRANSFORM, self._transform)
        self._lib.hdGetIntegerv(_BUTTONS, ctypes.byref(self._buttons))
        self.check("hdBeginFrame")
        # Columns of the transform are the axes of the handle, in the frame of the device.
        rows = [[self._transform[4 * column + row] for column in range(3)] for row in range(3)]
        return [_MM * value for value in self._place], self._buttons.value, rows

    def write(self, force: Vector) -> None:
        self._force[:] = list(force)
        self._lib.hdSetDoublev(_FORCE, self._force)

    def trouble(self) -> str:
        state = self._lib.hdCheckCalibration()
        if state == _CALIBRATED:
            return ""
        if state == _NEEDS_UPDATE:
            style = ctypes.c_int()
            self._lib.hdGetIntegerv(_STYLE, ctypes.byref(style))
            self._lib.hdUpdateCalibration(style.value)
        return f"{self.name} is not calibrated: put its stylus into the inkwell, and take it out again"

    def _doubles(self, parameter: int, count: int) -> list[float]:
        values = (ctypes.c_double * count)()
        self.call("hdGetDoublev", parameter, values)
        return list(values)

    def _errors(self) -> list[int]:
        """Return the error codes on the library's stack, the newest first, and empty the stack."""
        codes: list[int] = []
        while self._lib is not None and (code := self._lib.hdGetError().code) and len(codes) < 100:
            codes.append(code)
        return codes

    def reason(self, result: Any) -> str:
        codes = self._errors()
        return f"{text_of(self._lib.hdGetErrorString(codes[-1]), 'unknown error')} ({codes[-1]:#06x})" if codes else ""
