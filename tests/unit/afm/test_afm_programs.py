"""Images and curves that the node takes by itself: what comes over the bus, and how the tip ends in each case."""

from typing import Any

import numpy as np
import pytest

from services.afm_node.node import AfmNode
from telenano.afm.sample.surface import height_at
from telenano.afm.sim import SimulatedInstrument, simulated_afm
from telenano.sections.afm_section import AfmConfig
from telenano.settings.afm_disturbances import DisturbanceConfig
from telenano.settings.config import validate
from telenano.wire.codec import WireError
from telenano.wire.errors import ConfigError, RefusedError
from telenano.wire.node_state import pack, restore

SOFT = {
    "cantilever": {"stiffness_n_per_m": 1.0},
    "sample": {"name": "grating", "size_m": 120e-9, "period_m": 60e-9, "height_m": 3e-9, "pixels": 64},
    # rises by itself and lets go again, well above the sample
    "safety": {"retract_position_m": -20e-9},
}
QUICK = {
    "program": "scan",
    "scan.pixels": 24,
    "scan.lines": 2,
    "scan.dwell_s": 4e-3,
    "scan.approach_m_per_s": 1e-6,
    "scan.settle_s": 0.05,
}


class Imager:
    """An AFM over a grating on a bench."""

    def __init__(self, bench: Any, section: dict[str, Any] = SOFT, **instrument: Any) -> None:
        self.bench = bench
        self.config = AfmConfig.model_validate(section)
        spring = self.config.environment == "spring"
        self.driver: Any = (
            SimulatedInstrument(self.config.to_spring_params())
            if spring
            else simulated_afm(
                self.config.to_params(), self.config.to_surface(), self.config.to_friction_params(), **instrument
            )
        )
        self.node = AfmNode(bench.context, self.config, self.driver)

    def set(self, **parameters: Any) -> str:
        fields = {"id": "a", "command": "set", "target": "afm_node", "parameters": parameters}
        return self.node.on_control(self.bench.make("session/control", "console@master", **fields))

    def estop(self) -> None:
        fields = {"id": "e", "command": "estop", "target": "afm_node", "parameters": {}}
        self.node.on_control(self.bench.make("session/control", "console@master", **fields))

    def run(self, most_s: float = 20.0, *, until: Any = None) -> None:
        """Let time pass until no program runs and the tip is away, or something else is so."""
        clock = self.bench.clock
        end_ns = clock.monotonic_ns() + round(most_s * 1e9)
        while clock.monotonic_ns() < end_ns:
            clock.advance_ns(max(0, self.node.deadline_ns() - clock.monotonic_ns()))
            self.node.on_deadline(clock.monotonic_ns())
            if until() if until else self.mode in ("retracted", "estop") and not self.node._programs.name:
                return
        raise AssertionError("waited in vain")

    @property
    def mode(self) -> str:
        states = [message for topic, message in self.bench.sent if topic == "afm/state"]
        return states[-1].mode if states else ""

    def outcome(self) -> tuple[str, str]:
        reports = [message for topic, message in self.bench.sent if topic == "afm/program"]
        return reports[-1].state, reports[-1].text


@pytest.fixture
def afm(bench_of: Any) -> Imager:
    return Imager(bench_of("afm_node@slave"))


def parameters(**changes: Any) -> dict[str, Any]:
    return {**QUICK, **{key.replace("__", "."): value for key, value in changes.items()}}


# Parts of a command that are carried out where they stand alone, and parts that are refused.
CARRIED_OUT = ({"lateral.x_m": 3e-9}, {"disturbances.thermal.enabled": True}, QUICK)
REFUSED = (
    {"lateral.y_m": 1.0},
    {"disturbances.drift.speed": 1.0},
    {"spring.stiffness_n_per_m": 2.0},
    {"sample.restore": False},
    {"program": "pause"},
    {"program": "no_program"},
    {"curve.approach_m_per_s": 1e-6},
)


@pytest.mark.parametrize("refused", REFUSED, ids=str)
@pytest.mark.parametrize("carried_out", CARRIED_OUT, ids=lambda part: next(iter(part)))
def test_a_command_of_which_a_part_is_refused_changes_nothing(
    bench_of: Any, carried_out: dict[str, Any], refused: dict[str, Any]
) -> None:
    found = Imager(bench_of("afm_node@slave"), disturbances=DisturbanceConfig())
    before = pack(found.node)
    for command in ({**carried_out, **refused}, {**refused, **carried_out, **refused}):
        with pytest.raises(RefusedError):
            found.set(**command)
        assert pack(found.node) == before
    found.set(**carried_out)
    assert pack(found.node) != before


