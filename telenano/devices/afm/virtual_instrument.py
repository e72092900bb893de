"""A configured instrument in simulated time: guard, programs and device of the node, without a bus.

For example, a force curve:

    instrument = VirtualInstrument(AfmConfig())
    for step in instrument.run({"program": "curve"}):
        instrument.state()["tip_force_n"]
    instrument.outcome.state                   # "finished"
"""

from collections.abc import Iterator, Mapping
from typing import Any

from telenano.afm.programs.runner import Report
from telenano.afm.safety import ACTION_RETRACT, MODE_RETRACTING, initial_safety_state
from telenano.devices.afm.guarded import AfmMemory, AfmPart, GuardedInstrument, Stage, Step, line_fields
from telenano.devices.afm.instrument import driver_of, reach_of, runner_of
from telenano.extend.instruments import Simulation
from telenano.extend.programs import Wanted
from telenano.sections.afm_section import AfmConfig
from telenano.sections.program_requests import requested
from telenano.wire.errors import RefusedError
from telenano.wire.messages import Scalar

PERIOD_S = 1e-3


class _WholeTime(AfmPart):
    """Simulates the whole known motion at once, because no other task waits for the processor."""

    def __init__(self, simulation: Simulation) -> None:
        self._simulation = simulation

    def prepare(self, step: Step, memory: AfmMemory) -> None:
        self._simulation.elapse(step.elapsed_s)
        while self._simulation.settle():
            pass


class VirtualInstrument:
    """A simulated instrument whose time is that of its steps, 1 ms each.

    Args:
        config: The configuration of the instrument, which must be simulated; RefusedError is raised for a real one.
    """

    def __init__(self, config: AfmConfig) -> None:
        self.config, self.device = config, driver_of(config)
        if self.device.simulation is None:
            raise RefusedError("a real instrument has no simulated time: afm_node.driver must be simulated")
        limits = config.to_params().safety
        self._memory = AfmMemory(initial_safety_state(limits))
        self._programs = runner_of(config, self.device, reach_of(config, self.device), PERIOD_S)
        self.time_s = 0.0
        self.outcome: Report | None = None
        self._step: Step | None = None
        self.device.open()
        parts: list[AfmPart] = [_WholeTime(self.device.simulation)]
        if self.device.stage is not None:
            parts.append(Stage(self.device.stage, config.to_lateral_params()))
        self._instrument = GuardedInstrument(limits, self.device, parts)

    def run(self, parameters: Mapping[str, Scalar]) -> Iterator[Step]:
        """Yield the steps of a program, then retract the tip; `outcome` is then the last report.

        Args:
            parameters: The program and its settings by dotted key, as in `session set`: {"program": "scan",
                "scan.pixels": 64}.

        Raises:
            RefusedError: The program cannot begin with these settings.
        """
        memory = self._memory
        self._programs.request(requested(parameters), memory.guard.mode, memory.place, device_lost=False)
        self.outcome = None
        while self._programs.name:
            self.time_s += PERIOD_S
            self._step = step = self._instrument.step_program(memory, self._programs, PERIOD_S)
            if self._programs.is_over:
                self.outcome = self._programs.report()
                self._programs.end()
            yield step
        while memory.guard.mode == MODE_RETRACTING:
            self.time_s += PERIOD_S
            base_m = memory.guard.base_m
            asked = memory.asks(base_m, ACTION_RETRACT, 0.0, False, False, False)
            self._instrument.step(memory, asked, Wanted((), base_m, memory.place), PERIOD_S)

    def state(self) -> dict[str, Any]:
        """Return the fields of afm/state after the last step of a program, empty before the first."""
        if self._step is None:
            return {}
        return {"command_seq": 0, "hand_seq": 0, "hand_t_ns": 0, **self._step.fields(self._memory)}

    def scanline(self) -> dict[str, Any] | None:
        """Return the fields of afm/scanline if the last step has finished a line of an image, else None."""
        line = None if self._step is None else self._step.wanted.line
        if line is None:
            return None
        # With the last line the program is over, and there is no report.
        lines = line.line + 1 if (report := self.report()) is None else report.lines
        return line_fields(line, lines, self.config.friction)

    @property
    def truths(self) -> Mapping[str, Any]:
        """Return the truths of the layers on the sample, by name, which no instrument can measure."""
        return {} if self.device.simulation is None else self.device.simulation.truths

    def report(self) -> Report | None:
        """Return the report of the running program, None if none runs."""
        return self._programs.report() if self._programs.name else None
