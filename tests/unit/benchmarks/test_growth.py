"""Where a rig stops growing, in sentences: the first row that fails by each measure, and what happens in it."""

import json
import os
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).resolve().parents[3] / "benchmarks"))
import growth
import tables
from loop import ProcessWatch
from observers import Load, SessionError, said

from telenano.wire.topics import OWN_TOPICS as TOPICS

GOOD = {
    "asked_hz": 1000.0, "hand_hz": 999.5, "tip_hz": 1000.2, "p50_ms": 0.7, "p99_ms": 0.95, "superseded_hz": 2.0,
    "overruns_hz": 0.4, "received_hz": 0.0, "rig_percent": 110.0, "rig_mb": 480.0, "says": ["every node reports"],
}  # fmt: skip
STATUS = """\
haptic_node@master  running  0:00:06   3700.1
recorder@master     running  0:00:06   8546.6
recorder@master          no longer receives afm/state
link forward             clean · 0 in flight
age of the loop          law of the master: 0.522 of 1.3 ms (2.1 ms at 99 %); in ms: law of the master 0.522
machine                  haptic_node@master 3700 of 4000 Hz: the machine is too busy for this rate: end what else \
runs there, or give a lower realtime.rate_hz
hand haptic_node@master  position · programme at 5.4 s
every node reports and none waits for anything
"""


def row(value: int, **changed: Any) -> dict[str, Any]:
    return {"value": value, **GOOD, **changed}


def test_a_rig_that_holds_everywhere_says_so_and_what_is_at_the_end() -> None:
    found = growth.where_it_stops("subscribers", [row(value, received_hz=9000.0 * (value > 0)) for value in (0, 1, 16)])
    assert found == [
        "The rig holds its rate up to 16 processes, the most that was tried.",
        "The loop is younger than a tick at 99 % up to 16 processes.",
        "At 16 processes: superseded messages 2 /s, missed deadlines 0 /s, messages to a reader 9000 /s (100 % of the"
        " first row with one); `telenano status`: every node reports.",
    ]


def test_what_a_reader_still_has_is_said_beside_the_first_row_with_one() -> None:
    rows = [row(value, received_hz=received) for value, received in ((0, 0), (1, 9000), (16, 600))]
    last = growth.where_it_stops("subscribers", rows)[-1]
    assert "messages to a reader 600 /s (7 % of the first row with one);" in last
    assert "reader" not in growth.where_it_stops("subscribers", rows[:1])[-1]


def test_the_first_row_of_each_measure_is_named_with_what_happens_in_it() -> None:
    slow = {"hand_hz": 3700.0, "tip_hz": 3950.0, "asked_hz": 4000.0, "p99_ms": 2.5, "superseded_hz": 900.0}
    rows = [row(1000), row(2000, asked_hz=2000.0, hand_hz=1990.0, tip_hz=1999.0), row(4000, **slow, says=["a", "b?"])]
    found = growth.where_it_stops("rates", rows)
    assert found == [
        "The rig no longer holds its rate from 4000 Hz on: 3700 Hz at the hand and 3950 Hz at the tip of 4000 Hz.",
        "The loop is older than a tick at 99 % from 2000 Hz on: 0.95 ms, where a tick is 0.5 ms.",
        "At 2000 Hz: superseded messages 2 /s, missed deadlines 0 /s; `telenano status`: every node reports.",
        "At 4000 Hz: superseded messages 900 /s, missed deadlines 0 /s; `telenano status`: a; b?",
    ]


def test_a_row_without_figures_is_where_it_stops_and_a_first_row_may_be_too_old_already() -> None:
    rows = [row(125, asked_hz=125.0, hand_hz=125.0, tip_hz=125.0, p99_ms=8.5)]
    rows.append({"value": 4000, "asked_hz": 4000.0, "failed": "the rig ended before its session: it was not placed"})
    found = growth.where_it_stops("rates", rows)
    assert found[0] == "The rig holds its rate up to 125 Hz."
    assert found[1] == "There are no figures at 4000 Hz: the rig ended before its session: it was not placed."
    assert found[2].startswith("The loop is older than a tick at 99 % already from 125 Hz on: 8.50 ms")
    assert len(found) == 4
    assert growth.where_it_stops("rates", rows[1:]) == found[1:2]