def test_an_image_is_published_line_by_line_and_is_what_the_tip_sees(afm: Imager) -> None:
    assert "24 x 2" in afm.set(**parameters(scan__dwell_s=12e-3, scan__gain_per_s=800.0))
    afm.run()
    assert afm.outcome()[0] == "finished"
    lines = afm.bench.take("afm/scanline")
    assert [(line.line, line.direction) for line in lines] == [
        (0, "trace"),
        (0, "retrace"),
        (1, "trace"),
        (1, "retrace"),
    ]
    surface = afm.config.to_surface()
    assert surface is not None
    for line in lines:
        assert (line.lines, line.amplitude_m, line.phase_rad) == (2, None, None)
        xs = np.linspace(line.start_m[0], line.end_m[0], 24)
        # the middles of the pixels of 120 nm
        assert xs[0] == pytest.approx(-57.5e-9, rel=1e-9, abs=0.0)
        columns = np.minimum(((xs + 60e-9) / surface.step_x_m).astype(int), 63)
        truth = surface.height_m[0, columns]
        seen = line.height_m.to_numpy() - np.mean(line.height_m.to_numpy()) + truth.mean()
        # the flanks take a pixel, all else is level
        assert np.median(np.abs(seen - truth)) < 0.1e-9
        assert np.corrcoef(seen, truth)[0, 1] > 0.95
    # the force was held where the surface is level
    forces = [state.tip_force_n[2] for state in afm.bench.take("afm/state") if state.in_contact]
    assert np.median(forces) == pytest.approx(5e-9, rel=0.02, abs=0.0)


def test_the_end_of_a_session_aborts_a_program(afm: Imager) -> None:
    afm.set(**parameters())
    afm.run(until=lambda: any(topic == "afm/scanline" for topic, _ in afm.bench.sent))
    fields = {"id": "a", "command": "stop", "target": "afm_node", "parameters": {}}
    control = afm.bench.make("session/control", "launcher@master", **fields)
    assert afm.node.on_control(control) == "the scan ends and the tip retracts"
    afm.run()
    assert afm.outcome() == ("ended", "the scan ended, it was aborted")
    assert afm.bench.take("afm/state")[-1].mode == "retracted"


@pytest.mark.parametrize("proportional", [0.0, 0.5])
def test_a_pause_holds_the_force_where_the_tip_is_and_an_abort_retracts_it(afm: Imager, proportional: float) -> None:
    afm.set(**parameters(scan__proportional=proportional))
    afm.run(until=lambda: any(topic == "afm/scanline" for topic, _ in afm.bench.sent))
    afm.set(program="pause")
    afm.bench.take("afm/state")
    with pytest.raises(RefusedError, match="a scan is running; abort it first"):
        afm.set(**QUICK)
    clock = afm.bench.clock
    end_ns = clock.monotonic_ns() + 300_000_000
    afm.run(until=lambda: clock.monotonic_ns() > end_ns)
    standing = afm.bench.take("afm/state")
    assert len({state.base_position_m[:2] for state in standing[2:]}) == 1
    assert standing[-1].tip_force_n[2] == pytest.approx(5e-9, rel=0.01, abs=0.0)
    assert afm.outcome()[0] == "paused"
    afm.set(program="resume")
    afm.run(until=lambda: len({s.base_position_m[:2] for t, s in afm.bench.sent if t == "afm/state"}) > 5)
    afm.set(program="abort")
    afm.run()
    assert afm.outcome() == ("ended", "the scan ended, it was aborted")
    last = afm.bench.take("afm/state")[-1]
    assert (last.mode, last.in_contact) == ("retracted", False)
    with pytest.raises(RefusedError, match="no program runs, so there is nothing to abort"):
        afm.set(program="abort")


def test_an_emergency_stop_and_the_force_limit_end_an_image_with_the_tip_away(bench_of: Any) -> None:
    afm = Imager(bench_of("afm_node@slave"))
    afm.set(**QUICK)
    afm.run(until=lambda: any(s.in_contact for t, s in afm.bench.sent if t == "afm/state"))
    afm.estop()
    assert afm.outcome() == ("ended", "the scan ended, the guard has retracted the tip: estop")
    end_ns = afm.bench.clock.monotonic_ns() + 200_000_000
    afm.run(until=lambda: afm.bench.clock.monotonic_ns() > end_ns)
    last = afm.bench.take("afm/state")[-1]
    assert (last.mode, last.in_contact, last.base_position_m[2]) == ("estop", False, pytest.approx(20e-9, rel=1e-6))
    with pytest.raises(RefusedError, match="emergency stop is latched"):
        afm.set(**QUICK)
    # a wall that is too high for the feedback at this speed
    steep = {**SOFT, "cantilever": {"stiffness_n_per_m": 40.0}}
    steep["sample"] = {**SOFT["sample"], "height_m": 30e-9}
    steep["safety"] = {"retract_position_m": -60e-9}
    other = Imager(bench_of("afm_node@slave"), steep)
    other.set(**parameters(scan__gain_per_s=50.0, scan__approach_m_per_s=100e-9))
    other.run()
    assert other.outcome() == ("ended", "the scan ended, the guard has retracted the tip: force_limit")
    assert other.mode == "retracted"


