"""Advice on the law for a line, a sample and an instrument: the benchmark's cells, plus trials on that line.

Each law with its default settings is tried on the line itself (`telenano_lab.studies.loops.advice`). A law is not
suited if one of its trials was not held or made energy, while another law passed all of them; the reasons are given
with their figures. A law that held all of its trials is suited, whatever other lines say.

The runs of the benchmark (`kept`) count as far as they are those of this line: of its own network, or of networks of
the same kind, with a delay within a factor of NEAR_LINE and a sample within NEAR_SAMPLE. A law that is behind the best
of them, by `results.standings_of`, comes after one that is not; within both the price of the trials decides. Variants
that the benchmark did not run, with tuned settings or a switched clamp, are listed apart and never first.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from statistics import NormalDist
from typing import Any

from telenano.analysis import wilson
from telenano.settings import LinkSettings, profile_named
from telenano_lab.experiments.benchmark.kept import chosen, kept
from telenano_lab.experiments.benchmark.plan import INSTRUMENTS, LINES, NETWORKS, SAMPLES, TASKS
from telenano_lab.experiments.benchmark.results import Situation, makes_energy
from telenano_lab.experiments.benchmark.standings import Standings, Stood, of_runs
from telenano_lab.studies.loops.advice import Candidate, Question, try_all
from telenano_lab.studies.loops.cells import CellResult
from telenano_lab.studies.loops.sweep import Sweep

# A network is like the asked line if their round trips differ by at most this factor, a sample likewise.
NEAR_LINE, NEAR_SAMPLE = 1.5, 1.5
# A law that held as often is named if the stiffness that it lets feel is nearer to that of the sample by this factor.
_FEELS_NEARER = 1.3
# A line is local if nearly every message is back within this time: half of that of the shortest other line [ms].
LOCAL_MS = 8.0
# Delays are even if their 95 % quantile is at most this share above the median: for `satellite` it is 0.09.
EVEN_SHARE = 0.1
# A line is uneven from this share of lost messages on: ten times the loss of `satellite` in each direction.
LOSSY = 0.01
_AT_95 = NormalDist().inv_cdf(0.95)


@dataclass(frozen=True)
class Advice:
    """The laws with default settings, the recommended one first; then variants that the benchmark did not run.

    standings: the benchmark's order of the laws in the situation, empty if it has no such cell; digest: that of its
    runs; notes: differences of the cells from the question.
    """

    question: Question
    situation: Situation
    standings: Sequence[Stood]
    digest: str
    notes: Sequence[str]
    tried: Sequence[Candidate]

    @cached_property
    def by_law(self) -> Mapping[str, Stood]:
        """Return the standings by law."""
        return {one.law: one for one in self.standings}

    @cached_property
    def laws(self) -> list[Candidate]:
        """Return the laws with default settings, the recommended one first."""
        places = {one.law: number for number, one in enumerate(self.standings)}
        came = [candidate for candidate in self.tried if candidate.clamp is None]
        return sorted(
            came,
            key=lambda one: (
                bool(self.reasons[one.law]),
                self._is_behind(one.law),
                len(failures(one)),
                round(one.price(), 3),
                places.get(one.law, math.inf),
                one.law,
            ),
        )

    @cached_property
    def forms(self) -> list[Candidate]:
        """Return the variants outside the benchmark that passed all trials, the cheapest first."""
        good = [candidate for candidate in self.tried if candidate.clamp is not None and not failures(candidate)]
        return sorted(good, key=lambda one: one.price())

    @property
    def ordered(self) -> list[Candidate]:
        """Return all candidates: the laws in the order of the advice, then the variants, the failed ones last."""
        forms = [candidate for candidate in self.tried if candidate.clamp is not None]
        return [*self.laws, *sorted(forms, key=lambda one: (len(failures(one)), one.price()))]

    @property
    def take(self) -> Candidate:
        """Return the recommended law, or the nearest to one if none is suited."""
        return self.laws[0]

    @cached_property
    def reasons(self) -> Mapping[str, str]:
        """Return the reason why each law is not suited, by law; empty for a suited one."""
        came = [candidate for candidate in self.tried if candidate.clamp is None]
        # If no law passes, as over a line that stalls, failed trials do not distinguish the laws.
        tells = any(not failures(one) for one in came)
        return {one.law: "; ".join(self._reasons_of(one, tells=tells)) for one in came}

    def _reasons_of(self, candidate: Candidate, *, tells: bool) -> list[str]:
        standing, reasons = self.by_law.get(candidate.law), []
        if tells and failures(candidate):
            reasons.append(why_failed(candidate))
        # Runs elsewhere do not overrule the line itself: what held all of its trials is suited.
        if standing is not None and standing.is_behind and failures(candidate):
            reasons.append(why_behind(standing, self.best))
        return reasons

    @property
    def best(self) -> Stood:
        """Return the law with the greatest share of runs held in the benchmark, among those that are not behind."""
        ahead = [one for one in self.standings if not one.is_behind]
        return max(ahead, key=lambda one: (one.held if one.sound is None else one.sound) / one.runs)

    def _is_behind(self, law: str) -> bool:
        return law in self.by_law and self.by_law[law].is_behind

    def as_records(self) -> list[dict[str, Any]]:
        """Return a record for each candidate, in the order of `ordered`."""
        records = []
        for one in self.ordered:
            of_benchmark = self.by_law.get(one.law) if one.clamp is None else None
            reason = self.reasons[one.law] if one.clamp is None else why_failed(one)
            records.append(
                {
                    **one.as_dict(),
                    "suited": not reason,
                    "reason": reason,
                    "benchmark": None if of_benchmark is None else of_benchmark.as_dict(),
                }
            )
        return records


def failures(candidate: Candidate) -> list[CellResult]:
    """Return the trials of a candidate that were not held or made energy."""
    return [one for one in candidate.results if one.outcome != "stable" or makes_energy(1e3 * one.lowest_energy_j)]


def why_failed(candidate: Candidate) -> str:
    """Return a sentence on the failed trials, with the figures of the first; empty if none failed."""
    failed = failures(candidate)
    if not failed:
        return ""
    kinds: dict[str, int] = {}
    for one in failed:
        kind = one.outcome if one.outcome != "stable" else "made energy"
        kinds[kind] = kinds.get(kind, 0) + 1
    first = failed[0]
    example = first.reason if first.outcome != "stable" else f"{-1e3 * first.lowest_energy_j:.2g} mJ more came out"
    return f"{len(failed)} of {len(candidate.results)} runs on this line: {_counted(kinds)}; the first: {example}"


def why_behind(stood: Stood, best: Stood) -> str:
    """Return the reason why the benchmark puts a law behind the best one."""
    if stood.sound is not None and best.sound is not None:
        made = f", and {stood.made_energy} made energy" if stood.made_energy else ""
        return (
            f"in the benchmark {stood.sound} of {stood.runs} runs were held without making energy, and of {best.law}"
            f" {best.sound} of {best.runs}: {stood.runs - stood.held} were not held{made}"
        )
    held = f"in the benchmark {stood.held} of {stood.runs} runs were held, and of {best.law} {best.held} of {best.runs}"
    is_less = wilson(stood.held, stood.runs)[1] < wilson(best.held, best.runs)[0]
    return held if is_less else f"{held}, and it made energy in some of them"


def _counted(kinds: Mapping[str, int]) -> str:
    most_first = sorted(kinds.items(), key=lambda one: (-one[1], one[0]))
    return ", ".join(f"{count} {kind.replace('_', ' ')}" for kind, count in most_first)


def advise(question: Question, sweep: Sweep, table: Standings | None = None) -> Advice:
    """Try every law on the line, and order the laws as the benchmark does.

    Args:
        question: The line, the sample and the instrument.
        sweep: Runs the trials.
        table: The standings of the benchmark; None for those of its runs on lines like this one.

    Raises:
        ConfigError: The line or the instrument is not known, or the runs cannot be read.
    """
    situation, notes = situation_of(question)
    said = _of_like_lines(question, situation) if table is None else table
    standings = said.situations.get(situation, [])
    if not standings:
        notes = [
            *notes,
            f"The benchmark has no runs on a line like this ({_named(situation)}): the trials alone decide.",
        ]
    return Advice(question, situation, standings, said.digest, notes, try_all(question, sweep))


def _of_like_lines(question: Question, situation: Situation) -> Standings:
    """Return the standings of the benchmark's runs on the network of a question, or on networks and samples like it."""
    runs = kept()
    tip = question.tip_n_per_m
    tasks = [task for task in SAMPLES[situation.sample] if _is_near(TASKS[task].stiffness_n_per_m, tip, NEAR_SAMPLE)]
    networks = [one for one in LINES[situation.line] if _is_like(question, one)]
    some = chosen(runs.outcomes.values(), network=networks, task=tasks, instrument=[situation.instrument])
    return of_runs(some if networks and tasks else (), runs.digest)


