"""A whole session of a scenario in lockstep, which `telenano up` runs as processes: `telenano.simulate`.

The steps are those of the nodes, the link is computed by its own engine, and nothing waits for a clock: the eight
seconds of Fig. 12 take a fraction of a second. The delay of a millisecond or two that the processes add, and its
jitter, are not simulated.
"""

import math
import warnings
from collections.abc import Callable, Mapping
from functools import cached_property
from os import PathLike
from typing import Any

import numpy as np

from telenano.analysis.felt_stiffness import Course, FeltSession, SampleFacts, Span, felt_in, scale_of
from telenano.analysis.fig12 import SessionSeries, TipStates
from telenano.analysis.findings import Kind
from telenano.analysis.holds import (
    NO_CONTEXT,
    Hold,
    Instrument,
    SessionContext,
    guard_of,
    judge_holds,
    verdict_of,
)
from telenano.analysis.interruptions import in_words
from telenano.analysis.session import COLUMNS, Conditions, Session, hand_in_words, sample_in_words
from telenano.analysis.stated_noise import stated_noise
from telenano.analysis.summary import tip_figures
from telenano.extend.instruments import SafetyParams
from telenano.files.strict_json import finite
from telenano.lockstep import across
from telenano.lockstep.link import Schedule
from telenano.lockstep.lockstep import Rig
from telenano.lockstep.steering import columns_of
from telenano.lockstep.trajectory import Trajectory, known_of
from telenano.recording.column_table import ColumnTable
from telenano.sections.afm_section import AfmConfig
from telenano.sections.controller_section import ControllerConfig
from telenano.sections.hand_section import HapticConfig
from telenano.settings.afm_disturbances import instrument_name
from telenano.settings.config import merge, nested, read_yaml
from telenano.settings.included import find_scenario, name_of_scenario
from telenano.settings.link_settings import EVEN, LinkSettings
from telenano.settings.scenario import SEEDS, LoadedScenario
from telenano.wire.errors import ConfigError, LockstepError, known_names

_RENAMED = {"operator_force_n": "hand_force_n"}
# Further columns if the hand also moves the tip across the sample: column of the rows, unit, and text.
_ACROSS = {
    "hand_x_m": (across.X, "m", "Position of the hand across the sample, x"),
    "hand_y_m": (across.Y, "m", "Position of the hand across the sample, y"),
    "shown_x_n": (across.SHOWN_X, "N", "Force that the hand is shown across the sample, x"),
    "shown_y_n": (across.SHOWN_Y, "N", "Force that the hand is shown across the sample, y"),
    "tip_x_m": (across.STAGE_X, "m", "Place of the tip over the sample, x"),
    "tip_y_m": (across.STAGE_Y, "m", "Place of the tip over the sample, y"),
    "lateral_x_n": (across.FORCE_X, "N", "Lateral force on the tip, x"),
    "lateral_y_n": (across.FORCE_Y, "N", "Lateral force on the tip, y"),
    "across_j": (across.ENTERED, "J", "Energy that the hand has put in across the sample"),
    "depth_j": (across.ENTERED_DEPTH, "J", "Energy that the hand has put into the hold of its depth"),
}
# Returns the hand that steers (`telenano.lockstep.steering`), for a period [s].
Steers = Callable[[float], Any]
# The names and signs of the columns on the bus, whose frame has z away from the sample.
_CHANNELS = {
    "haptic/state": {
        "position_m.2": ("hand_position_m", -1.0),
        "reference_m.2": ("reference_m", -1.0),
        "operator_force_n.2": ("operator_force_n", -1.0),
        "position_m.0": ("hand_x_m", 1.0),
        "position_m.1": ("hand_y_m", 1.0),
    },
    "afm/state": {
        "base_position_m.2": ("base_position_m", -1.0),
        "tip_force_n.2": ("tip_force_n", 1.0),
        "separation_m": ("separation_m", 1.0),
        "base_position_m.0": ("tip_x_m", 1.0),
        "base_position_m.1": ("tip_y_m", 1.0),
        "tip_force_n.0": ("lateral_x_n", 1.0),
        "tip_force_n.1": ("lateral_y_n", 1.0),
    },
}
_PUBLISHERS = {"haptic/state": ("haptic_node@master",), "afm/state": ("afm_node@slave",)}