@pytest.mark.parametrize(("period_s", "lines_s"), [(1e-3, 8), (4e-3, 16), (5e-3, 20)])
def test_the_time_on_a_pixel_follows_from_the_rate_where_none_is_given(
    bench_of: Any, period_s: float, lines_s: int
) -> None:
    bench = bench_of("afm_node@slave")
    bench.context.period_s = period_s
    slow = Imager(bench)
    given = {"program": "scan", "scan.pixels": 40, "scan.lines": 25, "scan.gain_per_s": 300.0}
    if period_s > 2e-3:
        with pytest.raises(RefusedError, match=f"a dwell of {2.0 * period_s:g} s or more"):
            slow.set(**given, **{"scan.dwell_s": 4e-3})
    assert f"an image of 40 x 25 pixels begins, {lines_s} s for its lines" in slow.set(**given)


@pytest.mark.parametrize(
    ("changes", "what"),
    [
        ({"scan__width_m": 2e-4}, "reaches 0.0001 m from the centre, and lateral.reach_m is 5e-05 m"),
        ({"scan__width_m": 9e-5}, "a dwell of 0.188 s or more on each pixel"),
        ({"scan__dwell_s": 1e-3}, "a dwell of 0.002 s or more"),
        ({"scan__setpoint_n": 3e-7}, "must be below safety.force_limit_n"),
        ({"scan__lines": 0}, r"afm_node.scan.lines: .* \(allowed is from 1 to 4096\), got 0"),
        ({"scan__gain_per_s": 2000.0}, r"scan.gain_per_s \(--gain\) = 2000 1/s makes .* it must be below 2000 1/s"),
        ({"scan__proportional": 0.9}, r"unstable in contact mode at 1000 Hz with .* = 0.9: it must be below 200 1/s"),
        ({"scan__proportional": 1.0}, r"scan.proportional \(--proportional\) = 1 makes .* it must be below 1"),
        ({"scan__proportional": -0.1}, r"afm_node.scan.proportional: .* \(allowed is from 0 to 100\), got -0.1"),
        ({"scan__gain_per_s": -1.0}, r"afm_node.scan.gain_per_s: .*, got -1.0"),
        ({"scan__mode": "tunnelling"}, "scan.mode: Input should be 'contact' or 'tapping', got 'tunnelling'"),
        ({"scan__style": "tapping"}, "scan.style: unknown key, known are mode, width_m"),
        ({"program": "dance"}, "afm_node.program: Input should be 'scan', 'curve'"),
    ],
)
def test_what_cannot_be_imaged_is_refused_and_the_tip_stays_away(afm: Imager, changes: Any, what: str) -> None:
    with pytest.raises(RefusedError, match=what):
        afm.set(**parameters(**changes))
    for _ in range(50):
        afm.bench.advance_ms(1.0)
        afm.node.on_deadline(afm.bench.clock.monotonic_ns())
    assert {state.mode for state in afm.bench.take("afm/state")} == {"retracted"}


@pytest.mark.parametrize("key", ["gain_per_s", "proportional"])
@pytest.mark.parametrize("value", [float("nan"), float("inf")])
def test_a_gain_that_is_no_number_comes_neither_by_a_message_nor_in_a_scenario(
    afm: Imager, key: str, value: float
) -> None:
    with pytest.raises(WireError, match=f"scan.{key} is {value}, must be a finite number"):
        afm.set(**parameters(**{f"scan__{key}": value}))
    with pytest.raises(ConfigError, match=f"begin.scan.{key}: Input should be a finite number, got {value}"):
        validate(AfmConfig, {"begin": {"program": "scan", "scan": {key: value}}}, "s.yaml", "afm_node")


def edges(bench_of: Any, **settings: Any) -> tuple[float, float, float]:
    """Give of an image of the grating, with noise: RMS error to what the tip sees, trace against retrace [m], force."""
    noise = {"seed": 1, "thermal": {"enabled": True}, "readout": {"enabled": True}}
    afm = Imager(bench_of("afm_node@slave"), {**SOFT, "disturbances": noise})
    surface = afm.config.to_surface()
    assert surface is not None
    afm.driver = simulated_afm(afm.config.to_params(), surface, None, afm.config.disturbances)
    afm.node = AfmNode(afm.bench.context, afm.config, afm.driver)
    afm.set(**parameters(**settings))
    afm.run()
    trace, back = (line.height_m.to_numpy() for line in afm.bench.take("afm/scanline")[:2])
    places = np.linspace(-57.5e-9, 57.5e-9, 24)
    seen = [height_at(*surface, x + 60e-9, 30e-9)[0] for x in places.tolist()]
    away = trace - np.array(seen)
    forces = [state.tip_force_n[2] for state in afm.bench.take("afm/state") if state.in_contact]
    error, apart = float(np.std(away)), float(np.sqrt(np.mean((trace - back) ** 2)))
    return error, apart, float(np.median(forces))


