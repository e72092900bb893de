"""The advice for a line is what the benchmark's cells say, tried on the line; what disqualifies a law is said."""

import json
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from benchmark_folders import COMPUTED_BY
from telenano_lab.experiments.benchmark import line_advice
from telenano_lab.experiments.benchmark.line_advice import advise, failures, in_words, kind_of_line, situation_of
from telenano_lab.experiments.benchmark.plan import LINES, SAMPLES, Run
from telenano_lab.experiments.benchmark.results import Situation
from telenano_lab.experiments.benchmark.run import MEASURES, Outcome
from telenano_lab.experiments.benchmark.standings import Standings, Stood, of_runs
from telenano_lab.studies.loops.advice import Question, cells_of
from telenano_lab.studies.loops.cells import Cell, CellResult, run_cell
from telenano_lab.studies.loops.sweep import Journal, Sweep
from telenano_lab.studies.option_values import COMPARED_LAWS, Jitter

from telenano.testing import invoke

ORDINARY: dict[str, Any] = {
    "verdict": "stable", "growth_per_s": None, "peak_to_peak_n": 0.0, "out_of_contact_share": 0.0, "hold_ratio": 1.0,
    "lowest_energy_j": 0.0, "guarded": False, "reason": "the motion dies out", "peak_n": 1.0, "tip_n": 1.0,
    "hand_n": 1.0,
}  # fmt: skip


class Trials(Sweep):
    """Trials that end as `answer` says, in the names of `CellResult`."""

    def __init__(self, answer: Callable[[Cell], dict[str, Any]]) -> None:
        super().__init__(Journal(Path("nowhere")), 1)
        self.answer = answer

    def run(self, cells: Any) -> list[CellResult]:
        return [CellResult(cell, **{**ORDINARY, **self.answer(cell)}) for cell in cells]


def table(situation: Situation, **held: tuple[int, float, float]) -> Standings:
    """Return what 100 runs a law say in a situation: how many were held, their tracking error and energy [mJ]."""
    line, instrument, sample = situation
    outcomes = []
    for law in COMPARED_LAWS:
        count, tracking, energy = held.get(law, (0, 1.0, 0.0))
        run = Run(
            task=SAMPLES[sample][-1], network=LINES[line][0], law=law, hand="force", seed=0, instrument=instrument
        )
        measures = {**dict.fromkeys(MEASURES), "tracking_error": tracking, "least_energy_mj": energy}
        outcomes += [Outcome(run, "stable" if seed < count else "diverged", "", measures) for seed in range(100)]
    return of_runs(outcomes, "0" * 64)


def fails(**failing: dict[str, Any]) -> Trials:
    """Return trials in which the runs of some laws end otherwise than well, with a hand of constant force."""
    return Trials(lambda cell: failing.get(cell.law, {}) if cell.hand == "force" else {})


OF_WAVE = {
    "wave": (100, 0.6, 0.0),
    "passivity": (99, 0.7, 0.0),
    "smith": (86, 0.1, 0.0),
    "position_force": (30, 0.05, 0.0),
}
UNEVEN = Question(round_trip_ms=120.0, loss=0.03, stiffness_n_per_m=80.0)
PLACE = Situation("independent delays", "real", "80 N/m")


def test_the_law_of_the_cells_is_taken_and_each_that_is_not_suited_has_what_disqualifies_it() -> None:
    found = advise(
        UNEVEN,
        fails(passivity={"verdict": "diverged", "reason": "it grows"}),
        table(PLACE, **OF_WAVE),
    )
    assert found.situation == PLACE
    assert found.take.law == "wave"
    assert found.reasons["wave"] == ""
    assert found.reasons["passivity"] == "3 of 12 runs on this line: 3 diverged; the first: it grows"
    # A law that held all of its trials is suited, and comes after those that the runs of the benchmark put before it.
    assert found.reasons["smith"] == ""
    behind = [one.law for one in found.laws if found.by_law.get(one.law) and found.by_law[one.law].is_behind]
    assert "smith" in behind
    assert [one.law for one in found.laws if not found.reasons[one.law]][-len(behind) :] == behind
    words = in_words(found)
    assert words[0].startswith("120 ms, 3 % loss, wall of 80 N/m, instrument real: take wave; all of its 12 runs held")
    assert "say wave: 100 of 100 runs were held without making energy, with a tracking error of 0.6." in words[1]
    assert f"passivity ({found.reasons['passivity']})" in " ".join(words)


