"""The instrument of a configuration in simulated time: guard, programs and device of the node, without a bus."""

from collections.abc import Iterator
from typing import Any, NamedTuple

from proto.errors import RefusedError
from services.afm_node import safety
from services.afm_node.config import AfmConfig
from services.afm_node.driver import Oscillation
from services.afm_node.instrument import driver_of, reach_of, runner_of
from services.afm_node.physics.part import AfmSample
from services.afm_node.programs.lateral import Place, moved
from services.afm_node.programs.program import Inputs, Wanted
from services.afm_node.programs.runner import Report
from services.afm_node.programs.settings import InstrumentRequest

PERIOD_S = 1e-3
_AT_REST = Oscillation(0.0, 0.0)
_STANDS = Place(0.0, 0.0)


class Step(NamedTuple):
    """A step of a program: time [s], what the program was told and what it wanted, and what was measured then."""

    time_s: float
    inputs: Inputs
    wanted: Wanted[Any]
    sample: AfmSample


class VirtualInstrument:
    """A simulated instrument whose time is that of its steps.

    Args:
        config: The instrument, which must be a simulated one.
    """

    def __init__(self, config: AfmConfig) -> None:
        self.device = driver_of(config)
        if self.device.simulation is None:
            raise RefusedError("a real instrument has no simulated time: afm_node.driver must be simulated")
        self._limits, self._lateral = config.to_params().safety, config.to_lateral_params()
        self._programs = runner_of(config, self.device, reach_of(config, self.device), PERIOD_S)
        self._guard = safety.initial_safety_state(self._limits)
        self.time_s, self.place = 0.0, Place(0.0, 0.0)
        self._force_n, self._lateral_n = 0.0, (0.0, 0.0)
        self.outcome: Report | None = None
        self.device.open()

    def run(self, request: InstrumentRequest) -> Iterator[Step]:
        """Yield the steps of a program until the tip is retracted again; `outcome` then says how it ended.

        Raises:
            RefusedError: The program refuses what is asked of it.
        """
        self._programs.request(request, self._guard.mode, self.place, device_lost=False)
        self.outcome = None
        while self._programs.name:
            yield self._step()
        while self._guard.mode == safety.MODE_RETRACTING:
            self._carry_out(safety.ACTION_RETRACT, Wanted((), self._guard.base_m, self.place))

    def report(self) -> Report | None:
        """Return how far the program is that runs, None where none does."""
        return self._programs.report() if self._programs.name else None

    def _step(self) -> Step:
        vibrating, programs = self.device.vibration, self._programs
        oscillation = _AT_REST if vibrating is None else vibrating.oscillation
        inputs = Inputs(self._guard.base_m, self.place, self._force_n, self._lateral_n, oscillation, _STANDS)
        action, wanted = programs.step(inputs, PERIOD_S)
        if vibrating is not None:
            vibrating.vibrate(wanted.amplitude_m)
        sample, allowed = self._carry_out(action, wanted)
        programs.follow_guard(allowed.mode, allowed.reason)
        if programs.state in ("finished", "ended"):
            self.outcome = programs.report()
            programs.end()
        return Step(self.time_s, inputs, wanted, sample)

    def _carry_out(self, action: int, wanted: Wanted[Any]) -> tuple[AfmSample, safety.SafetyOutputs]:
        asked = safety.SafetyInputs(
            reference_m=wanted.base_m,
            command_age_s=0.0,
            action=action,
            arm_requested=self._guard.mode == safety.MODE_RETRACTED and action == safety.ACTION_POSITION,
            estop=False,
            force_n=self._force_n,
            lateral_n=(self._lateral_n[0] ** 2 + self._lateral_n[1] ** 2) ** 0.5,
        )
        self._guard, allowed = safety.safety_step(self._limits, self._guard, asked, PERIOD_S)
        if allowed.mode == safety.MODE_FOLLOW and wanted.place != self.place and self.device.stage is not None:
            self.place = moved(self._lateral, self.place, wanted.place, PERIOD_S)[0]
            self.device.stage.move_to(*self.place)
        self.time_s += PERIOD_S
        if self.device.simulation is not None:
            self.device.simulation.elapse(PERIOD_S)
            while self.device.simulation.settle():
                pass
        sample = self.device.exchange(allowed.base_m)
        self._force_n = sample.force_n
        if self.device.stage is not None:
            self._lateral_n = self.device.stage.lateral_force_n
        return sample, allowed
