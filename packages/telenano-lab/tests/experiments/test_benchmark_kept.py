"""The kept runs of the benchmark: read back as they were made, refused where they are not those of their digest."""

import csv
import io
import json
import lzma
from pathlib import Path

import pytest
from benchmark_folders import COMPUTED_BY
from telenano_lab.experiments.benchmark import kept as kept_module
from telenano_lab.experiments.benchmark.cell import compared, named_runs
from telenano_lab.experiments.benchmark.kept import Kept, differences, kept, main, read_outcomes, write
from telenano_lab.experiments.benchmark.plan import VERSION, Run, plan_of
from telenano_lab.experiments.benchmark.results import digest_of, runs_text
from telenano_lab.experiments.benchmark.run import MEASURES, Outcome, run
from telenano_lab.studies.option_values import COMPARED_LAWS

from telenano.testing import invoke
from telenano.wire import ConfigError

OPTIONS = {"law": "--law", "network": "--network", "seed": "--seed"}


def outcome(verdict: str = "stable", error: float | None = 0.123456789, **changes: object) -> Outcome:
    given = {"task": "track", "network": "wifi", "law": "wave", "hand": "force", "seed": 0, **changes}
    return Outcome(Run.model_validate(given), verdict, "", {**dict.fromkeys(MEASURES), "tracking_error": error})


MADE = [
    outcome(),
    outcome("diverged", None, seed=1, settings=(("wave.filter_s", 0.1), ("clamp.enabled", True))),
    outcome("struck", -1e-12, instrument="real", steadiness="trembling", task="stiff", hand="reacting", law="smith"),
]
TEXT = runs_text(MADE)


def test_runs_that_are_read_are_those_that_were_written(tmp_path: Path) -> None:
    table, digest = tmp_path / "runs.csv.xz", tmp_path / "runs.sha256"
    write(TEXT, table, digest)
    found = kept(table, digest)
    assert found.digest == digest_of(TEXT)
    assert runs_text(list(found.outcomes.values())) == TEXT
    assert {one.cell: one for one in MADE} == found.outcomes
    first = table.read_bytes()
    write(TEXT, table, digest)
    assert table.read_bytes() == first


@pytest.mark.parametrize("damage", ["another run", "cut off", "no digest", "no table"])
def test_a_table_that_is_not_that_of_its_digest_is_refused(damage: str, tmp_path: Path) -> None:
    table, digest = tmp_path / "runs.csv.xz", tmp_path / "runs.sha256"
    write(TEXT, table, digest)
    if damage == "another run":
        table.write_bytes(lzma.compress(TEXT.replace("diverged", "stable").encode()))
    elif damage == "cut off":
        table.write_bytes(table.read_bytes()[:-20])
    else:
        (digest if damage == "no digest" else table).unlink()
    with pytest.raises(ConfigError, match=r"runs\.csv\.xz: .*install the package again"):
        kept(table, digest)


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("a,b\n1,2\n", "the first line names other columns"),
        (TEXT.replace(f"\n{VERSION},", "\n1,", 1), "line 2: a run of benchmark 1"),
        (TEXT.replace("0.123456789", "much"), "line 2: could not convert"),
    ],
)
def test_what_are_no_runs_is_refused_with_its_line(text: str, reason: str, tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=reason):
        read_outcomes(text)
    (tmp_path / "runs.csv").write_text(text)
    with pytest.raises(SystemExit, match=reason):
        main([str(tmp_path / "runs.csv")])


def test_a_difference_in_the_last_digit_is_one() -> None:
    before = outcome()
    assert differences(before, outcome()) == []
    assert differences(before, outcome(error=0.12345679)) == [("tracking_error", 0.123456789, 0.12345679)]
    both = differences(before, outcome("diverged", None))
    assert [one.what for one in both] == ["verdict", "tracking_error"]
    summary, rows = compared([before, before], [before, outcome("diverged", None)], "f" * 64)
    assert (summary["runs"], summary["different"], summary["held_kept"], summary["held_now"]) == (2, 1, 2, 1)
    assert [row[-1] for row in rows] == ["nothing", "verdict, tracking_error"]
    assert json.loads(json.dumps(summary, allow_nan=False)) == summary


def test_a_cell_is_named_by_its_columns_and_what_is_not_kept_is_refused() -> None:
    table = Kept({one.cell: one for one in MADE}, "0" * 64)
    assert named_runs(table, {"law": ["wave"], "network": []}, OPTIONS, None, 0) == MADE[:2]
    assert len(named_runs(table, {}, OPTIONS, 2, 5)) == 2
    assert named_runs(table, {}, OPTIONS, 2, 5) == named_runs(table, {}, OPTIONS, 2, 5)
    with pytest.raises(ConfigError, match="name a cell by --law, --network, --seed, or draw runs by --draw N"):
        named_runs(table, {"law": []}, OPTIONS, None, 0)
    with pytest.raises(ConfigError, match="--law wavy: no kept run of the benchmark has it; did you mean"):
        named_runs(table, {"law": ["wavy"]}, OPTIONS, None, 0)
    with pytest.raises(ConfigError, match="--seed 7: no kept run"):
        named_runs(table, {"seed": [7]}, OPTIONS, None, 0)
    with pytest.raises(ConfigError, match="no kept run of the benchmark matches all options"):
        named_runs(table, {"law": ["smith"], "seed": [1]}, OPTIONS, None, 0)


def test_the_runs_of_the_package_are_runs_of_the_benchmark_with_every_law_in_every_place() -> None:
    found = kept()
    planned = set(plan_of(COMPARED_LAWS, quick=False).runs())
    assert set(found.outcomes) <= planned
    places: dict[tuple[object, ...], set[str]] = {}
    for one in found.outcomes:
        key = (one.instrument, one.steadiness, one.network, one.task, one.hand, one.seed)
        places.setdefault(key, set()).add(one.law)
    assert all(laws == set(COMPARED_LAWS) for laws in places.values())
    assert len(csv.DictReader(io.StringIO(TEXT)).fieldnames or ()) == 10 + len(MEASURES)


@pytest.mark.check("makes some kept runs again, takes 40 s")
@pytest.mark.drawn(0.0, *COMPUTED_BY)
def test_drawn_runs_of_the_package_come_out_as_they_are_kept() -> None:
    """A draw of its own of every review: another --draw-seed has other runs."""
    done = invoke(["benchmark", "cell", "--draw", "12", "--draw-seed", "3", "--workers", "1", "--json"])
    found = json.loads(done.stdout)
    assert (done.exit_code, found["runs"], found["different"]) == (0, 12, 0), found["rows"]


def test_the_command_ends_with_1_where_a_run_differs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    right = run(Run(task="touch", network="clean", law="wave", hand="force", seed=0))
    wrong = right._replace(measures={**right.measures, "peak_force_n": 9.0})
    command = ["benchmark", "cell", "--network", "clean", "--law", "wave", "--workers", "1"]
    for made, code in ((right, 0), (wrong, 1)):
        monkeypatch.setattr(kept_module, "kept", lambda made=made: Kept({made.cell: made}, "0" * 64))
        done = invoke(command)
        assert done.exit_code == code, done.output
        assert ("peak_force_n" in done.stdout) == bool(code)
    refused = invoke([*command, "--quick"])
    assert refused.exit_code not in (0, 1) or "--quick" in refused.output
    unused = invoke(["benchmark", "--task", "touch", "--out", str(tmp_path / "out")])
    assert "--task: not without cell, without which the whole set is run" in unused.output
