"""Sessions in virtual time that the launcher conducts: their messages, their files, and what reads them."""

import hashlib
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.reader import make_reader

import telenano
from telenano.launcher.plan import Plan
from telenano.launcher.run import Outcome
from telenano.recording.disk import MemoryDisk
from telenano.recording.reader import Recording
from telenano.rerun.rerun import rerun
from telenano.runtime.loop.machine import OwnMachine
from telenano.virtual import machine as virtual_machine
from telenano.virtual.request import SimulateRequest, plan_of, run_plan, timed_command
from telenano.virtual.session import SimulatedRig
from telenano.wire.errors import ConfigError
from telenano.wire.nodes import RERUN_NODES, STOP_ORDER

# A fast session: a press of the tip at a quarter of the usual rate.
SETTINGS = ("realtime.rate_hz=250",)
DURATION_S = 1.2


def plan(folder: Path, **asked: Any) -> tuple[Plan, SimulateRequest]:
    given = {"scenario": "fig12", "duration_s": DURATION_S, "settings": SETTINGS, "out": folder} | asked
    request = SimulateRequest.model_validate(given)
    return plan_of(request, folder), request


def session(folder: Path, **asked: Any) -> tuple[Outcome, list[str]]:
    shown: list[str] = []
    planned, request = plan(folder, **asked)
    return run_plan(planned, request, show=shown.append), shown