class SimulatedSession(Session):
    """A session in lockstep: columns of shape (n,), one value a period of the hand; made by `simulate`."""

    def __init__(
        self,
        conditions: Conditions,
        course: Trajectory,
        force_scale: float,
        safety: SafetyParams | None = None,
        *,
        further: Mapping[str, tuple[str, str]] | None = None,
        known: SessionContext = NO_CONTEXT,
        position_scale: float | None = None,
        measured_round_trip_ms: float | None = None,
        felt_by: tuple[Span, SampleFacts] | None = None,
    ) -> None:
        self._felt_by = felt_by or (Span(0.0, math.inf, None, "the scales of the law are not stated"), SampleFacts())
        self._conditions = conditions
        self._measured_round_trip_ms = measured_round_trip_ms
        self.force_scale = force_scale
        self._safety = safety
        self._known = known
        self._position_scale = position_scale
        self._trajectory = course
        values = {name: getattr(course, _RENAMED.get(name, name), None) for name in COLUMNS}
        values["scaled_tip_force_n"] = force_scale * course.tip_force_n
        described = dict(COLUMNS)
        if course.across is not None:
            columns = {name: column for name, (column, *_) in _ACROSS.items()}
            columns |= {name: column for column, name in enumerate(further or (), across.WIDTH)}
            values |= {name: course.across[:, column] for name, column in columns.items()}
            described |= {name: (unit, text) for name, (_, unit, text) in _ACROSS.items()} | dict(further or {})
        self._columns = ColumnTable(
            "a simulated session",
            {name: np.asarray(column) for name, column in values.items()},
            {name: unit for name, (unit, _) in described.items()},
            {name: text for name, (_, text) in described.items()},
        )

    @classmethod
    def of(
        cls, document: Mapping[str, Any], origin: str, steers: Steers | None = None, *, at_once: bool = False
    ) -> "SimulatedSession":
        """Run a scenario that was read already.

        Args:
            document: The scenario.
            origin: The name of the scenario in errors.
            steers: Returns a hand that steers the tip across the sample, in mode rate.
            at_once: Whether to compile for the first session, as in `Rig.run`.

        Raises:
            ConfigError: The scenario cannot be simulated; the message names `origin` and the key at fault.
            LockstepError: The nodes can run it, but a lockstep has no model of a part of it.
        """
        from telenano.analysis.recorded_session import planned_holds

        loaded = LoadedScenario.of(document, origin)
        controller = loaded.section("controller", ControllerConfig)
        haptic = loaded.section("haptic_node", HapticConfig)
        afm = loaded.section("afm_node", AfmConfig)
        link = loaded.section("delay_node", LinkSettings)
        drivers = (
            ("haptic_node", haptic.driver, haptic.in_lockstep, haptic.simulated),
            ("afm_node", afm.driver, afm.driver == "simulated", afm.simulated),
        )
        for section, driver, has_model, is_simulated in drivers:
            if not is_simulated:
                raise ConfigError(f"{origin}: {section}.driver: {driver} drives a real device; only `up` can run it")
            if not has_model:
                raise LockstepError(f"{origin}: {section}.driver: a lockstep has no model of {driver}")
        if afm.model != "quasi_static":
            raise LockstepError(
                f"{origin}: afm_node.model: {afm.model} runs on the bus only; a lockstep has quasi_static"
            )
        if haptic.operator.kind == "interactive":
            text = "interactive is a person, of whom a lockstep has no model: another operator presses"
            raise LockstepError(f"{origin}: haptic_node.operator.kind: {text}")
        if afm.begin is not None:
            text = f"{afm.begin.program} moves the tip by a program of the instrument, which a lockstep does not have"
            raise LockstepError(f"{origin}: afm_node.begin: {text}")
        trip_s = link.forward.delay_s + link.backward.delay_s
        period_s = controller.period_s
        reference_m = controller.law_config().position_scale * haptic.device.start_position_m
        settle = math.ceil(afm.time_to_place_s(trip_s, reference_m) / period_s)
        ticks = settle + max(1, round(loaded.scenario.duration_s / period_s))
        length_s = ticks * period_s
        rig = Rig.of(controller, haptic, afm.to_lockstep_params(origin, length_s), length_s)
        schedule, path = Schedule.of(link, ticks, period_s), None
        hand = None if steers is None else steers(period_s)
        if haptic.lateral is not None and controller.lateral.mode != "direct":
            path = across.across_path(controller, haptic.lateral, schedule, len(columns_of(hand)))
        if steers is not None and (path is None or controller.lateral.mode != "rate"):
            text = "a hand that steers the tip needs mode rate, and a section haptic_node.lateral"
            raise ConfigError(f"{origin}: controller.lateral.mode: {text}")
        if text := controller.stiffness_doubts(afm.stiffest_n_per_m or 0.0, even=link.network_name in EVEN):
            warnings.warn(text, stacklevel=3)
        course = rig.run(schedule, settle, hand, path, at_once=at_once)
        section = controller.law_config()
        conditions = Conditions(
            scenario=loaded.scenario.name,
            law=controller.law,
            parameters=section.model_dump(mode="json"),
            environment=afm.environment,
            round_trip_ms=round(1e3 * trip_s, 6),
            link_profile=link.network_name,
            link_seed=link.seed,
            instrument=instrument_name(loaded.scenario.instrument, loaded.scenario.afm_node),
            sample=sample_in_words(loaded.scenario),
            hand=hand_in_words(loaded.scenario, origin),
        )
        safety = rig.instrument.safety
        ages_s = _ages_s(schedule, period_s)
        transit_s = float(np.percentile(ages_s, 99.0)) if ages_s.size else trip_s
        context = known_of(
            controller, transit_s + period_s, safety.command_deadline_s, haptic.limits.command_deadline_s
        )
        context = context._replace(planned=planned_holds(loaded.scenario, loaded.scenario.duration_s))
        context = context._replace(noise=stated_noise(afm, section.force_scale))
        context = context._replace(answered_s=np.asarray(1e-9 * schedule.backward_ns - course.begins_s, np.float64))
        return cls(
            conditions,
            course,
            section.force_scale,
            safety,
            further=columns_of(hand),
            known=context,
            position_scale=section.position_scale,
            measured_round_trip_ms=_median_round_trip_ms(schedule, period_s, trip_s),
            felt_by=(Span(0.0, math.inf, *scale_of(controller, controller.law)), SampleFacts.of(afm)),
        )

    def __repr__(self) -> str:
        return f"<SimulatedSession {self._title()}: {self['time_s'].size} samples, {self.verdict}>"

    def _title(self) -> str:
        return f"{self.conditions.title()} (simulated in lockstep)"

    @property
    def course(self) -> ColumnTable:
        """All columns as a table."""
        return self._columns

    @property
    def conditions(self) -> Conditions:
        """The conditions under which the session was run."""
        return self._conditions

    @property
    def measured_round_trip_ms(self) -> float | None:
        """Median age of the hand's samples that the answers descend from [ms]."""
        return self._measured_round_trip_ms

    @property
    def channels(self) -> dict[str, tuple[str, ...]]:
        """The publishers of each channel that `table` returns."""
        return dict(_PUBLISHERS)

    def table(self, channel: str, src: str | None = None) -> ColumnTable:
        """Return a channel as in a recording, with the names and the frame of the bus, z away from the sample.

        Args:
            channel: haptic/state or afm/state.
            src: The publisher; None and `*` mean the only one.

        Raises:
            ConfigError: A simulation has no such channel or publisher; the message names the possible ones.
        """
        if channel not in _CHANNELS:
            raise ConfigError(f"{channel}: a simulation has no such channel; {known_names(str(channel), _CHANNELS)}")
        if src not in (None, "*", *_PUBLISHERS[channel]):
            raise ConfigError(f"{channel}: {src} published nothing on it; {', '.join(_PUBLISHERS[channel])} did")
        found = {"time_s": ("time_s", 1.0), **_CHANNELS[channel]}
        found = {name: row for name, row in found.items() if row[0] in self.units}
        columns = {name: sign * self[source] for name, (source, sign) in found.items()}
        units = {name: self.units[source] for name, (source, _) in found.items()}
        texts = {
            name: self.descriptions[source].replace(", towards the sample", "") for name, (source, _) in found.items()
        }
        return ColumnTable(channel, columns, units, texts)

    @cached_property
    def holds(self) -> list[Hold]:
        """The holds of the hand, each with its judgement."""
        time_s, tip_n = self["time_s"], self["scaled_tip_force_n"]
        return judge_holds(time_s, self["operator_force_n"], time_s, tip_n, self._tip, self._context)

    @cached_property
    def _verdict(self) -> tuple[Kind, str]:
        guard = guard_of(self["time_s"], self._tip, self._context)
        greatest_n = float(np.abs(self["operator_force_n"]).max(initial=0.0))
        return verdict_of(self.holds, guard, greatest_n, in_words(self._context.interruptions))

    @property
    def verdict(self) -> Kind:
        """The verdict: that of the worst hold, or `guarded` if the instrument's guard ended the session."""
        return self._verdict[0]

    @property
    def reason(self) -> str:
        """The reason for the verdict in words; a guard that acted comes first, with its time and limit."""
        return self._verdict[1]

    @cached_property
    def felt_stiffness(self) -> FeltSession:
        """The stiffness that the hand felt, compared with the actual one, or the reason why it is unknown."""
        course, time_s = self._trajectory, self["time_s"]
        hand = np.stack([time_s, self["hand_position_m"], self["operator_force_n"]])
        tip = np.stack([time_s, self["base_position_m"], self["tip_force_n"]])
        coupled = course.in_contact & course.follows & course.hand_following
        span, facts = self._felt_by
        return felt_in(Course(hand, tip, coupled), [span], facts)

    @cached_property
    def summary(self) -> dict[str, Any]:
        """The figures of `summary.json` that a lockstep has, without those of messages, processes and recording."""
        # Imported here, because only the judge of recordings needs what it imports.
        from telenano.analysis import session_judge as judge

        conditions, time_s, tip_n = self.conditions, self["time_s"], self["tip_force_n"]
        last, own = time_s >= time_s[-1] - judge.RELEASE_WINDOW_S, judge.last_with_ratio(self.holds)
        found: dict[str, Any] = finite(
            {
                "scenario": conditions.scenario,
                "law": [conditions.law],
                "parameters": conditions.parameters,
                "changed": list(conditions.changed),
                "link_round_trip_ms": self.measured_round_trip_ms,
                "link_profile": conditions.link_profile,
                "link_seed": conditions.link_seed,
                "instrument": conditions.instrument,
                **judge.verdict_figures(self.verdict, self.reason),
                "hold_ratio": None if own is None else own.hold_ratio,
                "felt_stiffness": judge.felt_figures(self.felt_stiffness),
                "contact_x_cm": judge.mean_of(100.0 * self["reference_m"][last]),
                "release_force_nn": judge.rounded_nn(judge.mean_of(1e9 * tip_n[last])),
                **tip_figures({"tip_force_n.2": tip_n}),
                "hand_cycles": judge.cycles_of(self["operator_force_n"]),
                "holds": judge.hold_figures(self.holds),
            }
        )
        return found

    def _drawn(self) -> tuple[SessionSeries, str]:
        course, time_s = self._trajectory, self["time_s"]
        no = np.zeros(time_s.size, dtype=bool)
        states = TipStates(course.follows | course.held, no, course.in_contact, no)
        series = SessionSeries(
            time_s, self["operator_force_n"], self["hand_position_m"], time_s, self["reference_m"], time_s,
            self["tip_force_n"], self["separation_m"], self.force_scale, (), states,
        )  # fmt: skip
        return series, f"{self._title()}: {self.verdict.replace('_', ' ')}"

    @property
    def _tip(self) -> Instrument:
        return self._trajectory.tip(self._position_scale)

    @cached_property
    def _context(self) -> SessionContext:
        return self._trajectory.context(self._safety, self._known)


