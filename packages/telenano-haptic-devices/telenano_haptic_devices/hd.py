"""3D Systems' Touch and its relatives, by OpenHaptics' libHD.

The scheduler of the library has a thread of its own, and calls back 500 or 1000 times a second; the coupling runs in
that callback, inside one frame of the library. Errors are on a stack, which is emptied after each frame. The library is
loaded once and never unloaded, which its users found to fail.

Frames: the device has +x to the right, +y up and +z towards the person, in mm.
"""

import ctypes
import time
from collections.abc import Callable

from telenano.extend.hands import MODE_OFF, MODE_POSITION, Capabilities, DeviceError, Quaternion
from telenano.hand import ZERO, Vector
from telenano_haptic_devices.impedance_wire import Turn, quaternion_of
from telenano_haptic_devices.servo import DeviceSample
from telenano_haptic_devices.settings import HdConfig
from telenano_haptic_devices.vendor_library import HD, declare, is_double, load, tell_session

_BUTTONS, _POSITION, _TRANSFORM, _FORCE = 0x2000, 0x2050, 0x2052, 0x2700
_MODEL, _SERIAL, _USABLE, _STYLE = 0x2501, 0x2504, 0x2551, 0x2555
_STIFFNESS_N_PER_MM, _MAX_FORCE_N = 0x2602, 0x2603
_FORCE_OUTPUT = 0x4000
_CALIBRATED, _NEEDS_UPDATE = 0x5000, 0x5001
_INVALID = 0xFFFFFFFF
_CONTINUE, _DONE = 1, 0
_PRIORITY = 65_535
# The library's scheduler has stopped when it has not called in so many looks of so long, one after the other: 50 ms. A
# process that stood still as a whole has missed one look. The first call, and one that is not over, may take longer.
_WAIT_S, _SILENT_LOOKS, _PATIENT_LOOKS = 0.01, 5, 50
_MM = 1e-3
_NEARLY = 1.0 - 1e-6
# What CHAI3D declares for the Touch.
_DAMPING_N_S_PER_M = 4.0
# The emulated Touch of the tests: chosen, not measured.
_EMULATED_DAMPING_N_S_PER_M, _EMULATED_MASS_KG = 0.05, 0.045


class ErrorInfo(ctypes.Structure):
    """HDErrorInfo, which hdGetError returns by value."""

    _fields_ = (("code", ctypes.c_uint), ("internal", ctypes.c_int), ("device", ctypes.c_uint))


_U, _L, _TEXT, _REALS = ctypes.c_uint, ctypes.c_ulong, ctypes.c_char_p, ctypes.POINTER(ctypes.c_double)
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


