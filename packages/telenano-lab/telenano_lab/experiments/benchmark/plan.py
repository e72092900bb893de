"""The runs of the benchmark: tasks, networks, laws, hands and instruments, fixed for each version.

Any change here that alters a result must increment VERSION; figures of different versions are not comparable.
"""

import functools
import hashlib
import json
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Literal, NamedTuple

from pydantic import Field

from telenano.sections import LAWS
from telenano.settings import LinkSettings, Settings, profile_named
from telenano.wire import ConfigError, known_names
from telenano_lab.studies.loops.cells import Cell, Environment, sources
from telenano_lab.studies.option_values import disturbances_of

VERSION = 3

TaskName = Literal["touch", "hold", "track", "stiff"]
HandName = Literal["force", "soft", "stiff", "reacting"]
HANDS: dict[HandName, str] = {
    "force": "a constant force whatever the device does",
    "soft": "an arm of 50 N/m on its way along a path",
    "stiff": "an arm of 1000 N/m on its way along a path",
    "reacting": "an operator who moves, waits until the arm stands, and corrects after 0.25 s and the round trip",
}
Steadiness = Literal["scripted", "trembling"]
STEADINESS: dict[Steadiness, str] = {
    "scripted": "does what its script says, to the bit",
    "trembling": "trembles beside it: 0.02 N around 9 Hz, and 0.03 N of 1/f from 0.05 to 13 Hz",
}
_TREMBLING = {"tremor": {"enabled": True, "rms_n": 0.02}, "wander": {"enabled": True, "rms_n": 0.03}}
INSTRUMENTS = ("ideal", "real")
# Reaction time of the reacting operator.
REACTION_S = 0.25
# Relative scatter of the reacting operator's moves.
SCATTER = 0.1
# Each measured line has a twin that draws the delay of each message independently.
MEASURED_LINES = ("cicv5g_n78_arterial", "starlink_driving", "att_driving", "verizon_driving")
NETWORKS = (
    *("clean", "wifi", "leo_satellite", "satellite", "transatlantic", "lossy_bursts"),
    *(name for line in MEASURED_LINES for name in (line, f"{line}_no_memory")),
)
# Kinds of line that a reader knows before any measurement, and the networks that represent them.
LINES: dict[str, tuple[str, ...]] = {
    "local": ("clean",),
    "long distance": ("transatlantic", "satellite"),
    "independent delays": (
        *("wifi", "leo_satellite", "lossy_bursts"),
        *(f"{line}_no_memory" for line in MEASURED_LINES),
    ),
    "measured line": MEASURED_LINES,
}
QUICK_NETWORKS = ("clean", "wifi", "leo_satellite", "lossy_bursts")
# The number of seeds of the whole benchmark, and of the quick one.
SEEDS = 4
QUICK_SEEDS = 2
# Amplitude of the swing to follow, about the force of the hold.
SWING_N = 0.3
# The frequency of that swing.
SWING_HZ = 0.5
# Number of its periods before the measurement.
SWINGS_BEFORE = 2
# Number of its periods in the measurement.
SWINGS = 2
# Number of points per period that describe the swing.
_POINTS_PER_PERIOD = 200


class Task(NamedTuple):
    """A task: the environment of the tip, its stiffness K [N/m], the force to hold [N], and whether a swing follows."""

    about: str
    environment: Environment
    stiffness_n_per_m: float
    force_n: float
    follows: bool = False


TASKS: dict[TaskName, Task] = {
    "touch": Task("meet a surface of 38 N/m at 3 nm, press with 1 N and hold", "wall", 38.0, 1.0),
    "hold": Task(
        "press a cantilever of 40 N/m on mica with 1 N, then 2 N, and hold (Fig. 12)", "tip_sample", 40.0, 2.0
    ),
    "track": Task("press a spring of 20 N/m with 1 N, hold, then follow 0.3 N at 0.5 Hz", "spring", 20.0, 1.0, True),
    "stiff": Task("the same on a spring of 80 N/m", "spring", 80.0, 1.0, True),
}
# Tasks by the sample that they touch.
SAMPLES: dict[str, tuple[TaskName, ...]] = {"20 to 40 N/m": ("touch", "hold", "track"), "80 N/m": ("stiff",)}
QUICK_TASKS: tuple[TaskName, ...] = ("touch", "track")
QUICK_HANDS: tuple[HandName, ...] = ("force", "stiff")