@pytest.mark.parametrize("seed", range(60))
def test_the_rows_named_are_the_first_ones_of_any_table(seed: int) -> None:
    rng = np.random.default_rng(seed)
    values = sorted(rng.choice(64, int(rng.integers(1, 8)), replace=False).tolist())
    # by how many rows the rig keeps up in either way
    keeps, is_young = rng.integers(0, len(values) + 1, 2)
    rows = []
    for place, value in enumerate(values):
        hz = 1000.0 if place < keeps else float(rng.uniform(0.0, 989.0))
        at_hand = bool(rng.random() < 0.5)
        p99_ms = float(rng.uniform(0.2, 1.0) if place < is_young else rng.uniform(1.001, 30.0))
        rows.append(row(value, hand_hz=hz if at_hand else 1000.0, tip_hz=1000.0 if at_hand else hz, p99_ms=p99_ms))
    # a row before the stop that was disturbed is no stop
    disturbed = [each["value"] for each in rows[: max(0, keeps - 1)] if rng.random() < 0.2]
    for each in rows:
        each["hand_hz"] = 900.0 if each["value"] in disturbed else each["hand_hz"]
    rng.shuffle(rows)
    found = growth.where_it_stops("pages", rows)
    named = growth.AXES["pages"].named
    holds = keeps == len(values)
    if holds:
        assert found[0] == f"The rig holds its rate up to {named(values[-1])}, the most that was tried."
    else:
        assert found[0].startswith(f"The rig no longer holds its rate from {named(values[keeps])} on: ")
    odd = [text for text in found if "it did not, but with more it did" in text]
    assert [text.partition(" it")[0] for text in odd] == [f"At {named(value)}" for value in disturbed]
    of_age = found[1 + len(odd)]
    if is_young == len(values):
        assert of_age == f"The loop is younger than a tick at 99 % up to {named(values[-1])}."
    else:
        assert f"from {named(values[is_young])} on:" in of_age
        assert ("already" in of_age) == (is_young == 0)
    described = {values[-1], *values[keeps : keeps + 1], *values[is_young : is_young + 1]}
    assert [text.partition(":")[0] for text in found[2 + len(odd) :]] == [
        f"At {named(value)}" for value in sorted(described)
    ]


def test_the_ages_are_ratios_to_the_first_row_and_rounds_are_medians() -> None:
    rounds = [row(4, p50_ms=value, says=[text]) for value, text in ((1.0, "a"), (3.0, "b"), (2.0, "a"))]
    joined = growth.joined([*rounds, {"value": 4, "asked_hz": 1000.0, "failed": "x"}])
    assert (joined["p50_ms"], joined["says"], joined["value"]) == (2.0, ["a", "b"], 4)
    failed = {"value": 8, "asked_hz": 1000.0, "failed": "x"}
    assert growth.joined([failed, failed]) == failed
    found = growth.compared([row(0, p50_ms=0.5, p99_ms=1.0), joined, failed])
    assert [each.get("p50_ratio") for each in found] == [1.0, 4.0, None]
    assert [each.get("p99_ratio") for each in found] == [1.0, 0.95, None]
    assert "p50_ratio" not in growth.compared([failed, joined])[1]


