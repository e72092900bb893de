"""Check that the bus agrees with lockstep: chosen cells are run on real processes over the link, and in lockstep.

Each cell becomes a scenario file, `telenano up` runs it in a process of its own, and the recording is judged by the
same function as the lockstep run. Two things are compared: the verdict, and, if the cell is stable, the course of the
tip's force: the RMS of the difference over the session, as a share of the hand's force. Past the edge the phase of an
oscillation depends on fractions of a millisecond, so there only the verdict is compared.

Over a link with jitter or loss the bus is one draw of its randomness: the same seed gives it other losses, because the
session starts at another message. The recording has the fate of every message, so lockstep also runs over these same
losses and delays (`recorded_link`), and the bus must have the verdict of that run. SEEDS draws of the link show how
much depends on the draw: the course on the bus has to be as near to that run, or to one of the draws, as these are to
each other. If the draws differ in the verdict, it is decided by something as small as the tolerance (a ripple of 0.05
or 0.06 of the hand's force): then the bus may have another verdict than the recorded link, if its course is within
TOLERANCE_SHARE of that run. If nothing is known of the recorded link, such a cell is undecided.

Lockstep knows the behaviour of the link but not that of the machine. If a process of the session reports that it was
held up, by other processes of real-time priority or by the kernel, which lets these run for 950 ms of each second, a
cell that disagrees is run again, at most TRIES times in all; the last run counts, with the longest time for which a
process was held up.
"""

import sys
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from itertools import combinations, pairwise
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
import yaml

from telenano.analysis import Session
from telenano.cli import run_session
from telenano.lockstep import Trajectory
from telenano.recording import Recording, Timeline, last_force_profile
from telenano.sections import AfmConfig
from telenano.wire import ConfigError, RecordingError, RigError, TelenanoError
from telenano_lab.studies.loops.cells import (
    PACKAGE_SAMPLES,
    WALL_DISTANCE_M,
    Cell,
    judged,
    rig_of,
    sample_config,
    scales_of,
    settle_ticks,
    trajectory_of,
)
from telenano_lab.studies.loops.links import direction_of
from telenano_lab.studies.loops.recorded_link import recorded_schedule

Series = npt.NDArray[np.float64]

RECORDING_NAME = "session.mcap"
# The bus adds about half a millisecond to the loop, and its session starts anywhere within a tick of the hand.
TOLERANCE_SHARE = 0.05
# The draws of a random link in lockstep.
SEEDS = 8
# The most runs of a cell while the machine holds a process up.
TRIES = 3
# The time that the rig needs to start and stop around the session [s].
_OVERHEAD_S = 120.0


class StudyError(TelenanoError):
    """A rig that a study started did not run; the text quotes its error."""


@dataclass(frozen=True)
class Agreement:
    """One cell on the bus and in lockstep.

    lockstep: the verdict over the recorded losses and delays of a random link (`recorded`), otherwise that of most of
    its draws. lockstep_verdicts: the number of draws with each verdict. difference_share: the difference to the nearest
    run in lockstep, None if the cell is not stable. tolerance_share: the greatest difference that is allowed.
    stalled_s: the longest time for which a process was held up [s], 0 if none reports any. runs: the number of runs of
    the cell.
    """

    law: str
    environment: str
    stiffness_n_per_m: float
    round_trip_ms: float
    lockstep: str
    bus: str
    lockstep_growth_per_s: float | None
    bus_growth_per_s: float | None
    difference_share: float | None
    tolerance_share: float
    agree: bool
    hand: str = "force"
    jitter_ms: float = 0.0
    loss: float = 0.0
    lockstep_verdicts: dict[str, int] = field(default_factory=dict)
    reason: str = ""
    recorded: bool = False
    stalled_s: float = 0.0
    runs: int = 1

    @property
    def undecided(self) -> bool:
        """Whether the draws in lockstep differ in their verdicts, stable among them, and the bus's draw is unknown."""
        return not self.recorded and "stable" in self.lockstep_verdicts and len(self.lockstep_verdicts) > 1

    @property
    def near_an_edge(self) -> bool:
        """Whether only one of bus and recorded link is stable, though their courses agree; the draws differ as well."""
        return self.recorded and self.agree and (self.lockstep == "stable") != (self.bus == "stable")

    @property
    def draws(self) -> str:
        """The number of draws of a random link with each verdict, in words; empty for a constant link."""
        counts = self.lockstep_verdicts
        several = sum(counts.values()) > 1
        return ", ".join(f"{number} {kind.replace('_', ' ')}" for kind, number in counts.items()) if several else ""


