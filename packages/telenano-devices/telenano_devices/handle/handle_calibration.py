"""Raw samples for the calibration of a handle by gauges and masses; the device is never driven."""

from typing import NamedTuple

from telenano.devices import SerialHandle
from telenano.extend.hands import DeviceError
from telenano_devices.line_fit import mean_of

STANDARD_GRAVITY_M_PER_S2 = 9.80665
_LEAST_SAMPLES = 20


class RawPoint(NamedTuple):
    """Means of position and force in counts, and the standard errors of the means."""

    position: float
    position_error: float
    force: float
    force_error: float


def sample_raw(handle: SerialHandle, duration_s: float) -> RawPoint:
    """Return the means over the samples that a handle sends unasked; the handle is not driven, and closed at the end.

    Args:
        handle: A handle that is not open yet, without a calibration.
        duration_s: The time to listen [s].

    Raises:
        DeviceError: No device answers, or it sends too few samples.
    """
    try:
        hello = handle.identify()
        states = handle.listen(duration_s)
    finally:
        handle.close()
    if len(states) < _LEAST_SAMPLES:
        raise DeviceError(f"{handle.path}: {hello.identity} sent {len(states)} samples, {_LEAST_SAMPLES} are needed")
    return RawPoint(*mean_of([state.position for state in states]), *mean_of([state.force for state in states]))