def test_a_law_of_the_cells_that_the_line_does_not_bear_gives_way_and_the_words_say_so() -> None:
    energy = {"lowest_energy_j": -3e-4}
    found = advise(UNEVEN, fails(wave=energy), table(PLACE, **OF_WAVE))
    assert found.take.law == "passivity"
    assert found.reasons["wave"] == "3 of 12 runs on this line: 3 made energy; the first: 0.3 mJ more came out"
    assert f"on this line it is not first: {found.reasons['wave']}." in in_words(found)[1]


def test_where_no_law_comes_through_that_of_the_cells_is_the_nearest() -> None:
    """A stall ends the runs of every law, so that it tells none from another."""
    stalled = {"verdict": "guarded", "reason": "the instrument withdrew", "guarded": True}
    found = advise(UNEVEN, Trials(lambda cell: stalled), table(PLACE, **OF_WAVE))
    assert (found.take.law, found.reasons["wave"]) == ("wave", "")
    assert found.reasons["smith"].startswith("in the benchmark 86 of 100")
    assert "no law held in all of its runs. Take wave" in in_words(found)[0]


def test_what_the_benchmark_did_not_run_stands_apart_and_is_never_first() -> None:
    clamped = Trials(lambda cell: {} if dict(cell.settings).get("clamp.enabled") else {"verdict": "diverged"})
    found = advise(UNEVEN, clamped, table(PLACE, **OF_WAVE))
    assert found.take.clamp is None
    assert {one.clamp for one in found.forms} == {True}
    assert in_words(found)[-1].startswith("Not in the benchmark, and held in all runs on this line: ")


@pytest.mark.parametrize(
    ("question", "kind"),
    [
        (Question(round_trip_ms=0.0), "local"),
        (Question(round_trip_ms=5.0, jitter=Jitter(0.5)), "local"),
        (Question(round_trip_ms=30.0), "long distance"),
        (Question(round_trip_ms=300.0, jitter=Jitter(10.0)), "long distance"),
        (Question(round_trip_ms=180.0, jitter=Jitter(40.0), loss=0.1), "independent delays"),
        (Question(round_trip_ms=5.0, loss=0.05), "independent delays"),
        (Question(network="lan"), "local"),
        (Question(network="transcontinental"), "long distance"),
        (Question(network="4g"), "independent delays"),
        (Question(network="private_5g_cmwave"), "measured line"),
        (Question(network="netfi_outage_1"), "measured line"),
        *((Question(network=name), line) for line, names in LINES.items() for name in names),
    ],
)
def test_a_line_is_of_the_kind_whose_delays_it_has(question: Question, kind: str) -> None:
    assert kind_of_line(question) == kind


def test_what_the_cells_do_not_have_is_said() -> None:
    far = Question(round_trip_ms=0.0, stiffness_n_per_m=300.0, instrument="real_drifting")
    situation, notes = situation_of(far)
    assert situation == Situation("local", "real", "80 N/m")
    assert len(notes) == 2 and "real_drifting" in notes[0] and "300 N/m" in notes[1]
    found = advise(far, fails(), Standings({}, "0" * 64))
    assert "the trials alone decide" in found.notes[-1]
    assert not any(found.reasons.values())


def ends(answers: dict[str, dict[str, Any]]) -> Trials:
    return Trials(lambda cell: answers.get(cell.law, {}))