def _is_like(question: Question, network: str) -> bool:
    if question.network in NETWORKS:
        return question.network == network
    return _is_near(profile_named(network).round_trip_ms, question.round_trip_ms, NEAR_LINE)


def _is_near(one: float, other: float, factor: float) -> bool:
    return one == other or (min(one, other) > 0.0 and max(one, other) <= factor * min(one, other))


def situation_of(question: Question) -> tuple[Situation, list[str]]:
    """Return the situation of the benchmark nearest to a question, and sentences on their differences."""
    notes = []
    instrument = question.instrument
    if instrument not in INSTRUMENTS:
        instrument = "real"
        notes.append(f"The benchmark has no cell of the instrument {question.instrument}: those of {instrument} count.")
    stiffness = {sample: [TASKS[task].stiffness_n_per_m for task in tasks] for sample, tasks in SAMPLES.items()}
    tip = question.tip_n_per_m
    sample = min(stiffness, key=lambda name: min(abs(math.log(tip / one)) for one in stiffness[name]))
    softest, stiffest = (end(one for some in stiffness.values() for one in some) for end in (min, max))
    if not softest <= tip <= stiffest:
        notes.append(f"The cells have samples of {softest:g} to {stiffest:g} N/m, and this one has {tip:g} N/m.")
    return Situation(kind_of_line(question), instrument, sample), notes


