"""Critical delays, the search for them, the journal, and the page that is made of it all."""

import dataclasses
import json
import math
from collections.abc import Callable
from importlib.metadata import version
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pyarrow.parquet as pq
import pytest
from answered_sweep import Answered
from telenano_lab.studies.loops import sweep as sweep_module
from telenano_lab.studies.loops.cells import Cell, CellResult, Hand, judged, run_cell, trajectory_of
from telenano_lab.studies.loops.stability import (
    Axes,
    Edge,
    Line,
    LineResult,
    find_edges,
    line_result,
    neutral,
    run_stability,
    theory_of,
)
from telenano_lab.studies.loops.sweep import Journal, Sweep
from telenano_lab.studies.option_values import Jitter
from telenano_lab.studies.pages.stability_page import broken_assumption, summarise, write_stability

from telenano.afm import MODE_HOLD, MODE_RETRACTING
from telenano.analysis import VERDICT_COLOURS, Page
from telenano.wire import ConfigError


def axes(**changes: Any) -> Axes:
    values: dict[str, Any] = {
        "laws": ("virtual_impedance",),
        "environment": "spring",
        "delays_ms": (0.0, 50.0, 100.0),
        "stiffnesses_n_per_m": (10.0, 20.0, 38.0),
    }
    return Axes(**{**values, **changes})


def sweep(folder: Path) -> Sweep:
    return Sweep(Journal(folder / "journal.jsonl"), workers=1)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("stability")


@pytest.fixture(scope="module")
def results(folder: Path) -> list[LineResult]:
    return run_stability(axes(), sweep(folder))


def test_critical_delays_on_the_spring_are_those_of_theory(results: list[LineResult]) -> None:
    expected = {10.0: 95.05, 20.0: 45.51, 38.0: 22.44}
    for result in results:
        delay_ms = expected[result.line.stiffness_n_per_m]
        assert result.critical_delay_ms == pytest.approx(delay_ms, rel=2e-3, abs=0.0)
        assert result.theory_ms == pytest.approx(delay_ms, rel=3e-4, abs=0.0)
        assert result.critical_link_ms == pytest.approx(result.theory_link_ms, rel=2e-3, abs=0.0)
        assert result.critical_delay_ms - result.critical_link_ms == pytest.approx(0.5, rel=1e-9, abs=0.0)


def test_devices_take_their_latency_from_what_the_link_may_add(results: list[LineResult], tmp_path: Path) -> None:
    simulated = results[-1]
    (devices,) = run_stability(axes(stiffnesses_n_per_m=(38.0,), device_latency_ms=3.0), sweep(tmp_path))
    assert devices.critical_delay_ms == pytest.approx(simulated.critical_delay_ms, rel=2e-3, abs=0.0)
    for found, before in (
        (devices.critical_link_ms, simulated.critical_link_ms),
        (devices.theory_link_ms, simulated.theory_link_ms),
    ):
        assert before is not None
        assert found == pytest.approx(before - 3.0, abs=0.05, rel=0.0)
    assert devices.theory_ms == simulated.theory_ms


def test_paper_in_the_contact_is_steady_at_40_ms_and_cycles_at_60_ms() -> None:
    steady, cycling = (
        run_cell(Cell(law="virtual_impedance", environment="tip_sample", round_trip_ms=ms, stiffness_n_per_m=40.0))
        for ms in (40.0, 60.0)
    )
    assert (steady.verdict, cycling.verdict) == ("stable", "limit_cycle")
    assert steady.hold_ratio == pytest.approx(1.05, rel=1e-5, abs=0.0)
    assert steady.out_of_contact_share == 0.0
    assert cycling.peak_to_peak_n == pytest.approx(7.1, rel=0.02, abs=0.0)
    assert cycling.out_of_contact_share > 0.1


def stable_up_to(edge_ms: Callable[[Cell], float], growth_per_s: Callable[[float], float]) -> Answered:
    """Return a sweep whose cells are stable up to a delay that is known; beyond it they grow."""

    def answer(cell: Cell) -> dict[str, Any]:
        over_ms = cell.round_trip_ms - edge_ms(cell)
        return {"verdict": "stable" if over_ms <= 0.0 else "diverged", "growth_per_s": growth_per_s(over_ms)}

    return Answered(answer)


