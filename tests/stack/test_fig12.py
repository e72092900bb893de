"""The experiment of Fig. 12 on real processes, judged from its own recording."""

import json
from typing import Any

import pytest
from mcap.reader import make_reader
from stack_rig import Rig

from proto import TOPICS
from services.recorder.reader import Recording

LOSSLESS = [name for name, topic in TOPICS.items() if topic.delivery == "lossless"]
FAST = [name for name, topic in TOPICS.items() if topic.rate_hz == 1000.0]


@pytest.fixture(scope="module")
def session(tmp_path_factory: pytest.TempPathFactory) -> Any:
    rig = Rig(tmp_path_factory.mktemp("fig12"))
    try:
        summary = rig.run()
    finally:
        rig.close()
    return rig, summary


def test_hold_contact_and_release_are_the_papers(session: Any) -> None:
    _, summary = session
    assert summary["stable"] is True
    assert summary["hold_ratio"] == pytest.approx(1.050, abs=0.005)
    assert summary["contact_x_cm"] == pytest.approx(0.703, abs=0.010)
    assert abs(summary["release_force_nn"]) < 0.02
    assert summary["greatest_pull_nn"] == pytest.approx(-12.5, abs=0.1)
    assert summary["duration_s"] == pytest.approx(8.0, abs=0.5)


def test_nothing_that_must_not_be_lost_is(session: Any) -> None:
    _, summary = session
    gaps = {name: count for name, count in summary["seq_gaps"].items() if name.partition("@")[0] in LOSSLESS}
    assert gaps
    assert set(gaps.values()) == {0}


def test_every_fast_topic_is_in_the_file(session: Any) -> None:
    _, summary = session
    shares = {name: summary["completeness"][name] for name in FAST}
    assert min(shares.values()) >= 0.995, shares
    # both sides of the link
    assert summary["completeness"]["teleop/forward@slave"] >= 0.995
    assert summary["completeness"]["teleop/backward@master"] >= 0.995


def test_age_of_the_loop_is_of_the_same_tick(session: Any) -> None:
    _, summary = session
    age = summary["loop_age_ms"]
    assert 0.0 < age["p50"] <= age["p99"] <= age["max"]


def test_files_are_there_and_say_the_same(session: Any) -> None:
    rig, summary = session
    assert json.loads((rig.out / "summary.json").read_text()) == summary
    assert (rig.out / "fig12.png").read_bytes().startswith(b"\x89PNG")
    again = rig.folder / "again"
    done = rig.tell("report", str(rig.out / "session.mcap"), "--out", str(again), "--json")
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout) == summary


def test_foreign_reader_opens_the_recording(session: Any) -> None:
    rig, _ = session
    with (rig.out / "session.mcap").open("rb") as file:
        reader = make_reader(file)
        found = reader.get_summary()
        assert found is not None
        encodings = {channel.message_encoding for channel in found.channels.values()}
        names = {attachment.name for attachment in reader.iter_attachments()}
    assert encodings == {"msgpack", "json"} or encodings == {"msgpack"}
    assert {"site.yaml", "scenario.yaml"} <= names


def test_bag_info_speaks_json(session: Any) -> None:
    rig, _ = session
    done = rig.tell("bag", "info", str(rig.out / "session.mcap"), "--json")
    assert done.returncode == 0, done.stderr
    info = json.loads(done.stdout)
    assert info["complete"] is True
    assert {channel["channel_topic"] for channel in info["channels"]} >= {*FAST, "teleop/forward@slave"}


def test_every_message_decodes(session: Any) -> None:
    rig, _ = session
    kinds = {type(message.decode()).__name__ for message in Recording(rig.out / "session.mcap").messages()}
    assert {"HapticState", "AfmState", "TeleopForward", "SessionEvent", "NodeHealth", "LinkStatus"} <= kinds


def test_without_the_meniscus_the_contact_is_nearer(rig: Any) -> None:
    summary = rig.run("--set", "afm_node.meniscus=false")
    assert summary["contact_x_cm"] == pytest.approx(0.672, abs=0.010)
    assert summary["hold_ratio"] == pytest.approx(1.050, abs=0.005)


def test_forty_milliseconds_round_trip_stay_stable(rig: Any) -> None:
    summary = rig.run("--delay-ms", "20")
    assert summary["stable"] is True, summary["holds"]
    assert summary["loop_age_ms"]["p50"] == pytest.approx(40.0, abs=5.0)


def test_sixty_milliseconds_round_trip_are_a_limit_cycle(rig: Any) -> None:
    summary = rig.run("--delay-ms", "30")
    assert summary["stable"] is False
    swings = [hold["later_n"] for hold in summary["holds"] if hold["hand_force_n"] == pytest.approx(2.0, abs=0.1)]
    assert max(swings) == pytest.approx(7.0, abs=1.0)