def kind_of_line(question: Question) -> str:
    """Return the benchmark's kind of line: that of its own networks, or by the statistics of the delays.

    A line is a measured line if its delays are correlated in time or it stalls at times; local if nearly every message
    is back within LOCAL_MS; long distance if its delays are even and it hardly loses messages; and else one of
    independent delays.
    """
    if question.network is None:
        # For a uniform jitter the 95 % quantile is 0.9 of its half-width above the median.
        above_ms = 2.0 * 0.9 * question.jitter.at_ms(question.round_trip_ms)
        return _kind(question.round_trip_ms, above_ms, question.loss)
    own = next((line for line, networks in LINES.items() if question.network in networks), None)
    if own is not None:
        return own
    link = LinkSettings.of({"profile": question.network, "seed": 0}, f"network {question.network}")
    if any(_lasts(way) for way in (link.forward, link.backward)):
        return "measured line"
    ways = profile_named(question.network).statistics.values()
    return _kind(sum(map(_middle_ms, ways)), sum(map(_above_ms, ways)), max(way.lost for way in ways))


def _kind(median_ms: float, above_ms: float, lost: float) -> str:
    if lost < LOSSY and median_ms + above_ms <= LOCAL_MS:
        return "local"
    return "long distance" if lost < LOSSY and above_ms <= EVEN_SHARE * median_ms else "independent delays"


def _lasts(way: Any) -> bool:
    """Return whether delays of a direction are correlated in time, or it stalls at times."""
    outage = way.outage
    return way.jitter.correlation_time_s > 0.0 or bool(outage.schedule or outage.period_s or outage.mean_up_s)


def _middle_ms(way: Any) -> float:
    """Return the median delay of the statistics of a direction, or else its mean [ms]."""
    return float(way.percentiles_ms.get(50.0, way.mean_ms))