class Bus(NamedTuple):
    """The rig for a study: its site file, None for the usual one, and the folder of its sessions."""

    site_file: Path | None
    out: Path

    def recording_of(self, cell: Cell) -> Path:
        return (self.out / f"bus-{cell.key[:12]}" / RECORDING_NAME).absolute()


def scenario_of(cell: Cell) -> dict[str, Any]:
    """Return the scenario that runs a cell on the bus.

    Raises:
        ConfigError: The AFM node cannot simulate the environment.
    """
    direction = direction_of(0.5e-3 * cell.round_trip_ms, cell.jitter_ms * 1e-3, cell.loss, cell.burst)
    own = {"forward": direction, "backward": direction} if cell.network is None else {"profile": cell.network}
    return {
        "name": f"validate-{cell.key[:12]}",
        "description": f"{cell.law} at {cell.round_trip_ms:g} ms, {cell.environment} {cell.stiffness_n_per_m:g} N/m",
        "duration_s": cell.hold_s()[1],
        "haptic_node": {"operator": cell.operator(cell.hand_points())},
        "controller": cell.controller().model_dump(mode="json", exclude_unset=True),
        "delay_node": {"seed": cell.seed, **own},
        "afm_node": _instrument_section(cell),
    }


def _instrument_section(cell: Cell) -> dict[str, Any]:
    if cell.environment == "tip_sample":
        return {"cantilever": {"stiffness_n_per_m": cell.stiffness_n_per_m}}
    if cell.environment == "body":
        raise ConfigError("--environment body: the AFM node cannot simulate a body; give spring, wall or tip_sample")
    if cell.environment in PACKAGE_SAMPLES:
        settings = sample_config(cell.environment, cell.stiffness_n_per_m).model_dump(mode="json")
        return {"environment": cell.environment, cell.environment: settings, "safety": {"retract_position_m": 0.0}}
    if "environment" not in AfmConfig.model_fields:
        raise ConfigError(
            "--environment spring: the AFM node of this version cannot simulate a spring; give tip_sample"
        )
    one_sided = cell.environment == "wall"
    rest_m = WALL_DISTANCE_M if one_sided else 0.0
    spring = {"stiffness_n_per_m": cell.stiffness_n_per_m, "rest_position_m": rest_m, "bilateral": not one_sided}
    return {"environment": "spring", "spring": spring, "safety": {"retract_position_m": 0.0}}


def validate_cells(
    cells: Sequence[Cell], bus: Bus, report: Callable[[str], None] = lambda text: None
) -> list[Agreement]:
    """Run cells on the bus one after the other, and compare them with lockstep.

    Raises:
        StudyError: A rig does not run.
    """
    agreements = []
    for number, cell in enumerate(cells, start=1):
        report(f"{number}/{len(cells)}: {cell.law} at {cell.round_trip_ms:g} ms on real processes")
        agreements.append(_compare_with_retries(cell, bus, report))
    return agreements