def drawn(seed: int) -> Question:
    """Return a drawn line, sample and instrument: half of them numbers, half named networks."""
    source = np.random.default_rng([20261, seed])
    common: dict[str, Any] = {
        "stiffness_n_per_m": round(float(np.exp(source.uniform(np.log(8.0), np.log(100.0)))), 1),
        "instrument": ("ideal", "real")[int(source.integers(2))],
        "seeds": 1,
    }
    names = [name for networks in LINES.values() for name in networks]
    if source.random() < 0.5:
        return Question(network=names[int(source.integers(len(names)))], **common)
    delay_ms = round(float(np.exp(source.uniform(np.log(1.0), np.log(300.0)))), 1)
    jitter = Jitter(round(float(source.choice([0.0, source.uniform(0.02, 0.4)])), 3), relative=True)
    return Question(
        round_trip_ms=delay_ms,
        jitter=jitter,
        loss=round(float(source.choice([0.0, source.uniform(0.001, 0.15)])), 3),
        **common,
    )


@pytest.mark.parametrize("count", [20, pytest.param(100, marks=pytest.mark.endurance("takes 16 s"))])
def test_over_drawn_answers_the_order_is_that_of_the_cells_and_every_reason_is_one(count: int) -> None:
    """Whatever the trials say, a suited law has no reason, an unsuited one has a figure, and the rule is one."""
    source = np.random.default_rng(11)
    for number in range(count):
        question = drawn(number)
        counts = {law: (int(source.integers(60, 101)), float(source.uniform(0.05, 1.0)), 0.0) for law in COMPARED_LAWS}
        runs = table(situation_of(question)[0], **counts)
        share = float(source.choice([0.0, 0.1, 1.0]))
        bad = {law for law in COMPARED_LAWS if source.random() < share}
        wrong: tuple[dict[str, Any], ...] = (
            {"verdict": "diverged", "reason": "it grows by 3/s"},
            {"facts": ("off_force",), "reason": "it rests at 0.4 of the force"},
            {"lowest_energy_j": -1e-3},
        )
        answers = {law: wrong[int(source.integers(3))] for law in bad}
        found = advise(question, ends(answers), runs)
        rows = [one.law for one in runs.situations[found.situation]]
        suited = [one.law for one in found.laws if not found.reasons[one.law]]
        for one in found.laws:
            reason = found.reasons[one.law]
            assert "dies out" not in reason
            assert not reason or any(letter.isdigit() for letter in reason)
            if one.law in suited and not failures(found.take):
                assert not failures(one)
        ahead = [law for law in rows if not found.by_law[law].is_behind]
        assert found.take.law in ahead or not any(not found.reasons[law] for law in ahead)
        good = [law for law in ahead if law not in bad]
        assert found.take.law == (good or [found.take.law])[0]
        assert json.loads(json.dumps(found.as_records(), allow_nan=False))


