"""The dynamic cantilever as the instrument of a node: in contact, tapping, noisy, refused, and in a journal."""

from typing import Any

import numpy as np
import pytest
from instrument_theory import drive_work_j
from pydantic import ValidationError

from services.afm_node.node import AfmNode
from telenano.afm.disturbances import BOLTZMANN_J_PER_K
from telenano.afm.dynamic import free_amplitude_m
from telenano.afm.safety import MODE_ESTOP, MODE_FOLLOW, MODE_RETRACTED, MODE_RETRACTING
from telenano.afm.sample.surface import height_at
from telenano.afm.sim import SimulatedInstrument, simulated_afm
from telenano.devices.afm.instrument import dynamic_afm
from telenano.sections.afm_section import AfmConfig
from telenano.settings.afm_disturbances import DisturbanceConfig
from telenano.wire.errors import ConfigError, RefusedError
from telenano.wire.node_state import pack, restore

SOFT = {
    "model": "dynamic",
    "cantilever": {"stiffness_n_per_m": 1.0},
    "sample": {"name": "grating", "size_m": 120e-9, "period_m": 60e-9, "height_m": 3e-9, "pixels": 64},
    "safety": {"retract_position_m": -40e-9},
}
TAPPING = {
    "program": "scan",
    "scan.mode": "tapping",
    "scan.pixels": 16,
    "scan.lines": 1,
    "scan.width_m": 80e-9,
    "scan.dwell_s": 20e-3,
    "scan.approach_m_per_s": 1e-6,
    "scan.settle_s": 0.15,
}


def instrument(section: dict[str, Any]) -> SimulatedInstrument:
    driver = dynamic_afm(AfmConfig.model_validate(section))
    assert driver.vibration is not None
    return driver


def tip_of(afm: SimulatedInstrument) -> Any:
    """The state of the dynamic cantilever, which may be over a surface."""
    part = afm.state.part
    return getattr(part, "tip", part)


def settled(afm: SimulatedInstrument) -> None:
    """Let an instrument do all that nothing waits for, which takes it some parts."""
    parts = 1
    while afm.settle():
        parts += 1
    # of 4500 steps: 32 or 96 a period
    assert parts == (3 if afm.state.inputs.amplitude_m > 0.0 else 1)


class Tapper:
    """A node with the dynamic cantilever on a bench."""

    def __init__(self, bench: Any) -> None:
        self.bench = bench
        self.config = AfmConfig.model_validate(SOFT)
        self.driver = instrument(SOFT)
        self.node = AfmNode(bench.context, self.config, self.driver)

    def set(self, **parameters: Any) -> str:
        fields = {"id": "a", "command": "set", "target": "afm_node", "parameters": parameters}
        return self.node.on_control(self.bench.make("session/control", "console@master", **fields))

    def run(self, *, until: Any) -> None:
        clock = self.bench.clock
        for _ in range(5_000):
            clock.advance_ns(max(0, self.node.deadline_ns() - clock.monotonic_ns()))
            self.node.on_deadline(clock.monotonic_ns())
            if until():
                return
        raise AssertionError("waited in vain")


@pytest.mark.check("takes 5 s")
def test_in_contact_the_dynamic_cantilever_goes_where_the_quasi_static_one_goes() -> None:
    section = {"model": "dynamic"}
    config = AfmConfig.model_validate(section)
    dynamic, static = instrument(section), simulated_afm(config.to_params())
    dynamic.open()
    static.open()
    contacts = 0
    for base_m in [*np.arange(-5e-9, 14e-9, 0.2e-9).tolist(), *np.arange(14e-9, -5e-9, -0.2e-9).tolist()]:
        # the tip comes to rest within some ms (Q = 100), and stays on its branch
        for _ in range(4):
            settled(dynamic)
            dynamic.elapse(1e-3)
            found = dynamic.exchange(base_m)
        expected = static.exchange(base_m)
        assert (found.base_m, found.in_contact, found.meniscus) == (base_m, expected.in_contact, expected.meniscus)
        assert found.force_n == pytest.approx(expected.force_n, rel=2e-3, abs=2e-12)
        assert found.distance_m == pytest.approx(expected.distance_m, rel=0, abs=2e-12)
        contacts += expected.in_contact
    assert 30 < contacts < 150


