"""Sessions in pools of processes, in threads, and twice in one process: each has the bits that it has alone."""

import inspect
import pickle
import subprocess
import sys
from collections.abc import Callable
from concurrent.futures import Executor, ProcessPoolExecutor, ThreadPoolExecutor
from importlib import import_module
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import telenano
from telenano.console import UnansweredError
from telenano.wire.errors import ConfigError, ReportError

# A link with jitter, so that the seed matters.
ASKED: dict[str, Any] = {
    "duration_s": 0.3,
    "round_trip_ms": 8.0,
    "settings": {"delay_node.forward.jitter": {"scale_s": 0.002}},
}


def bits(session: telenano.Session) -> dict[str, bytes]:
    return {name: np.asarray(session[name]).tobytes() for name in session.units}


@pytest.fixture(scope="module")
def alone() -> dict[int, dict[str, bytes]]:
    return {seed: bits(telenano.simulate("fig12", seed=seed, **ASKED)) for seed in (1, 2)}


def test_the_seed_of_a_session_in_lockstep_decides_its_bits(alone: dict[int, dict[str, bytes]]) -> None:
    session = telenano.simulate("fig12", seed=1, **ASKED)
    assert session.conditions.link_seed == 1
    assert bits(session) == alone[1] != alone[2]


@pytest.mark.parametrize("name", telenano.__all__)
def test_every_public_name_pickles(name: str) -> None:
    assert pickle.loads(pickle.dumps(getattr(telenano, name))) is getattr(telenano, name)


@pytest.mark.parametrize(
    "pool",
    [
        pytest.param(lambda: ProcessPoolExecutor(2, get_context("spawn")), id="processes"),
        pytest.param(lambda: ThreadPoolExecutor(2), id="threads"),
    ],
)
@pytest.mark.check("starts processes")
def test_a_pool_gives_the_bits_of_a_session_alone(
    pool: Callable[[], Executor], alone: dict[int, dict[str, bytes]], tmp_path: Path
) -> None:
    with pool() as workers:
        futures = {seed: workers.submit(telenano.simulate, "fig12", seed=seed, **ASKED) for seed in (1, 2)}
        recorded = [
            workers.submit(telenano.simulate, "fig12", seed=3, recording=tmp_path / name, report=False, **ASKED)
            for name in ("a", "b")
        ]
        wrong = workers.submit(telenano.simulate, "fig12", law="waves")
        assert {seed: bits(future.result()) for seed, future in futures.items()} == alone
        first, second = (future.result() for future in recorded)
        with pytest.raises(ConfigError, match=r"fig12: controller\.law: .* did you mean wave\?"):
            wrong.result()
    assert first.verdict == second.verdict
    assert bits(first) == bits(second)


@pytest.mark.check("starts processes")
def test_joblib_gives_the_bits_of_a_session_alone(alone: dict[int, dict[str, bytes]]) -> None:
    joblib = pytest.importorskip("joblib", reason="joblib is not installed")
    calls = (joblib.delayed(telenano.simulate)("fig12", seed=seed, **ASKED) for seed in (1, 2))
    assert list(map(bits, joblib.Parallel(n_jobs=2)(calls))) == list(alone.values())


@pytest.mark.check("starts processes")
def test_dask_gives_the_bits_of_a_session_alone(alone: dict[int, dict[str, bytes]]) -> None:
    dask = pytest.importorskip("dask", reason="dask is not installed")
    pytest.importorskip("cloudpickle", reason="dask cannot start processes without cloudpickle")
    import_module("dask.multiprocessing")
    calls = [dask.delayed(telenano.simulate)("fig12", seed=seed, **ASKED) for seed in (1, 2)]
    assert list(map(bits, dask.compute(*calls, scheduler="processes", num_workers=2))) == list(alone.values())


# A script as people write them, without a guard of its main part.
SCRIPT = """
import telenano

frame = telenano.simulate_all(law=["wave", "waves"], seed=[1, 2], duration_s=0.3, jobs=2)
print(frame[["law", "seed", "session_verdict", "hold"]].to_csv(index=False))
"""


@pytest.mark.check("starts processes")
def test_a_script_has_one_table_of_many_sessions_in_their_order(tmp_path: Path) -> None:
    (tmp_path / "script.py").write_text(SCRIPT)
    done = subprocess.run(
        [sys.executable, "script.py"], cwd=tmp_path, capture_output=True, text=True, timeout=240, check=False
    )
    assert done.stdout.split() == ["law,seed,session_verdict,hold", *(
        f"{law},{seed},{verdict}," for law, verdict in (("wave", "cannot_say"), ("waves", "")) for seed in (1, 2)
    )], done.stderr  # fmt: skip


@pytest.mark.check("starts processes")
def test_a_table_has_a_column_for_each_setting_that_varies_and_the_holds_of_each_session() -> None:
    settings = [{"controller.virtual_impedance.force_gain": gain} for gain in (5.0, 10.0)]
    frame = telenano.simulate_all(settings=settings, duration_s=3.0, progress=False)
    assert sorted(set(frame["controller.virtual_impedance.force_gain"])) == [5.0, 10.0]
    alone = telenano.simulate(settings=settings[1], duration_s=3.0)
    rows = frame[frame["controller.virtual_impedance.force_gain"] == 10.0]
    assert rows["reason"].tolist() == [hold.reason for hold in alone.holds]
    assert len(rows)


def test_what_no_session_can_be_simulated_with_is_the_error_of_the_first() -> None:
    with pytest.raises(ConfigError, match="law: is an empty list"):
        telenano.simulate_all(law=[])
    with pytest.raises(TypeError, match="did you mean law"):
        telenano.simulate_all(laws=["wave"])


@pytest.mark.check("starts processes")
def test_the_error_of_the_first_is_raised_where_none_can_be_simulated() -> None:
    with pytest.raises(ConfigError, match=r"got 'waves'; did you mean wave\?"):
        telenano.simulate_all(law=["waves", "wafe"], jobs=2)


def test_a_recording_is_opened_again_where_it_arrives(
    recording_of: Callable[[str], Path], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    path = recording_of("wave").resolve()
    monkeypatch.chdir(path.parent)
    session = telenano.open(path.name)
    verdict, sent = session.verdict, pickle.dumps(session)
    monkeypatch.chdir(tmp_path)
    arrived = pickle.loads(sent)
    assert arrived.is_judged
    assert (arrived.verdict, bits(arrived)) == (verdict, bits(session))


@pytest.mark.parametrize(
    "error", [ConfigError("a", "b"), ReportError("no room", {"verdict": "stable"}), UnansweredError("nobody", {})]
)
def test_an_error_arrives_from_a_pool_as_it_was_raised(error: Exception) -> None:
    arrived = pickle.loads(pickle.dumps(error))
    assert (type(arrived), str(arrived), vars(arrived)) == (type(error), str(error), vars(error))


def test_a_connection_to_a_rig_says_why_it_cannot_be_sent() -> None:
    with pytest.raises(TypeError, match=r"call telenano\.live\(\) in the other one"):
        pickle.dumps(telenano.LiveRig(None))


def test_the_name_of_simulate_leads_to_it() -> None:
    assert getattr(inspect.getmodule(telenano.simulate), telenano.simulate.__qualname__) is telenano.simulate