def test_over_seeds_an_edge_has_a_mean_an_interval_and_a_share_of_what_is_stable() -> None:
    # The seeds become unstable at 40, 50 and 60 ms.
    found = stable_up_to(lambda cell: 40.0 + 10.0 * cell.seed, lambda over_ms: over_ms - 0.5)
    spring = {"stiffnesses_n_per_m": (10.0,), "seeds": 3}
    constant, lossy = run_stability(axes(**spring, losses=(0.0, 0.1)), found)
    assert (constant.seeds, constant.stable_shares) == (None, ())
    assert "over_seeds" not in constant.as_dict()
    assert [cell.verdict for cell in lossy.cells] == ["stable", "diverged", "diverged"]
    assert lossy.stable_shares == pytest.approx((1.0, 2.0 / 3.0, 0.0), rel=1e-12)
    assert lossy.seeds is not None
    assert (lossy.seeds.n, lossy.seeds.mean) == (3, pytest.approx(50.5, rel=1e-9))
    assert lossy.seeds.deviation == pytest.approx(10.0, rel=1e-9)
    assert lossy.critical_link_ms == lossy.seeds.mean
    assert lossy.as_dict()["over_seeds"]["stable_shares"]["50"] == pytest.approx(2.0 / 3.0, rel=1e-12)


def test_finished_cells_are_not_computed_again(
    folder: Path, results: list[LineResult], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sweep_module, "run_batch", lambda cells: pytest.fail(f"{len(cells)} cells computed again"))
    again = sweep(folder)
    assert run_stability(axes(), again) == results
    assert again.computed == 0


def test_interrupted_sweep_goes_on_from_its_journal(tmp_path: Path, results: list[LineResult], folder: Path) -> None:
    lines = (folder / "journal.jsonl").read_bytes().splitlines(keepends=True)
    # the last line was being written when the power failed
    (tmp_path / "journal.jsonl").write_bytes(b"".join(lines[:-2]) + lines[-2][:40])
    resumed = sweep(tmp_path)
    assert run_stability(axes(), resumed) == results
    assert resumed.computed == 2
    assert len(Journal(tmp_path / "journal.jsonl").results) == len(lines)


def test_journal_of_something_else_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "journal.jsonl"
    path.write_text('{"key": 1}\n{"key": 2}\n')
    with pytest.raises(ConfigError, match=r"journal\.jsonl:1"):
        Journal(path)


def test_key_of_a_cell_names_all_of_it() -> None:
    cell = Cell(law="wave", environment="spring", round_trip_ms=1.0, stiffness_n_per_m=10.0)
    changes: list[dict[str, Any]] = [
        {"law": "smith"}, {"environment": "tip_sample"}, {"round_trip_ms": 2.0}, {"stiffness_n_per_m": 11.0},
        {"gain": 3.0}, {"jitter_ms": 1.0}, {"loss": 0.1}, {"seed": 1}, {"session_s": 5.0},
        {"settings": (("wave.filter_s", 0.0),)},
    ]  # fmt: skip
    assert len({cell.model_copy(update=change).key for change in ({}, *changes)}) == len(changes) + 1


def test_key_follows_the_sources(monkeypatch: pytest.MonkeyPatch) -> None:
    cell = Cell(law="wave", environment="spring", round_trip_ms=1.0, stiffness_n_per_m=10.0)
    before = cell.key
    monkeypatch.setattr("telenano_lab.studies.loops.cells.sources", lambda: "edited")
    assert cell.key != before


def test_result_survives_the_journal() -> None:
    result = run_cell(Cell(law="virtual_impedance", environment="spring", round_trip_ms=100.0, stiffness_n_per_m=20.0))
    assert CellResult.from_dict(json.loads(json.dumps(result.as_dict()))) == result