def simulate_scenario(
    scenario: str | PathLike[str] = "fig12",
    *,
    law: str | None = None,
    round_trip_ms: float | None = None,
    environment: str | None = None,
    instrument: str | None = None,
    operator: Mapping[str, object] | None = None,
    duration_s: float | None = None,
    settings: Mapping[str, object] | None = None,
    seed: int | None = None,
) -> SimulatedSession:
    """Run a scenario in lockstep, without processes.

    It runs as plain Python, which takes a second for the eight of Fig. 12. After some twenty such calls the models are
    compiled, which takes some ten seconds and is announced; later processes use the stored result (docs/api.md).

    Args:
        scenario: A known name or a YAML file; it applies where no other argument is given.
        law: The name of a law.
        round_trip_ms: The round trip of the link [ms], half of it each way.
        environment: The sample, as `afm_node.environment`.
        instrument: The disturbances of the AFM: ideal, real or real_drifting.
        operator: The hand, as the section `haptic_node.operator`.
        duration_s: The length of the session [s].
        settings: Values by dotted key of the scenario, such as {"controller.virtual_impedance.force_gain": 10}.
        seed: The seed of all that is random; None leaves those of the scenario as they are.

    Raises:
        ConfigError: Names the file or key at fault, or what cannot be simulated.
        LockstepError: The nodes can run it, but a lockstep has no model of a part of it.
    """
    overrides: dict[str, Any] = {}
    if law is not None:
        overrides["controller"] = {"law": law}
    if round_trip_ms is not None:
        one_way = {"delay_s": 0.5e-3 * round_trip_ms}
        overrides["delay_node"] = {"forward": one_way, "backward": dict(one_way)}
    if environment is not None:
        overrides["afm_node"] = {"environment": environment}
    if instrument is not None:
        overrides["instrument"] = instrument
    if duration_s is not None:
        overrides["duration_s"] = duration_s
    path = find_scenario(scenario)
    seeds = {} if seed is None else nested(dict.fromkeys(SEEDS, seed), "seed")
    document = merge(read_yaml(path), seeds, nested(dict(settings or {}), "settings"), overrides)
    if operator is not None:
        # Replace the scenario's operator as a whole, and not key by key, because its kind may be another one.
        document["haptic_node"] = {**document.get("haptic_node", {}), "operator": dict(operator)}
    return SimulatedSession.of(document, name_of_scenario(path))


def compile_scenario(scenario: str, law: str) -> None:
    """Compile the loop of a scenario with a law, by a session of two ticks, and store it on disk."""
    path = find_scenario(scenario)
    document = merge(read_yaml(path), {"controller": {"law": law}, "duration_s": 0.002})
    SimulatedSession.of(document, str(path), at_once=True)


def _ages_s(schedule: Schedule, period_s: float) -> Any:
    """Return the age of the hand's sample that each answer descends from [s], shape (answers,)."""
    sent_ns = schedule.forward_of[schedule.backward_of] * round(period_s * 1e9)
    return 1e-9 * (schedule.backward_ns - sent_ns)


def _median_round_trip_ms(schedule: Schedule, period_s: float, least_s: float) -> float:
    """Return the median age of the hand's samples that answers descend from [ms]; `least_s` [s] if there is none."""
    ages_s = _ages_s(schedule, period_s)
    return round(1e3 * (float(np.median(ages_s)) if ages_s.size else least_s), 3)
