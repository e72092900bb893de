"""Simulated participants: a hand for each task, in lockstep and on a rig alike, and the answers of an observer.

Their known properties are what an experiment must find:

- touch_and_hold: the hand moves and waits (`telenano.hand.reacting`), and has learnt the delay of the link's answer.
  With the default gain it is within the band after three moves, so its completion time grows by 2 s for each second of
  the round trip, plus the effect of the delay on the settling of the law. Under the law wave, over a spring of 20 N/m,
  that is 2.5 s more: SLOPE_OF_WAVE, the same from 0 to 300 ms of round trip.
- track: it follows the target a reaction time late, so its lag is that, plus the forward delay and that of law and arm.
- detect_contact: it answers a reaction time after the felt force has changed by more than its threshold, so the
  detection time grows by the backward delay.
- discriminate_stiffness: with probability lapse it guesses, else it chooses the stiffer one, of ratio r, with the
  probability Phi(ln(r) / weber): 84 % are right at r = exp(weber), without lapses.
- push_particle: it is the hand of `telenano study push`, which steers the stylus in the controller's rate mode.
"""

import math
import random
from collections.abc import Mapping
from statistics import NormalDist
from typing import Any, Literal

import numpy as np
from pydantic import Field

from telenano.settings import LinkSettings, nested, validate
from telenano_lab.experiments.extend import Course, Parameters, Series, Task, TrialData
from telenano_lab.experiments.tasks.detect_contact import CONTACT
from telenano_lab.experiments.tasks.discriminate_stiffness import ANSWER, FIRST, SECOND, comparison_is_first
from telenano_lab.experiments.types import Trial

# Completion time of touch_and_hold per round trip [s/s]: law wave, spring of 20 N/m, no scatter.
SLOPE_OF_WAVE = 4.5
Answers = tuple[Mapping[str, Any], ...]
# Greatest number of corners of a target for the hand: `set operator=` accepts a text of 4096 characters.
_CORNERS = 60
# Normal force of a hand that steers the tip laterally: times [s] and forces [N].
PRESSES = (0.2, 0.6), (0.0, 1.2)
# Speed of the hand towards the sample in detect_contact [m/s].
_APPROACH_M_PER_S = 4e-3
# The felt force is compared with its earlier mean over this time [s].
_BEFORE_S = 0.5
# The averaging ends this long before the compared force [s].
_GAP_S = 0.1
# Nothing is judged before the arm moves steadily [s].
_STEADY_S = 1.5


class Profile(Parameters):
    """A simulated participant."""

    reaction_time_s: float = Field(0.25, ge=1e-3, le=5.0, description="Reaction time [s]")
    gain: float = Field(0.6, gt=0.0, le=1.9, description="Share of an error that a move corrects")
    noise: float = Field(0.1, ge=0.0, le=1.0, description="Standard deviation of that share, relative to it")
    tolerance_n: float = Field(
        0.05, gt=0.0, le=10.0, description="Error of the felt force that the operator leaves uncorrected [N]"
    )
    arm: Literal["soft", "ordinary", "stiff"] = Field("ordinary", description="Arm of the hand")
    threshold_n: float = Field(0.15, gt=0.0, le=10.0, description="Change of the felt force that is noticed [N]")
    weber: float = Field(0.2, gt=0.0, le=5.0, description="Scatter of the perceived logarithm of a ratio of stiffness")
    lapse: float = Field(0.02, ge=0.0, lt=1.0, description="Share of trials in which the answer is a guess")
    rating: float = Field(50.0, ge=0.0, le=100.0, description="Mean of its ratings, in percent of a scale")
    force_scale: float = Field(1e8, gt=0.0, description="Force at the hand per force on the tip, as in the law")
    position_scale: float = Field(1e-6, gt=0.0, description="Motion of the base per motion of the hand, as in the law")