def test_a_tapping_image_holds_the_amplitude_and_its_lines_carry_amplitude_and_phase(bench_of: Any) -> None:
    afm = Tapper(bench_of("afm_node@slave"))
    assert "16 x 1" in afm.set(**TAPPING)
    afm.run(until=lambda: not afm.node._programs.name)
    trace, retrace = afm.bench.take("afm/scanline")
    surface = afm.config.to_surface()
    assert surface is not None
    columns = ((np.linspace(trace.start_m[0], trace.end_m[0], 16) + 60e-9) / surface.step_x_m).astype(int)
    truth = surface.height_m[0, columns]
    for line in (trace, retrace):
        seen = line.height_m.to_numpy() - np.mean(line.height_m.to_numpy()) + truth.mean()
        # a flank takes some pixels, all else is level
        assert np.median(np.abs(seen - truth)) < 0.3e-9
        assert np.corrcoef(seen, truth)[0, 1] > 0.95
        assert np.median(line.amplitude_m.to_numpy()) == pytest.approx(16e-9, rel=0.01, abs=0.0)
        # without a sample it is a quarter of a period behind; a tip held at 0.8 of that amplitude by repulsion is less
        phases = np.abs(line.phase_rad.to_numpy())
        assert np.all((phases > 0.5) & (phases < 2.7))
        # in steady vibration the sample takes what the base gives and the cantilever's own damping does not
        plant, free_m = afm.driver._params.plant.tip.driven, 20e-9
        drive_m, turns_hz = free_m / free_amplitude_m(plant, 1.0), 2.0 * np.pi * plant.drive_hz
        z = line.amplitude_m.to_numpy() * np.exp(1j * (line.phase_rad.to_numpy() + np.pi))
        given_j = np.array([drive_work_j(plant, drive_m, v.real, v.imag) for v in z.tolist()])
        damped_j = np.pi * turns_hz * plant.damping_kg_per_s * np.abs(z) ** 2
        taken_j = np.median(line.dissipated_j.to_numpy())
        assert taken_j == pytest.approx(np.median(given_j - damped_j), rel=0.05, abs=0.0)
    # away from the sample the tip comes to rest
    afm.run(until=lambda: afm.node._memory.guard.mode == MODE_RETRACTED)
    assert afm.driver.oscillation == (0.0, 0.0, 0.0)
    assert tip_of(afm.driver).motion.contact is False
    reports = afm.bench.take("afm/program")
    assert (reports[-1].state, "the amplitude settles" in {report.text for report in reports}) == ("finished", True)


@pytest.mark.parametrize("ends", ["finished", "aborted", "stopped", "pressed too hard"])
def test_a_tip_taps_until_it_is_away_however_its_image_ends(bench_of: Any, ends: str) -> None:
    afm = Tapper(bench_of("afm_node@slave"))
    afm.set(**TAPPING)
    memory, retracted_m = afm.node._memory, afm.config.safety.retract_position_m
    if ends != "finished":
        afm.run(until=lambda: memory.guard.mode == MODE_FOLLOW and memory.guard.base_m > retracted_m + 10e-9)
    if ends == "aborted":
        afm.set(program="abort")
    elif ends == "stopped":
        stop = {"id": "b", "command": "estop", "target": "", "parameters": {}}
        afm.node.on_control(afm.bench.make("session/control", "console@master", **stop))
    elif ends == "pressed too hard":
        memory.force_n = 1.0
    afm.run(until=lambda: memory.guard.mode in (MODE_RETRACTING, MODE_ESTOP))
    while memory.guard.base_m > retracted_m:
        assert afm.driver.state.inputs.amplitude_m == 20e-9
        afm.run(until=lambda: True)
    assert afm.driver.state.inputs.amplitude_m == 0.0


@pytest.mark.check("takes 0.8 s")
def test_a_proportional_gain_follows_an_edge_more_closely_in_tapping_mode_too(bench_of: Any) -> None:
    errors, apart = [], []
    for proportional in (0.0, 0.4):
        afm = Tapper(bench_of("afm_node@slave"))
        afm.set(**{**TAPPING, "scan.dwell_s": 8e-3, "scan.proportional": proportional})
        afm.run(until=lambda afm=afm: not afm.node._programs.name)
        trace, retrace = afm.bench.take("afm/scanline")
        surface = afm.config.to_surface()
        assert surface is not None
        places = np.linspace(trace.start_m[0], trace.end_m[0], 16).tolist()
        seen = np.array([height_at(*surface, x + 60e-9, 30e-9)[0] for x in places])
        heights = trace.height_m.to_numpy()
        errors.append(float(np.std(heights - seen)))
        apart.append(float(np.sqrt(np.mean((heights - retrace.height_m.to_numpy()) ** 2))))
        assert np.median(trace.amplitude_m.to_numpy()) == pytest.approx(16e-9, rel=0.01, abs=0.0)
    assert errors[1] < 0.99 * errors[0]
    assert apart[1] < 0.95 * apart[0]
    afm.run(until=lambda: afm.node._memory.guard.mode == MODE_RETRACTED)
    # what would swing on is refused, and the base stays away undriven
    for changes, words in (
        ({"scan.gain_per_s": 5000.0}, "tapping mode at 1000 Hz .* it must be below 666.667 1/s"),
        ({"scan.proportional": 0.7}, "tapping mode at 1000 Hz: it must be below 0.6727"),
    ):
        with pytest.raises(RefusedError, match=words):
            afm.set(**{**TAPPING, **changes})
    assert (afm.driver.state.inputs.amplitude_m, afm.node._memory.guard.mode) == (0.0, MODE_RETRACTED)