def _compare_with_retries(cell: Cell, bus: Bus, report: Callable[[str], None]) -> Agreement:
    """Run and compare a cell; repeat it if it fails or disagrees while the machine held a process up."""
    draws, path = draws_of(cell), bus.recording_of(cell)
    for run in range(1, TRIES + 1):
        outcome: Agreement | StudyError
        try:
            outcome = _compared(cell, draws, bus)
        except StudyError as error:
            outcome = error
        stalled_s = _held_up_s(path)
        if stalled_s == 0.0 or run == TRIES or (isinstance(outcome, Agreement) and outcome.agree):
            break
        report(f"   a process was held up for {1e3 * stalled_s:.0f} ms by the machine: once more")
    if isinstance(outcome, StudyError):
        raise outcome
    return replace(outcome, stalled_s=stalled_s, runs=run)


def _compared(cell: Cell, draws: Sequence[Trajectory], bus: Bus) -> Agreement:
    """Run a cell on the bus and compare it; a recording that lacks messages which crossed the link never agrees."""
    course, path = run_on_bus(cell, bus), bus.recording_of(cell)
    try:
        recorded = over_recorded_link(cell, path) if cell.has_random_link else None
    except RecordingError as error:
        agreement = compare(cell, draws, course, lacking=str(error))
        return replace(agreement, agree=False, bus="no_data", reason=str(error))
    return compare(cell, draws, course, recorded, lacking=lacking_of(cell, path))


def _held_up_s(path: Path) -> float:
    """Return the longest stall [s]; 0 if no recording can be read, because then the failure of the rig counts."""
    try:
        return longest_stall_s(path) if path.is_file() else 0.0
    except RecordingError:
        return 0.0


def longest_stall_s(path: Path) -> float:
    """Return the longest time for which a process of a session was held up since the force profile began [s]."""
    recording = Recording(path)
    events = [event.fields() for event in recording.messages(("session/event",))]
    hand = recording.columns("haptic/state", ("t_ns", "session_s"))
    running = hand["t_ns"][last_force_profile(hand["session_s"], hand["t_ns"])]
    # A rig that did not start has no force profile; then all of its time counts.
    start_ns = int(running[0]) if running.size else 0
    profile_events = [event["data"] for event in events if event["t_ns"] >= start_ns]
    stalls_s = [float(data["stalled_s"]) for data in profile_events if "stalled_s" in data]
    return max(stalls_s, default=0.0)


def draws_of(cell: Cell) -> list[Trajectory]:
    """Run a cell in lockstep: once over a constant link, else over SEEDS draws of a random link, its own seed first."""
    seeds = range(cell.seed, cell.seed + SEEDS) if cell.has_random_link else (cell.seed,)
    return [trajectory_of(cell.model_copy(update={"seed": seed})) for seed in seeds]


def over_recorded_link(cell: Cell, path: Path) -> Trajectory:
    """Run a cell in lockstep over the losses and delays in a recording of it."""
    rig = rig_of(cell, cell.hand_points())
    settle = settle_ticks(cell, rig.period_s)
    ticks = settle + round(cell.hold_s()[1] / rig.period_s)
    return rig.run(recorded_schedule(path, settle, ticks, rig.period_s), settle)


def run_on_bus(cell: Cell, bus: Bus) -> Trajectory:
    """Run a cell on real processes and read its recording."""
    recording = bus.recording_of(cell)
    folder = recording.parent
    folder.mkdir(parents=True, exist_ok=True)
    # A rig that does not start leaves no recording, and that of an earlier study would be misleading.
    recording.unlink(missing_ok=True)
    scenario = folder / "cell.yaml"
    document = scenario_of(cell)
    scenario.write_text(yaml.safe_dump(document, sort_keys=False), encoding="utf-8")
    command = [sys.executable, "-m", "telenano", "up", "--scenario", str(scenario), "--out", str(folder)]
    command += ["--overwrite", "--headless", "--json"]
    command += ["--site-file", str(bus.site_file)] if bus.site_file is not None else []
    try:
        # Whether missing data in the recording matters is decided by the hold.
        run_session(command, document["duration_s"] + _OVERHEAD_S)
    except TimeoutError as error:
        raise StudyError(f"{error}, see {folder}") from error
    except RigError as error:
        raise StudyError(f"the rig did not run: {error}") from error
    return read_course(recording)