def test_neutral_point_between_samples() -> None:
    assert neutral(Edge(21, 22), -0.9, 0.1) == pytest.approx(21.9, rel=1e-12, abs=0.0)
    assert neutral(Edge(44, 45), -0.29, -0.0029) == pytest.approx(45.01, rel=1e-3, abs=0.0)
    assert neutral(Edge(95, 96), 0.03, 0.1) == pytest.approx(94.57, rel=1e-3, abs=0.0)
    assert neutral(Edge(50, 51), None, 0.0) == 50.5
    assert neutral(Edge(50, 51), -1.0, -2.0) == 50.5
    assert neutral(Edge(-1, 0), None, 1.0) == 0.0


def steps_to(edge_ms: float) -> Answered:
    return stable_up_to(lambda _: edge_ms, lambda over_ms: 0.1 * over_ms)


@pytest.mark.parametrize("edge_ms", [0.5, 17.25, 199.0, 43.999])
def test_search_closes_in_on_the_edge(edge_ms: float) -> None:
    lines = axes(stiffnesses_n_per_m=(10.0,), delays_ms=(0.0, 200.0)).lines()
    steps = steps_to(edge_ms)
    rows = [tuple(steps.run([lines[0].cell(ms) for ms in (0.0, 200.0)]))]
    assert find_edges(lines, rows, steps) == pytest.approx([edge_ms], rel=1e-9, abs=0.0)
    assert len(steps.cells) < 2 + 9 + 2


def test_search_looks_below_the_first_delay_and_gives_up_above_the_last() -> None:
    lines = axes(stiffnesses_n_per_m=(10.0,), delays_ms=(50.0, 200.0)).lines()
    for edge_ms, found in ((20.5, 20.5), (300.0, None), (-1.0, 0.0)):
        steps = steps_to(edge_ms)
        rows = [tuple(steps.run([lines[0].cell(ms) for ms in (50.0, 200.0)]))]
        assert find_edges(lines, rows, steps)[0] == (pytest.approx(found, rel=1e-9, abs=0.0) if found else found)


def test_less_gain_bears_more_delay(tmp_path: Path) -> None:
    low, high = run_stability(
        axes(stiffnesses_n_per_m=(20.0,), gains=(10.0, 20.0), delays_ms=(0.0, 120.0)), sweep(tmp_path)
    )
    assert low.critical_delay_ms is not None
    assert high.critical_delay_ms is not None
    # the crossover, and with it the delay, goes about with 1 / (K_f + 1)
    assert low.critical_delay_ms / high.critical_delay_ms == pytest.approx(21.0 / 11.0, rel=0.1)
    assert low.critical_delay_ms == pytest.approx(low.theory_ms, rel=5e-3, abs=0.0)


def test_relative_jitter_grows_with_the_delay() -> None:
    assert Jitter(0.5, relative=True).at_ms(100.0) == 25.0
    assert Jitter(3.0).at_ms(100.0) == 3.0
    line = axes(jitters=(Jitter(0.5, relative=True),), losses=(0.2,)).lines()[0]
    assert line.cell(100.0).jitter_ms == 25.0
    assert line.label == "K = 10 N/m, jitter 50%, loss 20%"
    given = (("readout.enabled", True), ("readout.white_v", 1e-4), ("drift.enabled", True), ("seed", 3))
    assert axes(disturbances=given).lines()[0].label == "K = 10 N/m, with readout, drift"


def test_page_table_and_summary(folder: Path, results: list[LineResult]) -> None:
    out = folder / "page"
    summary = write_stability(results, out, "telenano study stability <&>")
    assert summary == json.loads((out / "stability.json").read_text())
    assert list(summary["critical_delay_ms"]) == ["10", "20", "38"]
    table = pq.read_table(out / "stability.parquet")
    assert table.num_rows == 9
    assert {"cell.round_trip_ms", "verdict", "growth_per_s"} <= set(table.column_names)
    page = (out / "stability.html").read_text()
    assert "&lt;&amp;&gt;" in page
    # nothing is fetched from anywhere
    assert "http" not in page.replace("http-equiv", "")
    assert page.count("data:image/png;base64,") == 4
    assert (out / "stability.png").read_bytes()[:4] == b"\x89PNG"