def test_a_journal_goes_on_in_the_middle_of_a_tapping_line(bench_of: Any) -> None:
    first, again = (Tapper(bench_of("afm_node@slave")) for _ in range(2))
    first.set(**{**TAPPING, "disturbances.thermal.enabled": True, "disturbances.seed": 3})
    first.run(until=lambda: "lines" in {r.text for _, r in first.bench.sent if hasattr(r, "done_percent")})
    state = pack(first.node)
    assert state
    again.bench.clock.advance_ns(first.bench.clock.monotonic_ns() - again.bench.clock.monotonic_ns())
    restore(again.node, state)
    sent = []
    for afm in (first, again):
        afm.bench.take("afm/state")
        for _ in range(30):
            afm.bench.advance_ms(1.0)
            afm.node.on_deadline(afm.bench.clock.monotonic_ns())
        sent.append([(s.base_position_m, s.deflection_m, s.tip_force_n) for s in afm.bench.take("afm/state")])
    assert len(set(sent[0])) == 30
    assert sent[0] == sent[1]


def test_thermal_motion_has_the_energy_of_equipartition_and_none_at_rest() -> None:
    section = {"model": "dynamic", "rest_distance_m": 50e-9}
    afm = instrument(section)
    afm.open()
    quiet = afm.exchange(0.0)
    warm = DisturbanceConfig.model_validate({"thermal": {"enabled": True, "temperature_k": 300.0}, "seed": 5})
    afm.configure(warm)
    deflections = []
    for _ in range(500):
        afm.elapse(1e-3)
        afm.exchange(0.0)
        deflections.append(tip_of(afm).motion.deflection_m)
    energy = 40.0 * np.mean((np.array(deflections[10:]) - quiet.deflection_m) ** 2)
    # samples a millisecond apart know nothing of each other: 6 % of scatter
    assert energy == pytest.approx(BOLTZMANN_J_PER_K * 300.0, rel=0.2, abs=0.0)


def test_a_step_that_comes_late_takes_no_more_than_two_milliseconds_of_motion() -> None:
    afm = instrument({"model": "dynamic"})
    afm.open()
    taken = []
    for elapsed_s in (1e-3, 1.0, 1e-3, 1e-3):
        before = tip_of(afm).due_s
        afm.elapse(elapsed_s)
        afm.exchange(0.0)
        taken.append((before, tip_of(afm).due_s))
    # less than a period is carried on, and a late second is not made up for
    assert all(0.0 <= due <= 1.0 / 150e3 for _, due in taken)


def test_what_is_known_of_the_motion_is_gone_through_before_the_next_exchange() -> None:
    ahead, late = (instrument({"model": "dynamic"}) for _ in range(2))
    forces = []
    for afm in (ahead, late):
        afm.open()
        afm.vibrate(20e-9)
        for base_m in (0.0, 2e-9, 4e-9):
            for _ in range(3):
                if afm is ahead:
                    settled(afm)
                    # nine tenths of the millisecond that is still to come
                    assert -0.9e-3 <= tip_of(afm).due_s < -0.87e-3
                afm.elapse(1e-3)
                afm.exchange(base_m)
                assert 0.0 <= tip_of(afm).due_s <= 1.0 / 150e3
        forces.append(afm.oscillation.amplitude_m)
    # the tip is at rest by then, or nearly so, whoever did the work and when
    assert forces[0] == pytest.approx(forces[1], rel=0.02, abs=0.0)
    # commands in a row lead no further than that
    for _ in range(50):
        ahead.exchange(4e-9)
    assert tip_of(ahead).due_s >= -2e-3


def test_what_has_no_dynamic_model_is_refused_by_name(bench_of: Any) -> None:
    for section, words in (
        ({"mode": "as_printed"}, "as_printed"),
        ({"environment": "spring"}, "environment tip_sample"),
        ({"cantilever": {"resonance_hz": 1e3}}, "resonance_hz of 8000 Hz or more"),
        ({"cantilever": {"steps_per_period": 20}}, "multiple of 8"),
    ):
        with pytest.raises(ValidationError, match=words):
            AfmConfig.model_validate({"model": "dynamic", **section})
    # on a contact of some 4000 N/m it swings two thousand times as fast as free
    hard = {"tip_sample": {"sample_modulus_pa": 1e13, "tip_modulus_pa": 1e13}}
    with pytest.raises(ConfigError, match=r"1536 steps a period, .* too few for a cantilever of 0\.001 N/m"):
        instrument({"model": "dynamic", "cantilever": {"stiffness_n_per_m": 1e-3}, **hard})
    config = AfmConfig.model_validate({"cantilever": {"stiffness_n_per_m": 1.0}})
    static = simulated_afm(config.to_params())
    assert static.vibration is None
    bench = bench_of("afm_node@slave")
    node = AfmNode(bench.context, config, static)
    fields = {"id": "a", "command": "set", "target": "afm_node", "parameters": TAPPING}
    with pytest.raises(RefusedError, match=r"afm_node\.model dynamic"):
        node.on_control(bench.make("session/control", "console@master", **fields))
    with pytest.raises(ValueError, match="amplitude = nan m must be finite"):
        instrument({"model": "dynamic"}).vibrate(float("nan"))