def test_a_table_goes_on_after_a_session_without_figures_and_has_its_baseline_in_each_axis(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    asked: list[Load] = []

    def session(load: Load, window_s: float, folder: Path, *, asks_status: bool) -> dict[str, Any]:
        asked.append(load)
        if load.rate_hz == 4000.0:
            raise SessionError("the rig ended before its session")
        return {**GOOD, "p50_ms": 0.1 * len(asked)}

    monkeypatch.setattr(growth, "session", session)
    wanted = {axis: about.values for axis, about in growth.AXES.items()}
    found = growth.measure(wanted, 2, 0.1)["axes"]
    assert list(found) == list(growth.AXES)
    for axis, figures in found.items():
        assert [each["value"] for each in figures["rows"]] == sorted(growth.AXES[axis].values)
    baseline = {figures["rows"][3 if axis == "rates" else 0]["p50_ms"] for axis, figures in found.items()}
    assert len(baseline) == 1
    assert asked.count(Load()) == 2 * len(growth.AXES)
    assert {load: asked.count(load) for load in asked if load != Load()} == dict.fromkeys(set(asked) - {Load()}, 2)
    assert found["rates"]["rows"][-1]["failed"] == "the rig ended before its session"
    assert found["rates"]["stops"][1] == "There are no figures at 4000 Hz: the rig ended before its session."


def test_a_value_of_an_axis_is_a_load() -> None:
    assert growth.load_of("subscribers", 0) == growth.load_of("pages", 0) == growth.load_of("topics", 0) == Load()
    assert growth.load_of("subscribers", 4) == Load("shared", 4)
    assert growth.load_of("pages", 32) == Load("pages", 32)
    assert growth.load_of("rates", 250) == Load(rate_hz=250.0)
    assert growth.load_of("topics", 2) == Load("shared", 4, topics=("haptic/state", "afm/state"))
    assert sorted(growth.IN_ORDER) == sorted(TOPICS)
    # the same session serves both
    assert growth.load_of("topics", growth.AXES["topics"].values[-1]) == growth.load_of("subscribers", 4)
    baselines = {growth.load_of(axis, about.values[0]) for axis, about in growth.AXES.items()}
    assert baselines == {Load()}


def test_what_status_says_is_of_the_machine_and_of_problems() -> None:
    machine = (
        "haptic_node@master 3700 of 4000 Hz: the machine is too busy for this rate: end what else runs there, "
        "or give a lower realtime.rate_hz"
    )
    assert said(STATUS, "") == [machine]
    problem = "recorder@master no longer receives afm/state"
    assert said(STATUS, "telenano: nodes with a problem: recorder@master\n") == [machine, problem]
    fine = STATUS.replace("machine  ", "afm      ")
    assert said(fine, "") == ["every node reports and none waits for anything"]
    assert said("", "telenano: no node reports: is it running?\n") == ["no node reports: is it running?"]
    assert said("", "") == ["nothing"]


def test_a_watch_gives_the_shares_of_a_time_from_the_looks_around_it() -> None:
    watch = ProcessWatch.__new__(ProcessWatch)
    watch._samples = [(float(at), {"rig": (0.5 * at, 40.0 + at), "readers": (0.1 * at, 9.0)}) for at in range(10)]
    share, memory = watch.within(2.5, 5.5)
    assert share == pytest.approx({"rig": 50.0, "readers": 10.0}, rel=1e-9)
    assert memory == {"rig": 46.0, "readers": 9.0}
    # no look came after it
    assert watch.within(8.5, 20.0)[1]["rig"] == 49.0


@pytest.mark.check("starts processes")
def test_processes_of_a_group_are_one_row_and_each_of_a_rig_has_its_own() -> None:
    # the second one has a child of its own below it, as a browser has
    ready = "echo ready; exec cat"
    deeper = f"sh -c \"sh -c '{ready}'; :\"; :"
    memory_mb = []
    for programs in ((ready, ready), (ready, deeper)):
        pipe = subprocess.PIPE
        both = [subprocess.Popen(["sh", "-c", program], stdin=pipe, stdout=pipe) for program in programs]
        for each in both:
            assert each.stdout is not None
            each.stdout.readline()
        watch = ProcessWatch(os.getpid(), {each.pid: "readers" for each in both})
        while len(watch._samples) < 2:
            time.sleep(0.05)
        watch.end()
        for each in both:
            each.communicate()
        _, memory = watch.within(0.0, watch._samples[-1][0])
        memory_mb.append(memory["readers"])
    # two shells and what they run in the place of that alone
    assert memory_mb[1] > 1.3 * memory_mb[0] > 0.0
    names = set(memory) - {"readers"}
    assert "launcher@master" in names


def test_the_tables_of_the_page_have_a_column_for_each_figure() -> None:
    rows = growth.compared([row(0), row(2, readers_mb=120.0), {"value": 4, "asked_hz": 1000.0, "failed": "x"}])
    figures = {"axes": {"subscribers": {"rows": rows, "stops": growth.where_it_stops("subscribers", rows)}}}
    lines = tables.growth_lines(json.loads(json.dumps(figures)))
    assert lines[0] == "Processes that read every topic:"
    head, ruler, *body = lines[2:7]
    assert "readers [MB]" in head
    assert "page server [MB]" not in head
    assert len({line.count("|") for line in (head, ruler, *body)}) == 1
    assert lines[8:] == figures["axes"]["subscribers"]["stops"]