def digest(path: Path) -> str:
    """Return a digest of every message of a recording: its channel, bytes, and both of its times."""
    bits = hashlib.sha256()
    for message in Recording(path).messages():
        bits.update(f"{message.channel_topic} {message.src} {message.log_ns} {message.publish_ns}".encode())
        bits.update(message.payload)
    return bits.hexdigest()


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A session over a link with jitter and loss, seed 3."""
    folder = tmp_path_factory.mktemp("virtual") / "session"
    link = '{"delay_s": 0.01, "jitter": {"scale_s": 0.002}, "loss": {"probability": 0.02}}'
    outcome, _ = session(folder, seed=3, settings=(*SETTINGS, f"delay_node.forward={link}"))
    assert (outcome.failure, outcome.missing, outcome.ran) == ("", (), True)
    (path,) = outcome.recordings
    return path


@pytest.mark.check("takes 1.7 s")
def test_a_seed_gives_the_same_messages_at_the_same_times_and_another_seed_others(tmp_path: Path) -> None:
    found = [digest(session(tmp_path / str(n), seed=seed)[0].recordings[0]) for n, seed in enumerate((5, 5, 6))]
    assert found[0] == found[1] != found[2]


def test_the_file_says_that_it_is_a_simulation_in_virtual_time(recorded: Path) -> None:
    facts = Recording(recorded).metadata["simulation"]
    assert (facts["time"], facts["seed"]) == ("virtual", "3")
    assert json.loads(facts["delays_ns"])["site"] == [10_000, 200_000]


def test_a_reader_of_another_project_reads_every_message_in_the_order_of_reception(recorded: Path) -> None:
    with recorded.open("rb") as stream:
        reader = make_reader(stream)
        messages = list(reader.iter_messages())
        names = {record.name for record in reader.iter_metadata()}
    assert len(messages) == Recording(recorded).info().messages
    times = np.array([message.log_time for _, _, message in messages])
    assert (np.diff(times) >= 0).all()
    assert {"simulation", "recording", "end"} <= names


def test_every_node_is_run_again_from_its_journal_to_the_same_bits(recorded: Path) -> None:
    results = {node: rerun(Recording(recorded), node) for node in RERUN_NODES}
    assert {node: result.verdict() for node, result in results.items() if not result.identical} == {}


def test_the_recorder_has_all_that_was_sent_to_it(recorded: Path) -> None:
    info = Recording(recorded).info()
    assert (info.complete, info.missing) == (True, ())
    ended = {
        found.src for found in Recording(recorded).messages(["session/event"]) if "has ended" in found.fields()["text"]
    }
    assert ended >= set(RERUN_NODES)


def test_each_site_records_what_it_sends(tmp_path: Path) -> None:
    outcome, _ = session(tmp_path, both_sites=True)
    (both,) = outcome.recordings
    near, far, whole = (Recording(path) for path in (tmp_path / "session.mcap", tmp_path / "far/session.mcap", both))
    names = [{channel.channel_topic for channel in each.channels} for each in (near, far, whole)]
    assert "afm/state" not in names[0]
    assert {"afm/state", "teleop/backward"} <= names[1]
    assert names[2] == names[0] | names[1]
    assert whole.info().complete


def test_a_command_at_a_console_is_carried_out_in_its_time(tmp_path: Path) -> None:
    at = ("0.5 set controller law=wave", "0.8 mark recorder@master note=here")
    outcome, shown = session(tmp_path, at=at)
    assert shown == []
    recording = telenano.open(outcome.recordings[0])
    laws = recording.table("law/status", "controller@master")
    changed_s = laws["time_s"][np.array(laws["law"]) == "wave"][0]
    assert 0.5 < changed_s < 0.6
    marks = [found.fields() for found in Recording(outcome.recordings[0]).messages(["session/event"])]
    assert [event["data"] for event in marks if event["kind"] == "mark"] == [{"note": "here"}]


def test_a_command_that_no_node_knows_is_reported_and_ends_nothing(tmp_path: Path) -> None:
    outcome, shown = session(tmp_path, at=("0.2 set afm_node@slave nothing=1",))
    assert outcome.failure == ""
    assert len(shown) == 1
    assert "nothing" in shown[0]


def test_a_command_whose_time_does_not_come_is_reported(tmp_path: Path) -> None:
    outcome, shown = session(tmp_path, at=("60 set controller law=wave", "0.2 mark recorder@master note=here"))
    assert outcome.failure == ""
    assert len(shown) == 1
    assert "set controller: the session ended before 60 s" in shown[0]


@pytest.mark.parametrize(
    ("text", "names"),
    [
        ("set controller", "TIME COMMAND TARGET"),
        ("soon set controller law=wave", "TIME COMMAND TARGET"),
        ("1 sett controller law=wave", "set"),
        ("-1 set controller law=wave", "0 to 86400"),
        ("nan set controller law=wave", "0 to 86400"),
        ("1 set controller law", "KEY=VALUE"),
        ("1 set controller law=[1]", "KEY=VALUE"),
        ("1 set controller 'law=wave", "TIME COMMAND TARGET"),
    ],
)
def test_a_text_that_is_no_command_is_refused(text: str, names: str) -> None:
    with pytest.raises(ConfigError, match="--at") as refused:
        timed_command(text)
    assert names in str(refused.value)


@pytest.mark.parametrize(
    ("setting", "key"),
    [
        ("afm_node={driver: modbus, modbus: {host: 192.0.2.1, calibration: stage.yaml}}", "afm_node.driver"),
        ("haptic_node={driver: serial, serial: {port: /dev/ttyS0, calibration: hand.yaml}}", "haptic_node.driver"),
    ],
)
def test_a_real_device_is_refused(tmp_path: Path, setting: str, key: str) -> None:
    with pytest.raises(ConfigError, match=key):
        session(tmp_path, settings=(*SETTINGS, setting))


@pytest.mark.check("takes 3 s")
def test_where_the_operator_is_a_person_nothing_pushes_the_hand_and_it_is_said(tmp_path: Path) -> None:
    scan = "0.2 set afm_node@slave program=scan scan.pixels=8"
    outcome, (said,) = session(tmp_path, scenario="image", duration_s=0.8, settings=(), at=(scan,))
    assert "nothing pushes the hand" in said
    recording = telenano.open(outcome.recordings[0])
    assert np.abs(recording.table("haptic/state")["operator_force_n.2"]).max() == 0.0
    # The instrument runs its program all the same.
    assert set(recording.table("afm/program")["program"]) == {"scan"}


def test_a_node_whose_turn_fails_is_started_again(tmp_path: Path) -> None:
    planned, _ = plan(tmp_path)
    rig = SimulatedRig(planned, 1)
    failed: list[int] = []

    def observe(launcher: Any) -> None:
        if not failed and launcher.phase == "running":
            failed.append(1)
            node = rig.loops["controller@slave"].node
            node.on_message = fail  # type: ignore[method-assign]

    def fail(received: Any) -> None:
        raise ValueError("a fault of this test")

    outcome = rig.run(observe)
    assert outcome.failure == ""
    assert outcome.restarts["controller@slave"] == 1
    texts = [found.fields()["text"] for found in Recording(outcome.recordings[0]).messages(["session/event"])]
    assert any("a fault of this test" in text for text in texts)
    first_ns, last_ns = Recording(outcome.recordings[0]).span_ns
    answers = [found.log_ns for found in Recording(outcome.recordings[0]).messages(["teleop/backward"])]
    # The second life of the node is recorded like its first one.
    assert max(answers) > last_ns - 0.2 * (last_ns - first_ns)


def test_a_node_that_cannot_start_is_the_failure_of_the_session(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    planned, _ = plan(tmp_path)
    rig, start = SimulatedRig(planned, 1), SimulatedRig.start

    def refuse(rig: SimulatedRig, key: str, *arguments: Any, **options: Any) -> Any:
        if key == "afm_node@slave":
            raise ConfigError("the surface of this test is missing")
        return start(rig, key, *arguments, **options)

    monkeypatch.setattr(SimulatedRig, "start", refuse)
    outcome = rig.run()
    assert (outcome.bad_start, outcome.ran) == (True, False)
    assert "the surface of this test is missing" in outcome.failure


def test_the_recorder_splits_its_files_on_a_disk_in_memory(tmp_path: Path) -> None:
    planned, request = plan(
        tmp_path,
        duration_s=2.0,
        settings=(*SETTINGS, "recorder.split_interval_s=1.0"),
        at=("0.3 mark recorder@master n=1",),
    )
    disk = MemoryDisk()
    SimulatedRig(planned, 1, disk=disk, commands=request.commands()).run()
    assert not list(tmp_path.glob("*.mcap"))
    assert [path.name for path in disk.paths][:3] == ["session.mcap", "session_1.mcap", "session_2.mcap"]
    for number, path in enumerate(disk.paths):
        (tmp_path / f"kept_{number}.mcap").write_bytes(disk.read(path))
    parts = [Recording(path) for path in sorted(tmp_path.glob("kept_*.mcap"))]
    assert all(part.info().complete for part in parts)
    ends = [part.metadata["end"]["state"] for part in parts]
    assert ends == ["split"] * (len(parts) - 1) + ["stopped"]
    kinds = [event.fields()["kind"] for part in parts for event in part.messages(["session/event"])]
    assert kinds.count("mark") == 1


def test_a_full_disk_ends_the_recording_and_not_the_session(tmp_path: Path) -> None:
    planned, _ = plan(tmp_path, settings=(*SETTINGS, "recorder.quota_bytes=100000", "recorder.quota_policy=stop"))
    outcome = SimulatedRig(planned, 1, disk=MemoryDisk()).run()
    assert outcome.ran
    assert any("quota" in text for text in outcome.missing)


@pytest.mark.check("takes 2 s")
def test_a_further_field_that_tells_of_the_machine_moves_no_message(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A machine of another load, memory and process number, with a field more, is not seen in virtual time."""
    before = digest(session(tmp_path / "before", seed=1)[0].recordings[0])
    more = {"pid": 77, "cpu_percent": 50.0, "memory_bytes": 10**9, "device_age_s": 1e-3}
    monkeypatch.setattr(OwnMachine, "health", lambda machine, processor_s, elapsed_s: more)
    monkeypatch.setattr(OwnMachine, "token", lambda machine, size_bytes: "00" * size_bytes)
    assert digest(session(tmp_path / "after", seed=1)[0].recordings[0]) == before
    monkeypatch.setattr(virtual_machine, "HEALTH", {**virtual_machine.HEALTH, "memory_bytes": 2})
    assert digest(session(tmp_path / "other", seed=1)[0].recordings[0]) != before