def test_summary_of_several_laws_is_by_law(results: list[LineResult]) -> None:
    other = axes(laws=("wave",), stiffnesses_n_per_m=(10.0,)).lines()[0]
    summary = summarise([*results, LineResult(other, results[0].cells, None, None, None, None)])
    assert summary["critical_delay_ms"]["wave"] == {"10": None}
    assert summary["critical_delay_ms"]["virtual_impedance"]["10"] == results[0].critical_delay_ms


def test_loop_that_no_delay_makes_neutral_is_said_as_such() -> None:
    # a virtual spring so stiff that the loop's gain stays below 1
    held = axes(settings=(("virtual_impedance.stiffness_n_per_m", 1e6),), stiffnesses_n_per_m=(5.0,))
    result = line_result(held.lines()[0], (), None)
    assert (result.theory_ms, result.theory_link_ms, result.theory_unlimited) == (None, None, True)
    assert json.loads(json.dumps(result.as_dict(), allow_nan=False))["theory_unlimited"] is True
    soft = line_result(axes(stiffnesses_n_per_m=(5.0,)).lines()[0], (), None)
    assert soft.theory_link_ms == pytest.approx(194.124, rel=1e-5, abs=0.0)
    assert not soft.theory_unlimited


def test_page_says_which_assumption_broke(results: list[LineResult]) -> None:
    unstable = results[-1].cells[-1]
    assert unstable.verdict == "diverged"
    assert "not passive with delay" in broken_assumption(unstable.cell, unstable)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"law": "nonsense"}, "unknown law 'nonsense', known are virtual_impedance"),
        ({"law": "wave", "gain": 2.0}, "wave has no force gain; virtual_impedance"),
        ({"settings": (("wave.no_such_key", 1),)}, "no_such_key"),
        ({"session_s": 0.7}, "at least 1.60 s are needed"),
    ],
)
def test_cell_that_cannot_be_run_says_why(tmp_path: Path, changes: dict[str, Any], words: str) -> None:
    cell = Cell(law="virtual_impedance", environment="spring", round_trip_ms=10.0, stiffness_n_per_m=10.0)
    with pytest.raises(ConfigError, match=words):
        sweep(tmp_path).run([cell.model_copy(update=changes)])
    assert not (tmp_path / "journal.jsonl").exists()


@pytest.mark.check("runs a sweep in two processes, takes 15 s")
@pytest.mark.drawn(0.0, "packages/telenano-lab/telenano_lab/studies/")
def test_two_workers_give_what_one_gives(tmp_path: Path, results: list[LineResult]) -> None:
    two = Sweep(Journal(tmp_path / "journal.jsonl"), workers=2)
    cells = [cell.cell for result in results for cell in result.cells]
    assert two.run(cells) == [cell for result in results for cell in result.cells]


def test_a_sweep_warns_once_of_a_sample_that_is_too_stiff_for_so_late_an_instrument(tmp_path: Path) -> None:
    heard: list[str] = []
    warned = Sweep(Journal(tmp_path / "journal.jsonl"), workers=1, warn=heard.append)
    cell = Cell(
        law="virtual_impedance",
        environment="spring",
        round_trip_ms=0.0,
        stiffness_n_per_m=60.0,
        settings=(("clamp.enabled", True),),
        device_latency_ms=4.0,
        session_s=2.0,
    )
    warned.run([cell, cell.model_copy(update={"seed": 1})])
    assert heard == []
    stiff = cell.model_copy(update={"stiffness_n_per_m": 80.0})
    for _ in range(2):
        warned.run([stiff, stiff.model_copy(update={"seed": 1}), stiff.model_copy(update={"device_latency_ms": 0.0})])
    assert len(heard) == 1
    assert "80 N/m is stiffer than the 69.46 N/m" in heard[0]