_MODE_NUMBERS = {"retracted": 0, "follow": 1, "hold": 2, "retracting": 3, "estop": 4}


def read_course(path: Path) -> Trajectory:
    """Read the last session of a recording as a course like that of lockstep, the tip's values at the hand's times.

    Raises:
        RecordingError: Something is missing in the file; the message names the file and what is missing.
        StudyError: The operator's force profile never ran in the recording.
    """
    recording = Recording(path)
    hand = recording.columns("haptic/state", ("t_ns", "session_s", "operator_force_n.2", "position_m.2", "mode"))
    running = last_force_profile(hand["session_s"], hand["t_ns"])
    if running.size < 2:
        raise StudyError(f"{path}: the operator's force profile never ran in it")
    hand = {name: values[running] for name, values in hand.items()}
    tip = recording.columns(
        "afm/state", (
        "t_ns", "log_ns", "base_position_m.2", "tip_force_n.2", "separation_m", "in_contact", "mode",
    ))  # fmt: skip
    command = recording.columns("haptic/command", ("t_ns", "position_m.2", "force_n.2"))
    # The value of a tick is the last message before the next one.
    timeline = Timeline(recording)
    tip["t_ns"] = timeline.times_ns("afm_node@slave", tip["t_ns"].astype(np.int64), tip["log_ns"])
    ends_ns = np.append(hand["t_ns"][1:], hand["t_ns"][-1] + 1_000_000)
    at_tip = np.maximum(np.searchsorted(tip["t_ns"], ends_ns) - 1, 0)
    at_command = np.maximum(np.searchsorted(command["t_ns"], ends_ns) - 1, 0)
    nothing = np.zeros(len(running))
    return Trajectory(
        time_s=hand["session_s"].astype(np.float64),
        hand_force_n=-hand["operator_force_n.2"],
        hand_position_m=-hand["position_m.2"],
        reference_m=-command["position_m.2"][at_command],
        rendered_force_n=command["force_n.2"][at_command],
        base_position_m=-tip["base_position_m.2"][at_tip],
        tip_force_n=tip["tip_force_n.2"][at_tip],
        separation_m=tip["separation_m"][at_tip],
        hand_energy_j=nothing,
        tip_energy_j=nothing,
        in_contact=tip["in_contact"][at_tip].astype(bool),
        instrument_mode=np.array([_MODE_NUMBERS[mode] for mode in tip["mode"][at_tip]], dtype=np.int64),
        hand_following=hand["mode"] != "off",
        # A recording has the reason in events, which are not needed here.
        instrument_reason=np.zeros(len(running), dtype=np.int64),
        withdrawn_s=np.full(len(running), np.nan),
    )


def lacking_of(cell: Cell, path: Path) -> str:
    """Return in words what is missing in a recording of the judged hold; empty if it is too little to matter.

    A course does not show it, because `read_course` repeats the last sample for every tick.
    """
    return "; ".join(map(str, Session.of(Recording(path)).lacks(cell.hold_s())))


