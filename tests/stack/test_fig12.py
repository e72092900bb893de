"""The experiment of Fig. 12 on real processes, judged from its own recording.

Its variants over a delay are in `tests/replay/test_virtual_fig12.py`.
"""

import json
import multiprocessing
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import Any

import pytest
from empty_loop import EmptyLoops
from mcap.reader import make_reader
from PIL import Image
from stack_rig import Rig, assert_drawn_as_in_the_paper, judged, pulled_as_in_the_paper

from telenano.recording.reader import Recording
from telenano.rerun.rerun import RerunResult, rerun
from telenano.wire.topics import OWN_TOPICS as TOPICS

# The rig of `make test` has this session as well: tests/stack/test_running_rig.py judges it.
pytestmark = pytest.mark.drawn(0.0, "services/", "telenano/runtime/", "telenano/rerun/")
LOSSLESS = [name for name, topic in TOPICS.items() if topic.delivery == "lossless"]
FAST = [name for name, topic in TOPICS.items() if topic.rate_hz == 1000.0]
NODES = ("controller@master", "controller@slave", "afm_node@slave", "haptic_node@master", "delay_node@master")


@pytest.fixture(scope="module")
def session(tmp_path_factory: pytest.TempPathFactory) -> Any:
    rig = Rig(tmp_path_factory.mktemp("fig12"))
    try:
        with EmptyLoops() as loops:
            summary = rig.run_undisturbed()
    finally:
        rig.close()
    return rig, summary, loops


def test_hold_contact_and_release_are_the_papers(session: Any) -> None:
    rig, summary, _ = session
    if judged(summary, "Fig. 12"):
        assert summary["stable"] is True
        assert summary["hold_ratio"] == pytest.approx(1.050, abs=0.005)
        assert summary["contact_x_cm"] == pytest.approx(0.703, abs=0.010)
        assert abs(summary["release_force_nn"]) < 0.02
    assert summary["greatest_pull_nn"] == pulled_as_in_the_paper(rig.out / "session.mcap")
    assert summary["duration_s"] == pytest.approx(8.0, abs=0.5)


def test_nothing_that_must_not_be_lost_is(session: Any) -> None:
    _, summary, _ = session
    gaps = {name: count for name, count in summary["seq_gaps"].items() if name.partition("@")[0] in LOSSLESS}
    assert gaps
    assert set(gaps.values()) == {0}


def test_every_fast_topic_is_in_the_file(session: Any) -> None:
    rig, summary, loops = session
    if not judged(summary, "the rates of Fig. 12"):
        return
    given = loops.share(*Recording(rig.out / "session.mcap").span_ns)
    # both sides of the link
    names = (*FAST, "teleop/forward@slave", "teleop/backward@master")
    shares = {name: summary["completeness"][name] for name in names}
    assert min(shares.values()) >= 0.995 * given, (shares, given)


def test_age_of_the_loop_is_of_the_same_tick(session: Any) -> None:
    _, summary, _ = session
    age = summary["loop_age_ms"]
    assert 0.0 < age["p50"] <= age["p99"] <= age["max"]


def test_files_are_there_and_say_the_same(session: Any) -> None:
    rig, summary, _ = session
    assert json.loads((rig.out / "summary.json").read_text()) == summary
    with Image.open(rig.out / "fig12.png") as drawn:
        drawn.verify()
    again = rig.folder / "again"
    done = rig.telenano("report", str(rig.out / "session.mcap"), "--out", str(again), "--json")
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout) == summary


def test_the_figure_shows_the_session_and_the_path_under_the_hand(session: Any) -> None:
    rig, summary, _ = session
    if judged(summary, "the figure of Fig. 12"):
        assert_drawn_as_in_the_paper(rig.out / "session.mcap", 8.0)


def test_foreign_reader_opens_the_recording(session: Any) -> None:
    rig, _, _ = session
    with (rig.out / "session.mcap").open("rb") as file:
        reader = make_reader(file)
        found = reader.get_summary()
        assert found is not None
        channels = found.channels.values()
        names = {attachment.name for attachment in reader.iter_attachments()}
    assert {"msgpack"} <= {channel.message_encoding for channel in channels} <= {"msgpack", "json"}
    assert {channel.topic for channel in channels} >= {*FAST, "teleop/forward@slave"}
    assert {"site.yaml", "scenario.yaml"} <= names


def test_every_message_decodes(session: Any) -> None:
    rig, _, _ = session
    kinds = {type(message.decode()).__name__ for message in Recording(rig.out / "session.mcap").messages()}
    assert {"HapticState", "AfmState", "TeleopForward", "SessionEvent", "NodeHealth", "LinkStatus"} <= kinds


@pytest.fixture(scope="module")
def reruns(session: Any) -> dict[str, RerunResult]:
    recording = session[0].out / "session.mcap"
    # one to a processor: no rig runs now
    with ProcessPoolExecutor(2, multiprocessing.get_context("spawn")) as pool:
        results = pool.map(rerun_of, [recording] * len(NODES), NODES)
        return dict(zip(NODES, results, strict=True))


def rerun_of(path: Path, node: str) -> RerunResult:
    return rerun(Recording(path), node)


@pytest.mark.parametrize("node", NODES)
def test_each_node_is_rerun_bit_by_bit_on_the_machine_that_recorded_it(reruns: Any, node: str) -> None:
    result = reruns[node]
    assert result.difference == ""
    assert result.identical, result.verdict()
    assert max(result.compared.values()) > 1000