def _above_ms(way: Any) -> float:
    """Return the distance of the 95 % quantile of the delays from the median [ms], assuming a normal distribution."""
    greatest = max(way.percentiles_ms, default=50.0)
    if greatest > 50.0:
        at = NormalDist().inv_cdf(0.01 * greatest)
        return float(way.percentiles_ms[greatest] - _middle_ms(way)) * _AT_95 / at
    return float(way.deviation_ms or 0.0) * _AT_95


def in_words(advice: Advice) -> list[str]:
    """Return the advice in sentences: the law to take and why, next ones, unsuited ones, and variants that passed."""
    question, best = advice.question, advice.take
    network = f"{question.round_trip_ms:g} ms" if question.network is None else question.network
    network += f", jitter {question.jitter}" if question.jitter.value else ""
    network += f", {100.0 * question.loss:g} % loss" if question.loss else ""
    where = f"{network}, {question.environment} of {question.tip_n_per_m:g} N/m, instrument {question.instrument}"
    failed, runs = failures(best), len(best.results)
    if advice.reasons[best.law]:
        words = [f"{where}: no law is suited. The nearest is {best.name}: {advice.reasons[best.law]}."]
        words.append("Take a shorter network or a softer sample.")
    elif failed:
        words = [f"{where}: no law held in all of its runs. Take {best.name}, {_figures(best)}: {why_failed(best)}."]
    else:
        words = [f"{where}: take {best.name}; all of its {runs} runs held, {_figures(best)}."]
    words += [_of_cells(advice), *advice.notes]
    others = advice.laws[1:]
    suited = [f"{other.name}, {_figures(other)}" for other in others if not advice.reasons[other.law]]
    if suited:
        words.append(f"Next come {'; '.join(suited[:2])}.")
    felt = best.felt_share()
    nearer = [
        f"{other.name} ({share:.2f})"
        for other in others
        if not failures(other)
        and felt
        and (share := other.felt_share())
        and abs(math.log(felt)) > abs(math.log(share)) + math.log(_FEELS_NEARER)
    ]
    if nearer and felt:
        words.append(
            f"Of the laws that held all runs these let the hand feel more of the sample than the {felt:.2f} of"
            f" {best.name}: {'; '.join(nearer)}."
        )
    unsuited = [f"{other.name} ({advice.reasons[other.law]})" for other in others if advice.reasons[other.law]]
    if unsuited:
        words.append(f"Not suited: {'; '.join(unsuited)}.")
    if advice.forms:
        forms = "; ".join(f"{form.name}{_settings(form)}, {_figures(form)}" for form in advice.forms[:2])
        words.append(f"Not in the benchmark, and held in all runs on this line: {forms}.")
    return words


def _of_cells(advice: Advice) -> str:
    """Return a sentence on the benchmark's cells, and on trials that changed their order."""
    if not advice.standings:
        return f"The kind of line is {advice.situation.line}."
    first = advice.standings[0]
    sound, energy = (first.held, "") if first.sound is None else (first.sound, " without making energy")
    error = "" if first.tracking_error is None else f", with a tracking error of {first.tracking_error:.2g}"
    said = (
        f"The cells of the benchmark ({_named(advice.situation)}) say {first.law}: {sound} of {first.runs} runs were"
        f" held{energy}{error}"
    )
    if first.law == advice.take.law:
        return f"{said}."
    tried = next((one for one in advice.laws if one.law == first.law), None)
    return f"{said}; on this line it is not first: {why_failed(tried) if tried else 'it was not tried'}."


def _named(situation: Situation) -> str:
    return f"{situation.line}, instrument {situation.instrument}, {situation.sample}"


def _settings(candidate: Candidate) -> str:
    keys = [f"{key}={value}" for key, value in candidate.settings if key != "clamp.enabled"]
    return f" and {', '.join(keys)}" if keys else ""


def _figures(candidate: Candidate) -> str:
    felt, apart = ("-" if one is None else f"{one:.2f}" for one in (candidate.felt_share(), candidate.apart_share()))
    return (
        f"with {candidate.force_share():.2f} of the force in the worst hold, a peak of {candidate.peak_share():.2f},"
        f" {felt} of the sample's stiffness felt in a hold, hand and tip apart by {apart} of the indentation,"
        f" and {candidate.free_n_s_per_m:.3g} N s/m in free motion"
    )
