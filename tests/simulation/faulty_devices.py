"""A hand and an instrument that can be lost, late, repeating or out of range; they wrap the simulated ones.

Each tells the world what its node had it do, and what it gave to the node, so that a judge need not believe the node.
"""

from collections.abc import Callable
from typing import Any

from telenano.extend.hands import HapticReport
from telenano.extend.instruments import AfmReport

# Number of steps by which a late sample is older.
_LATE_STEPS = 5
# Height by which a sample rises under the tip [m].
_RISE_M = 60e-9
_STATUS = {"lost": "lost", "late": "stale", "repeating": "stale"}
# Takes what a node told its device, and what the device gave to the node.
Account = Callable[..., None]


class _Faulty:
    """A device that returns the samples of a simulated one, changed by the present fault."""

    def __init__(self, device: Any, fault: Callable[[], str], period_s: float, account: Account) -> None:
        self._device, self._fault, self._period_s, self._account = device, fault, period_s, account
        self._samples: list[Any] = []
        self._status, self._age_s, self._valid = "ok", 0.0, True

    def __getattr__(self, name: str) -> Any:
        return getattr(self._device, name)

    @property
    def state(self) -> Any:
        return self._device.state

    @state.setter
    def state(self, state: Any) -> None:
        self._device.state = state

    def _passed(self, sample: Any) -> Any:
        fault = self._fault()
        self._status, self._valid = _STATUS.get(fault, "ok"), fault != "range"
        if fault in ("lost", "repeating") and self._samples:
            self._age_s += self._period_s
            return self._samples[-1]
        self._samples = [*self._samples[-_LATE_STEPS:], sample]
        late = fault == "late" and len(self._samples) > _LATE_STEPS
        self._age_s = _LATE_STEPS * self._period_s if late else 0.0
        return self._samples[0] if late else sample

    @property
    def _text(self) -> str:
        return {"ok": "the device is there", "stale": "the device repeats its samples"}.get(
            self._status, "the device is lost"
        )


class FaultyHand(_Faulty):
    """The operator's device. Out of range, its readings are invalid, and it reports itself as lost."""

    _command: Any = None

    @property
    def __class__(self) -> type:  # type: ignore[override]
        """The class of the simulated device, by which the node recognises a hand that a person at a page can push."""
        return type(self._device)

    def write(self, command: Any) -> None:
        self._command = command
        self._device.write(command)

    def read(self, session_time_s: float, dt_s: float) -> Any:
        reading = self._passed(self._device.read(session_time_s, dt_s))
        if not self._valid:
            self._status = "lost"
        if (told := self._command) is not None:
            self._account(told.mode, told.position_reference_m, reading.position_m, reading.motor_force_n)
        return reading

    @property
    def report(self) -> HapticReport:
        return HapticReport(self._status, self._age_s, False, self._text)  # type: ignore[arg-type]


class FaultyTip(_Faulty):
    """The instrument. Out of range, it reports its force as invalid; risen, the sample is nearer to it."""

    def exchange(self, base_m: float) -> Any:
        rise_m = _RISE_M if self._fault() == "risen" else 0.0
        sample = self._device.exchange(base_m + rise_m)
        if rise_m:
            sample = sample._replace(base_m=sample.base_m - rise_m)
        sample = self._passed(sample)
        self._account(base_m, sample.base_m, sample.force_n, self._status, self._valid)
        return sample

    @property
    def report(self) -> AfmReport:
        return AfmReport(self._status, self._age_s, self._valid, self._text)  # type: ignore[arg-type]