def test_a_proportional_gain_follows_an_edge_more_closely(bench_of: Any) -> None:
    (i_error, i_apart, i_force), (pi_error, pi_apart, pi_force) = (
        edges(bench_of, scan__proportional=proportional, scan__lines=1) for proportional in (0.0, 0.5)
    )
    # by 8 and 10 % with the noise of Table 2 on
    assert pi_error < 0.95 * i_error
    assert pi_apart < 0.93 * i_apart
    assert (i_force, pi_force) == pytest.approx((5e-9, 5e-9), rel=0.02, abs=0.0)


def test_a_curve_turns_at_the_load_and_its_states_are_the_curve(bench_of: Any) -> None:
    afm = Imager(bench_of("afm_node@slave"), {"safety": {"retract_position_m": -30e-9}})
    afm.set(**{"program": "curve", "curve.load_n": 15e-9, "curve.speed_m_per_s": 200e-9})
    afm.run()
    assert afm.outcome()[0] == "finished"
    forces = np.array([state.tip_force_n[2] for state in afm.bench.take("afm/state")])
    # it turns within a step of 0.2 nm on the combined stiffness of 19 N/m
    assert 15e-9 <= forces.max() < 15e-9 + 0.2e-9 * 19.0
    # the pull-off of Table 2 with its meniscus
    assert forces.min() == pytest.approx(-12.5e-9, rel=0.05, abs=0.0)
    with pytest.raises(RefusedError, match="takes effect with program=curve in the same command only"):
        afm.set(**{"curve.load_n": 1e-9})


def test_the_tip_goes_where_it_is_told_while_it_follows_and_presses_there(bench_of: Any) -> None:
    section = {**SOFT, "lateral": {"reach_m": 50e-9, "speed_m_per_s": 1e-6}}
    afm = Imager(bench_of("afm_node@slave"), section)
    afm.node.on_message(command(afm))
    afm.node.on_control(afm.bench.make("session/control", "console@master", id="b", command="arm", target="*",
                                       parameters={"place": "hand"}))  # fmt: skip
    afm.set(**{"lateral.x_m": 30e-9})
    heights = []
    for _ in range(60):
        afm.bench.advance_ms(1.0)
        afm.node.on_message(command(afm))
        state = afm.bench.take("afm/state")[-1]
        heights.append((state.base_position_m[0], state.separation_m - state.base_position_m[2]))
    places = [x for x, _ in heights]
    assert places[0] <= 1.001e-9
    assert max(np.diff(places)) <= 1.001e-9
    assert places[-1] == 30e-9
    # from the middle of a groove to a ridge: 3 nm nearer
    assert heights[0][1] - heights[-1][1] == pytest.approx(3e-9, rel=0.01, abs=0.0)
    with pytest.raises(RefusedError, match=r"beyond lateral\.reach_m = 5e-08 m"):
        afm.set(**{"lateral.y_m": 51e-9})
    spring = Imager(bench_of("afm_node@slave"), {"environment": "spring"})
    with pytest.raises(RefusedError, match="has no lateral stage"):
        spring.set(**{"lateral.x_m": 1e-9})
    with pytest.raises(RefusedError, match="needs a lateral stage"):
        spring.set(program="scan")


def command(afm: Imager) -> Any:
    fields = {"mode": "position", "base_position_m": (0.0, 0.0, 0.0), "hand_seq": 1, "hand_armed": True}
    return afm.bench.received("afm/command", "controller@slave", **fields, hand_t_ns=afm.bench.clock.now_ns())


@pytest.mark.parametrize("proportional", [0.0, 0.4])
def test_a_node_restored_in_the_middle_of_an_image_goes_on_with_the_same_lines(
    bench_of: Any, proportional: float
) -> None:
    first = Imager(bench_of("afm_node@slave"))
    first.set(**parameters(scan__proportional=proportional))
    first.run(until=lambda: any(topic == "afm/scanline" for topic, _ in first.bench.sent))
    state = pack(first.node)
    assert state
    second = Imager(bench_of("afm_node@slave"))
    restore(second.node, state)
    for afm in (first, second):
        afm.bench.sent.clear()
        afm.bench.clock = afm.node.clock
        afm.run()
    expected, found = ([line.height_m.data for line in afm.bench.take("afm/scanline")] for afm in (first, second))
    assert len(expected) == 3
    assert found == expected