def test_scheduler_that_is_not_there_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    class Cluster:
        @staticmethod
        def Client(address: str, timeout: str) -> None:
            raise OSError(f"nothing at {address}")

    monkeypatch.setattr(sweep_module, "import_module", lambda name: Cluster)
    cell = Cell(law="virtual_impedance", environment="spring", round_trip_ms=10.0, stiffness_n_per_m=10.0)
    with pytest.raises(ConfigError, match="--scheduler tcp://h:1: no Dask scheduler answers there"):
        Sweep(Journal(tmp_path / "journal.jsonl"), 1, "tcp://h:1").run([cell])


def test_a_cluster_without_a_worker_is_said_to_have_none_and_waited_for(monkeypatch: pytest.MonkeyPatch) -> None:
    distributed = pytest.importorskip("dask.distributed")
    heard: list[str] = []
    monkeypatch.setattr(sweep_module, "_WORKER_S", 0.2)
    with distributed.LocalCluster(n_workers=0, processes=False, dashboard_address=None) as cluster:

        def warn(text: str) -> None:
            heard.append(text)
            # as a person starts one where the study says so
            cluster.scale(1)

        # results of numbers, which no worker has to compile anything for
        kind: Any = SimpleNamespace(run=abs)
        found = list(sweep_module._on_cluster(cluster.scheduler_address, [[-1, 2], [-3]], kind, warn))
        assert sorted(found) == [[1, 2], [3]]
        assert heard == [
            f"--scheduler {cluster.scheduler_address}: it has no worker; the study begins when one is started: "
            f"dask worker {cluster.scheduler_address}"
        ]


@pytest.mark.check("compiles a study's closed loop over the sample")
@pytest.mark.parametrize(("mode", "verdict"), [(MODE_HOLD, "stable"), (MODE_RETRACTING, "guarded")])
def test_pause_in_the_commands_is_no_verdict_but_a_retraction_is(mode: int, verdict: str) -> None:
    cell = Cell(law="virtual_impedance", environment="tip_sample", round_trip_ms=20.0, stiffness_n_per_m=40.0)
    course = trajectory_of(cell)
    modes = course.instrument_mode.copy()
    modes[-3000:-2950] = mode
    result = judged(cell, dataclasses.replace(course, instrument_mode=modes))
    assert result.verdict == verdict
    assert result.guarded is (mode == MODE_RETRACTING)


def test_arm_bears_more_delay_by_theory_and_friction_keeps_a_small_motion_up_below_it() -> None:
    def line(hand: Hand) -> Line:
        axes = Axes(
            laws=("virtual_impedance",),
            environment="spring",
            delays_ms=(0.0, 200.0),
            stiffnesses_n_per_m=(5.0,),
            hand=hand,
        )
        return axes.lines()[0]

    force, ordinary, stiff = (theory_of(line(hand))[0] for hand in ("force", "ordinary", "stiff"))
    assert force == pytest.approx(0.1946, rel=1e-3, abs=0.0)
    assert ordinary == pytest.approx(0.2670, rel=1e-3, abs=0.0)
    assert stiff == math.inf
    # between the two edges the arm holds what the constant force does not
    cells = {hand: line(hand).cell(200.0).model_copy(update={"session_s": 12.0}) for hand in ("force", "ordinary")}
    assert run_cell(cells["force"]).verdict != "stable"
    assert run_cell(cells["ordinary"]).verdict == "stable"


def test_residue_of_a_motion_that_friction_brakes_is_no_growth() -> None:
    cell = Cell(law="virtual_impedance", environment="spring", hand="soft", round_trip_ms=93.0, stiffness_n_per_m=10.0)
    assert run_cell(cell).verdict == "stable"


def test_a_page_says_what_made_it_and_links_the_tables_beside_it(tmp_path: Path) -> None:
    (tmp_path / "cells.parquet").write_bytes(b"")
    page = Page("Title")
    page.code("telenano study stability --seed 3")
    page.table(("verdict",), [("stable",)])
    page.write(tmp_path / "page.html")
    text = (tmp_path / "page.html").read_text()
    assert f"telenano {version('telenano')}, commit " in text
    assert '<a href="cells.parquet">cells.parquet</a>' in text
    assert '<td class="stable">stable</td>' in text
    assert all(f".{kind} {{ background: {colour}66;" in text for kind, colour in VERDICT_COLOURS.items())