class Run(Settings):
    """One run of the benchmark."""

    task: TaskName
    network: str
    law: str
    hand: HandName
    seed: int = Field(ge=0)
    settings: tuple[tuple[str, float | int | str | bool], ...] = ()
    instrument: str = "ideal"
    steadiness: Steadiness = "scripted"

    @property
    def key(self) -> str:
        """A digest of the run and of every source that its outcome depends on."""
        disturbed = repr(disturbances_of(self.instrument))
        text = self.model_dump_json() + _link_text(self.network) + disturbed + _sources()
        return hashlib.sha256(text.encode()).hexdigest()[:24]

    @property
    def cell(self) -> Cell:
        """Return the cell of the loop: the nominal round trip sets its programme, the network sets the link.

        The mean of a heavy-tailed delay would make the programme's times longer than necessary.
        """
        task = TASKS[self.task]
        return Cell(
            environment=task.environment,
            stiffness_n_per_m=task.stiffness_n_per_m,
            law=self.law,
            hand="force" if self.hand == "reacting" else self.hand,
            round_trip_ms=round(profile_named(self.network).round_trip_ms, 1),
            loss=0.0,
            jitter_ms=0.0,
            seed=self.seed,
            settings=self.settings,
            disturbances=disturbances_of(self.instrument),
        )

    @property
    def is_random(self) -> bool:
        """Whether another seed gives another run."""
        return is_random(self.network) or self.steadiness == "trembling" or bool(disturbances_of(self.instrument))

    def hand_section(self, points: Sequence[tuple[float, float]]) -> dict[str, Any]:
        """Return the section `haptic_node` of a force profile: corners (time [s], force [N])."""
        trembling = {**_TREMBLING, "seed": self.seed} if self.steadiness == "trembling" else {}
        return {"operator": self.operator(points), "disturbances": trembling}

    def operator(self, points: Sequence[tuple[float, float]]) -> dict[str, Any]:
        """Return the section `haptic_node.operator` of a force profile: corners (time [s], force [N])."""
        if self.hand != "reacting":
            return self.cell.operator(points)
        return {
            "kind": "reacting",
            "points": [{"time_s": time, "force_n": force} for time, force in points],
            "reaction_time_s": REACTION_S,
            "answer_s": self.cell.round_trip_s,
            "noise": SCATTER,
            "seed": self.seed,
        }

    @property
    def link(self) -> LinkSettings:
        """Return the settings of the network with the run's seed."""
        return LinkSettings.of({"profile": self.network, "seed": self.seed}, f"network {self.network}")

    @property
    def sort_key(self) -> tuple[Any, ...]:
        """Return the key by which results are sorted."""
        condition = (self.instrument, self.steadiness)
        return (*condition, self.network, self.task, self.law, self.hand, self.seed, self.settings)

    def force_profile(self) -> tuple[list[tuple[float, float]], float, float, float]:
        """Return the hand's corners (time [s], force [N]), and the ends of hold, settling of the swing, and run [s]."""
        task, cell = TASKS[self.task], self.cell
        points, held_s = list(cell.hand_points()), cell.hold_s()[1]
        if not task.follows:
            return points, held_s, held_s, held_s
        before_s, each_s = SWINGS_BEFORE / SWING_HZ, 1.0 / (SWING_HZ * _POINTS_PER_PERIOD)
        for n in range((SWINGS_BEFORE + SWINGS) * _POINTS_PER_PERIOD + 1):
            phase = 2.0 * math.pi * n / _POINTS_PER_PERIOD
            points.append((held_s + n * each_s, task.force_n + SWING_N * math.sin(phase)))
        return points, held_s, held_s + before_s, held_s + before_s + SWINGS / SWING_HZ


class Plan(NamedTuple):
    """The runs of a benchmark: networks, tasks, laws and hands by name, number of seeds, and settings of the laws."""

    networks: tuple[str, ...]
    tasks: tuple[TaskName, ...]
    laws: tuple[str, ...]
    hands: tuple[HandName, ...]
    seeds: int
    settings: tuple[tuple[str, float | int | str | bool], ...] = ()
    instruments: tuple[str, ...] = INSTRUMENTS
    steadiness: tuple[Steadiness, ...] = tuple(STEADINESS)

    def runs(self) -> list[Run]:
        """Return the runs, grouped by the draw of a link, because drawing a link or a noise takes longer than a run."""
        planned = [
            Run(
                task=task, network=network, law=law, hand=hand, seed=seed, settings=self.settings,
                instrument=instrument, steadiness=steadiness,
            )
            for network in self.networks
            for seed in range(self.seeds)
            for task in self.tasks
            for instrument in self.instruments
            for steadiness in self.steadiness
            for law in self.laws
            for hand in self.hands
        ]  # fmt: skip
        return [run for run in planned if run.seed == 0 or run.is_random]


def plan_of(
    laws: Sequence[str],
    *,
    quick: bool,
    networks: Sequence[str] = (),
    settings: tuple[tuple[str, Any], ...] = (),
    instruments: Sequence[str] = (),
    steadiness: Sequence[str] = (),
) -> Plan:
    """Return the complete or the quick set of runs for some laws, over its own networks unless others are named.

    Raises:
        ConfigError: A law, a network, an instrument or a hand is not known; the message names it.
    """
    for law in laws:
        if law not in LAWS:
            raise ConfigError(f"--law: unknown law {law!r}, {known_names(law, LAWS)}")
    for network in networks:
        try:
            profile_named(network)
        except ConfigError as error:
            raise ConfigError(f"--network: {error}") from error
    for instrument in instruments:
        disturbances_of(instrument)
    for name in steadiness:
        if name not in STEADINESS:
            raise ConfigError(f"--hand: unknown hand {name!r}, {known_names(name, STEADINESS)}")
    networks = [network.lower() for network in networks]
    whole = Plan(tuple(networks) or NETWORKS, tuple(TASKS), tuple(laws), tuple(HANDS), SEEDS, settings)
    if quick:
        whole = whole._replace(networks=tuple(networks) or QUICK_NETWORKS, tasks=QUICK_TASKS, hands=QUICK_HANDS)
        whole = whole._replace(seeds=QUICK_SEEDS)
    hands = tuple(name for name in STEADINESS if name in steadiness)
    return whole._replace(
        instruments=tuple(dict.fromkeys(instruments)) or INSTRUMENTS, steadiness=hands or tuple(STEADINESS)
    )


@functools.cache
def is_random(network: str) -> bool:
    """Return whether another seed gives other delays or losses."""
    return any(
        (way.deviation_ms or 0.0) > 0.0 or len(set(way.percentiles_ms.values())) > 1 or way.lost > 0.0
        for way in profile_named(network).statistics.values()
    )


@functools.cache
def _link_text(network: str) -> str:
    return json.dumps(profile_named(network).model_dump(mode="json"), sort_keys=True)


@functools.cache
def _sources() -> str:
    own = [Path(__file__).with_name(name) for name in ("etvo.py", "plan.py", "run.py")]
    return sources() + hashlib.sha256(b"".join(path.read_bytes() for path in own)).hexdigest()