class SimulatedParticipant:
    """A simulated participant, whose behaviour is a pure function of profile and seed."""

    def __init__(self, profile: Mapping[str, Any], seed: int) -> None:
        """Check the profile; ConfigError names the wrong key.

        Args:
            profile: Values that differ from the defaults of `Profile`.
            seed: The seed of the participant, which is mixed with that of each trial.
        """
        self.profile = validate(Profile, dict(profile), "participant")
        self._seed = seed

    def settings(self, task: Task, p: Any, trial: Trial) -> dict[str, Any]:
        """Return the hand of a trial as dotted keys below `haptic_node.operator`.

        Args:
            task: The task.
            p: Its parameters.
            trial: The trial, whose seed determines the target and the noise of the hand.
        """
        hand = self._hand(task, p, trial)
        return {f"haptic_node.operator.{key}": value for key, value in hand.items()}

    def steers(self, task: Task, p: Any, seed: int) -> bool:
        """Return whether the hand of a task steers the tip across the sample, to a place."""
        course = task.target(p, seed)
        return course is not None and course.quantity == "place"

    def answer(self, task: Task, p: Any, trial: Trial, data: TrialData) -> Answers:
        """Return the answers of a trial: to the questions of its task, and those during it."""
        draw = self._draw(trial, "answer")
        end_s = task.duration_s(p)
        answers: list[Mapping[str, Any]] = []
        if task.name == "detect_contact" and (felt_s := self._felt_s(data)) is not None:
            answers.append({"name": CONTACT, "value": True, "time_s": felt_s + self.profile.reaction_time_s})
        for question in task.questions(p):
            if question.name == ANSWER:
                value: Any = self._stiffer(p.ratio, trial.seed, draw)
            elif question.options:
                value = draw.choice(question.options)
            else:
                value = self.rate(question.least, question.most, question.step, draw)
            answers.append({"name": question.name, "value": value, "time_s": end_s + self.profile.reaction_time_s})
        return tuple(answers)

    def rate(self, least: float, most: float, step: float, draw: random.Random) -> float:
        """Return a rating: normal about the mean of the profile, with a deviation of a tenth of the scale."""
        wanted = least + (most - least) * min(1.0, max(0.0, 0.01 * self.profile.rating + draw.gauss(0.0, 0.1)))
        return least + step * round((wanted - least) / step) if step > 0.0 else wanted

    def probability(self, ratio: float) -> float:
        """Return the probability of a correct answer at a stiffness ratio: the known psychometric function."""
        lapse = self.profile.lapse
        return 0.5 * lapse + (1.0 - lapse) * NormalDist().cdf(math.log(ratio) / self.profile.weber)

    def _draw(self, trial: Trial, purpose: str) -> random.Random:
        return random.Random(f"{purpose} {self._seed} {trial.seed}")

    def _stiffer(self, ratio: float, seed: int, draw: random.Random) -> str:
        is_right = draw.random() < self.probability(ratio)
        return FIRST if comparison_is_first(seed) == is_right else SECOND

    def _hand(self, task: Task, p: Any, trial: Trial) -> dict[str, Any]:
        who, course = self.profile, task.target(p, trial.seed)
        if course is not None and course.quantity == "force" and np.ptp(course.values) == 0.0:
            return self._reacting(float(course.values[0]), trial)
        if course is not None and course.quantity == "force":
            points = [
                {"time_s": t, "force_n": who.force_scale * value} for t, value in _late(course, who.reaction_time_s)
            ]
            return {"kind": "force_profile", "points": points}
        if course is not None and course.quantity == "position":
            path = [
                {"time_s": t, "position_m": value / who.position_scale}
                for t, value in _late(course, who.reaction_time_s)
            ]
            return {"kind": "impedance", "arm": who.arm, "path": path}
        if course is not None and course.quantity == "place":
            points = [{"time_s": t, "force_n": force_n} for t, force_n in zip(*PRESSES, strict=True)]
            return {"kind": "force_profile", "points": points}
        if task.name == "detect_contact":
            path = [
                {"time_s": 0.0, "position_m": 0.0},
                {"time_s": task.duration_s(p), "position_m": _APPROACH_M_PER_S * task.duration_s(p)},
            ]
            return {"kind": "impedance", "arm": who.arm, "path": path}
        # It presses like a person who explores a stiffness.
        return self._reacting(10e-9, trial)

    def _reacting(self, force_n: float, trial: Trial) -> dict[str, Any]:
        who = self.profile
        return {
            "kind": "reacting",
            "points": [{"time_s": 0.0, "force_n": who.force_scale * force_n}],
            "reaction_time_s": who.reaction_time_s,
            "answer_s": round_trip_s(trial.settings),
            "gain": who.gain,
            "noise": who.noise,
            "tolerance_n": who.tolerance_n,
            "seed": self._draw(trial, "hand").randrange(2**31),
        }

    def _felt_s(self, data: TrialData) -> float | None:
        """Return when the force at the hand first differs from its earlier mean by the threshold [s]; None if never."""
        hand = data.haptic
        time_s, force_n = hand["time_s"], -hand["operator_force_n.2"]
        if time_s.size < 2:
            return None
        total = np.concatenate(([0.0], np.cumsum(force_n)))
        first = np.searchsorted(time_s, time_s - _BEFORE_S - _GAP_S)
        last = np.searchsorted(time_s, time_s - _GAP_S)
        is_steady = (last > first) & (time_s >= _STEADY_S)
        before = (total[last] - total[first]) / np.maximum(last - first, 1)
        noticed = np.flatnonzero(is_steady & (np.abs(force_n - before) > self.profile.threshold_n))
        return float(time_s[noticed[0]]) if noticed.size else None


def round_trip_s(settings: Mapping[str, Any]) -> float:
    """Return the round-trip delay of a trial's link [s], 0 if its settings have none."""
    section = {key.removeprefix("delay_node."): each for key, each in settings.items() if key.startswith("delay_node.")}
    link = validate(LinkSettings, nested(section, "settings"), "settings", "delay_node")
    return link.forward.delay_s + link.backward.delay_s


def _late(course: Course, reaction_s: float) -> list[tuple[float, float]]:
    """Return a target delayed by the reaction time, with a limited number of corners: times [s] and values."""
    times = course.times_s
    if len(times) > _CORNERS:
        times = np.linspace(times[0], times[-1], _CORNERS)
    values: Series = course.at(times)
    return [(round(t + reaction_s, 4), float(f"{v:.5g}")) for t, v in zip(times.tolist(), values.tolist(), strict=True)]