@pytest.mark.check("records two sessions")
def test_the_api_records_what_the_command_records(tmp_path: Path) -> None:
    found = telenano.simulate(
        "fig12",
        law="wave",
        duration_s=DURATION_S,
        settings={"realtime.rate_hz": 250},
        recording=tmp_path / "api",
        seed=4,
    )
    by_command, _ = session(tmp_path / "command", seed=4, settings=("controller.law=wave", *SETTINGS))
    assert digest(tmp_path / "api" / "session.mcap") == digest(by_command.recordings[0])
    assert found.summary["verdict"] == json.loads((tmp_path / "api" / "summary.json").read_text())["verdict"]
    assert (tmp_path / "api" / "fig12.png").exists()


@pytest.mark.check("records a session")
def test_what_a_lockstep_has_no_model_for_is_run_by_the_nodes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.warns(UserWarning, match=r"fig10: afm_node.begin: tactile .* record sessions/fig10-"):
        found = telenano.simulate("fig10", duration_s=0.3, settings={"realtime.rate_hz": 250}, seed=6, report=False)
    assert isinstance(found, telenano.RecordedSession)
    assert found.conditions.link_seed == 6
    assert [path.name for path in tmp_path.glob("sessions/fig10-*/*.mcap")] == ["session.mcap"]


@pytest.mark.parametrize("seed", [-1, 1.5, "1", 2**31])
def test_a_seed_that_is_none_is_refused(seed: Any) -> None:
    with pytest.raises(ConfigError, match="seed: must be a whole number from 0 to 2147483647"):
        telenano.simulate("fig12", seed=seed)


def test_settings_that_are_no_mapping_are_refused_by_name() -> None:
    with pytest.raises(ConfigError, match="settings is a list: give values by dotted key"):
        telenano.simulate("fig12", settings=["controller.law=wave"])  # type: ignore[call-overload]


def test_nodes_stop_in_the_order_of_the_table(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    stopped: list[str] = []
    end: Callable[[SimulatedRig, str], None] = SimulatedRig.end
    monkeypatch.setattr(SimulatedRig, "end", lambda rig, key: (stopped.append(key), end(rig, key))[1])
    session(tmp_path, duration_s=0.2)
    assert stopped == [node for node in STOP_ORDER if node in stopped]
    assert len(stopped) == 6