class HdWire:
    """An `ImpedanceWire` to one Touch; a test replaces its monotonic clock [ns] and how it waits for the next look."""

    def __init__(
        self,
        settings: HdConfig,
        *,
        now_ns: Callable[[], int] = time.monotonic_ns,
        sleep: Callable[[float], None] = time.sleep,
    ) -> None:
        self._settings, self._now_ns, self._sleep = settings, now_ns, sleep
        self._lib: ctypes.CDLL | None = None
        self._device = _INVALID
        self._name = "the Touch"
        self._place, self._transform = (ctypes.c_double * 3)(), (ctypes.c_double * 16)()
        self._force, self._buttons = (ctypes.c_double * 3)(), ctypes.c_int()

    def open(self) -> Capabilities:
        if self._lib is None:
            self._lib = load(HD, self._settings.library)
            declare(self._lib, HD.what, _CALLS)
        lib = self._lib
        name = self._settings.name
        self._device = lib.hdInitDevice(None if name is None else name.encode())
        try:
            self._check("hdInitDevice")
            if self._device == _INVALID:
                raise DeviceError(
                    f"{self._name}: hdInitDevice gave no device: is the port yours, and the device paired?"
                )
            return self._come_up(lib)
        except DeviceError:
            self.close()
            raise

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
                    raise DeviceError(f"{self._name}: its scheduler calls no more (none for {silent * _WAIT_S:g} s)")
        finally:
            lib.hdStopScheduler()
            lib.hdUnschedule(handle)
        if faults:
            raise faults[0]

    def session(self, runs: bool) -> None:
        if self._lib is not None:
            tell_session(self._lib, runs)

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

    def _come_up(self, lib: ctypes.CDLL) -> Capabilities:
        model = (lib.hdGetString(_MODEL) or b"Touch").decode(errors="replace")
        serial = (lib.hdGetString(_SERIAL) or b"").decode(errors="replace")
        self._errors()
        emulated = is_double(lib)
        self._name = f"3D Systems {model}, serial number {serial}" + ", emulated" * emulated
        lib.hdSetSchedulerRate(self._settings.rate_hz)
        self._check("hdSetSchedulerRate")
        lib.hdEnable(_FORCE_OUTPUT)
        self._check("hdEnable")
        usable, value = (ctypes.c_double * 6)(), (ctypes.c_double * 1)()
        lib.hdGetDoublev(_USABLE, usable)
        lib.hdGetDoublev(_MAX_FORCE_N, value)
        # The library refuses more than its greatest force, which a clamp to just that passes by its last digit.
        max_force_n = value[0] * _NEARLY
        lib.hdGetDoublev(_STIFFNESS_N_PER_MM, value)
        self._check("hdGetDoublev")
        left, low, far, right, high, near = (_MM * end for end in usable)
        deadman = self._settings.deadman_button
        return Capabilities(
            max_force_n=max_force_n,
            max_stiffness_n_per_m=value[0] / _MM,
            max_damping_n_s_per_m=_DAMPING_N_S_PER_M,
            # Towards the sample is down.
            workspace_min_m=-high,
            workspace_max_m=-low,
            modes=(MODE_OFF, MODE_POSITION),
            identity=self._name,
            force_source="estimate",
            kind="impedance",
            axes=3,
            lateral_m=((left, right), (-near, -far)),
            rate_hz=float(self._settings.rate_hz),
            damping_n_s_per_m=_EMULATED_DAMPING_N_S_PER_M * emulated,
            mass_kg=_EMULATED_MASS_KG * emulated,
            # The force is sent in the frame of its sample; a period is allowed for the line.
            drive_delay_s=1.0 / self._settings.rate_hz,
            buttons=("1", "2", "3", "4"),
            deadman="" if deadman is None else str(deadman + 1),
            has_orientation=True,
        )

    def _frame(self, lib: ctypes.CDLL, turn: Turn) -> bool:
        """Do one frame; return whether there is to be another."""
        taken_ns = self._now_ns()
        lib.hdMakeCurrentDevice(self._device)
        lib.hdBeginFrame(self._device)
        lib.hdGetDoublev(_POSITION, self._place)
        lib.hdGetDoublev(_TRANSFORM, self._transform)
        lib.hdGetIntegerv(_BUTTONS, ctypes.byref(self._buttons))
        try:
            self._check("hdBeginFrame")
            x, y, z = self._place
            buttons = self._buttons.value
            deadman = self._settings.deadman_button
            held = deadman is None or bool(buttons >> deadman & 1)
            at = (_MM * x, -_MM * z, _MM * y)
            error = self._trouble(lib)
            force = turn(DeviceSample(at, taken_ns, self._orientation(), buttons, held, taken_ns, error))
            self._set_force(lib, ZERO if force is None else force)
        finally:
            lib.hdEndFrame(self._device)
        self._check("hdEndFrame")
        return force is not None

    def _set_force(self, lib: ctypes.CDLL, force: Vector) -> None:
        x, y, z = force
        self._force[:] = [x, z, -y]
        lib.hdSetDoublev(_FORCE, self._force)

    def _orientation(self) -> Quaternion:
        # Columns of the transform are the axes of the handle, in the frame of the device.
        d = tuple(tuple(self._transform[4 * column + row] for column in range(3)) for row in range(3))
        # R in the master frame is P D P^T, where P takes (x, y, z) to (x, -z, y).
        rows = (d[0], tuple(-value for value in d[2]), d[1])
        return quaternion_of(tuple((row[0], -row[2], row[1]) for row in rows))

    def _trouble(self, lib: ctypes.CDLL) -> str:
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
        found: list[int] = []
        while self._lib is not None and (code := self._lib.hdGetError().code) and len(found) < 100:
            found.append(code)
        return found

    def _check(self, call: str) -> None:
        found = self._errors()
        if found:
            assert self._lib is not None
            text = (self._lib.hdGetErrorString(found[-1]) or b"unknown error").decode(errors="replace")
            raise DeviceError(f"{self._name}: {call} failed: {text} ({found[-1]:#06x})")