def test_the_command_says_the_cells_and_leaves_a_page(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    made, trials = (
        table(PLACE, **OF_WAVE),
        fails(passivity={"verdict": "diverged", "reason": "it grows"}),
    )
    told = line_advice.advise
    monkeypatch.setattr(line_advice, "advise", lambda question, sweep: told(question, trials, made))
    command = ["study", "advise", "--delay", "120", "--loss", "3%", "--sample", "stiff", "--out", str(tmp_path)]
    done = invoke([*command, "--table", "csv,parquet,mat"])
    assert done.exit_code == 0, done.output
    assert done.stdout.startswith("120 ms, 3 % loss, wall of 80 N/m, instrument real: take wave; all of its 12 runs")
    assert "set: --set controller.law=wave\n" in done.stdout
    summary = json.loads((tmp_path / "advise.json").read_text())
    assert (summary["take"], summary["benchmark"]) == ("wave", made.digest)
    assert summary["cells"] == {"line": "independent delays", "instrument": "real", "sample": "80 N/m"}
    by_law = {one["law"]: one for one in summary["candidates"] if one["clamp"] is None}
    assert by_law["passivity"]["suited"] is False and "it grows" in by_law["passivity"]["reason"]
    assert by_law["smith"]["suited"] is True and by_law["smith"]["felt_share"] == 1.0
    assert {path.suffix for path in tmp_path.glob("advise.*")} == {".html", ".json", ".csv", ".parquet", ".mat"}
    assert "take wave" in (tmp_path / "advise.html").read_text()
    refused = invoke([*command, "--table", "xlsx"])
    assert refused.exit_code != 0 and "name one or more of csv, parquet, mat" in refused.output


def like(**asked: Any) -> Sequence[Stood]:
    """Return the standings that count for a question whose trials all end well."""
    return advise(Question(instrument="real", **asked), fails()).standings


def test_the_runs_that_count_are_those_of_lines_like_the_asked_one() -> None:
    """A network of the benchmark has its own runs, and no run of 78 ms counts for a line of 12."""
    own = like(network="lossy_bursts", stiffness_n_per_m=20.0)
    assert {one.law for one in own} == set(COMPARED_LAWS)
    smith = next(one for one in own if one.law == "smith")
    assert smith.held == smith.runs and not smith.is_behind
    assert not like(round_trip_ms=12.0, stiffness_n_per_m=20.0)
    assert not like(network="lossy_bursts", stiffness_n_per_m=9.0)


SESSIONS = 5


def judged_sessions(question: Question, law: str) -> list[str]:
    """Return how sessions of a law on a line end that are not those of the trials: other seeds, and all hands."""
    fresh = [one.model_copy(update={"seed": 100 + one.seed}) for one in cells_of(question, law, None)]
    several = [fresh[number % len(fresh)].model_copy(update={"seed": 100 + number}) for number in range(SESSIONS)]
    return [run_cell(one).outcome for one in several]


def shares(seeds: range, folder: Path) -> tuple[int, int, list[str]]:
    """Return on how many drawn lines the advice is that of the cells, on how many it holds, and those that differ."""
    agree, holds, others = 0, 0, []
    for seed in seeds:
        question = drawn(seed)
        found = advise(question, Sweep(Journal(folder / "journal.jsonl"), 1))
        said, ends_as = found.standings[0].law, judged_sessions(question, found.take.law)
        agree += said == found.take.law
        is_held = all(one == "stable" for one in ends_as)
        holds += is_held
        if said != found.take.law or not is_held:
            others.append(f"{seed} {in_words(found)[:2]} {ends_as}")
    return agree, holds, others


@pytest.mark.endurance("runs a hundred lines")
@pytest.mark.timeout(7200)
def test_the_advice_of_100_drawn_lines_is_that_of_the_cells_and_holds_in_five_sessions(tmp_path: Path) -> None:
    """Where the cells are not followed the line itself disqualified their law, and that is said with its figures."""
    agree, holds, others = shares(range(100), tmp_path)
    assert agree >= 70 and holds >= 70, "\n".join(others)


@pytest.mark.check("runs two drawn lines, takes a minute")
@pytest.mark.drawn(0.0, *COMPUTED_BY)
def test_the_advice_of_two_drawn_lines_is_that_of_the_cells_or_says_what_the_line_does_not_bear(tmp_path: Path) -> None:
    for seed in (3, 8):
        found = advise(drawn(seed), Sweep(Journal(tmp_path / "journal.jsonl"), 1))
        said = found.standings[0].law
        assert found.take.law == said or found.reasons[said] or failures(found.take)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--delay", "120", "--stiffness", "-3"], "--stiffness = -3 must be above 0 to 100000"),
        (["--delay", "1e9"], "--delay = 1e+09 must be 0 to 10000"),
        (["--delay", "5", "--loss", "3"], "a share of the messages"),
    ],
)
def test_the_command_refuses_what_is_no_network(tmp_path: Path, options: list[str], words: str) -> None:
    done = invoke(["study", "advise", *options, "--out", str(tmp_path)])
    assert done.exit_code != 0
    assert words in done.output