def compare(
    cell: Cell,
    lockstep: Sequence[Trajectory],
    bus: Trajectory,
    recorded: Trajectory | None = None,
    *,
    lacking: str = "",
) -> Agreement:
    """Compare verdicts and, if both are stable, the course of the tip's force.

    Args:
        cell: The cell.
        lockstep: The runs in lockstep, one for each draw of the link; one if the link is constant.
        bus: The run on the bus.
        recorded: The run in lockstep over the losses and delays of the bus, with which the bus is then compared.
        lacking: The data that are missing in the recording of the bus, in words.
    """
    drawn, measured = [judged(cell, course) for course in lockstep], judged(cell, bus)
    if lacking and not measured.guarded:
        measured = replace(measured, verdict="no_data", reason=lacking)
    verdicts = Counter(draw.verdict for draw in drawn)
    decisive = drawn if recorded is None else [judged(cell, recorded)]
    stable_draws = [course for course, draw in zip(lockstep, drawn, strict=True) if draw.verdict == "stable"]
    stable = list(stable_draws)
    if recorded is not None and decisive[0].verdict == "stable":
        stable.append(recorded)
    expected = any(draw.verdict == "stable" for draw in decisive)
    undecided = expected and any(draw.verdict != "stable" for draw in decisive)
    same = undecided or expected == (measured.verdict == "stable")
    difference, tolerance = None, TOLERANCE_SHARE
    if not same and recorded is not None and 0 < len(stable_draws) < len(drawn):
        # The draws differ as well, so the course over the recorded link decides, within the tolerance of the verdict.
        difference = course_difference(cell, recorded, bus)
        same = difference <= tolerance
    elif undecided or (expected and measured.verdict == "stable"):
        among = lockstep if undecided else stable
        difference = min(course_difference(cell, course, bus) for course in among)
        apart = (course_difference(cell, first, second) for first, second in combinations(among, 2))
        tolerance = max(TOLERANCE_SHARE, *apart, 0.0)
    most = Counter(draw.verdict for draw in decisive).most_common(1)[0][0]
    likely = next(draw for draw in decisive if draw.verdict == most)
    return Agreement(
        cell.law,
        cell.environment,
        cell.stiffness_n_per_m,
        cell.round_trip_ms,
        likely.verdict,
        measured.verdict,
        likely.growth_per_s,
        measured.growth_per_s,
        difference,
        tolerance,
        same and measured.verdict != "no_data" and (difference is None or difference <= tolerance),
        cell.hand,
        cell.jitter_ms,
        cell.loss,
        dict(verdicts),
        measured.reason,
        recorded is not None,
    )


class BusEdge(NamedTuple):
    """The round trip [ms] at which motion on the bus neither grows nor decays, with half a sample as in lockstep."""

    law: str
    environment: str
    stiffness_n_per_m: float
    bus_critical_delay_ms: float


def bus_edges(agreements: Sequence[Agreement], period_s: float) -> list[BusEdge]:
    """Find the edge on the bus of every line of cells that has a cell on each side of it.

    Between the last cell in which the motion decays and the first in which it grows, the growth rate is taken as linear
    in the delay. As for lockstep, half a sample period is added for comparison with the continuous theory.
    """
    lines: dict[tuple[str, str, float], list[Agreement]] = {}
    for agreement in agreements:
        if agreement.bus_growth_per_s is not None:
            key = (agreement.law, agreement.environment, agreement.stiffness_n_per_m)
            lines.setdefault(key, []).append(agreement)
    edges = []
    for key, line in lines.items():
        line.sort(key=lambda agreement: agreement.round_trip_ms)
        for before, after in pairwise(line):
            low, high = before.bus_growth_per_s or 0.0, after.bus_growth_per_s or 0.0
            if low < 0.0 <= high:
                share = -low / (high - low)
                delay_ms = before.round_trip_ms + share * (after.round_trip_ms - before.round_trip_ms)
                edges.append(BusEdge(*key, delay_ms + 0.5e3 * period_s))
                break
    return edges


def course_difference(cell: Cell, lockstep: Trajectory, bus: Trajectory) -> float:
    """Return the RMS of the difference in alpha_f F_s over the session, as a share of the hand's greatest force."""
    times = lockstep.time_s[lockstep.time_s <= bus.time_s[-1]]
    difference = lockstep.tip_force_n[: len(times)] - np.interp(times, bus.time_s, bus.tip_force_n)
    scale = scales_of(cell.controller()).force_scale / float(np.abs(lockstep.hand_force_n).max())
    return float(scale * np.sqrt(np.mean(difference**2)))
