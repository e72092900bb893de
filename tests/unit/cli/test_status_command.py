import json
import threading
from collections.abc import Collection, Iterator
from pathlib import Path
from typing import Any

import msgspec
import pytest
import zmq
from typer.testing import CliRunner

from telenano.cli.commands import status
from telenano.cli.root import app
from telenano.cli.tables import figures
from telenano.launcher.rig_status import (
    NEEDED,
    RigStatus,
    document_of,
    expected_nodes,
    listen,
    node_facts,
    problems_of,
    stalled_inputs,
)
from telenano.launcher.rigs import RigFacts
from telenano.runtime.bus.address_book import AddressBook
from telenano.runtime.bus.bus import ConnectionEvent
from telenano.runtime.bus.publisher import ZmqPublisher
from telenano.runtime.wiring.observer import ObservedMessage, Observer
from telenano.settings import DEFAULT_SITE_FILE
from telenano.testing.commands import run as outcome
from telenano.timing.clock import SystemClock
from telenano.wire import messages
from telenano.wire.codec import fields_of
from telenano.wire.messages import InputHealth, Message, NodeHealth
from telenano.wire.received import Received
from telenano.wire.sequence import Arrival
from telenano.wire.topics import OWN_TOPICS as TOPICS

RIG = [
    "haptic_node@master",
    "controller@master",
    "delay_node@master",
    "controller@slave",
    "afm_node@slave",
    "recorder@master",
]
SECOND_NS = 1_000_000_000
HEADINGS = (
    "state", "up", "rate Hz", "late p99 ms", "overruns", "input age ms", "lost", "refused", "CPU %", "MB", "files",
    "granted",
)  # fmt: skip
DIRECTION = {
    "profile": "wan", "settings": {}, "messages_in": 9, "messages_out": 8, "dropped": {"loss": 3}, "duplicated": 0,
    "reordered": 0, "corrupted": 0, "queue_depth": 2, "delay_valid": True, "delay_mean_s": 0.0205, "delay_min_s": 0.02,
    "delay_max_s": 0.03,
}  # fmt: skip
SILENT = {**DIRECTION, "dropped": {}, "delay_valid": False}
CLOCK = {"valid": True, "offset_s": 1.5e-3, "uncertainty_s": 1e-4, "round_trip_s": 2e-4, "exchanges": 5}
LAW = {
    "law": "virtual_impedance", "switching": False, "port_energy_j": 0.0, "port_power_w": 0.0, "net_valid": True,
    "net_energy_j": 0.0025, "left_j": 0.0, "dissipated_j": 0.0, "passive": True, "saved_percent": 0.0, "heard": True,
    "silence_s": 0.002, "round_trip_valid": False, "round_trip_s": 0.0,
}  # fmt: skip
ZERO = (0.0, 0.0, 0.0)
HAND = {
    "position_m": ZERO, "velocity_m_per_s": ZERO, "operator_force_n": ZERO, "motor_force_n": ZERO, "reference_m": ZERO,
    "mode": "position", "estop": False, "limited": False, "session_s": 3.25, "answered_seq": 0, "answered_t_ns": 0,
    "answered_at_ns": 0, "step_s": 0.001,
}  # fmt: skip
AFM = {
    "hand_seq": 0, "hand_t_ns": 0, "command_seq": 0, "base_position_m": ZERO, "deflection_m": 0.0, "tip_force_n": ZERO,
    "separation_m": 0.0, "separation_valid": False, "in_contact": True, "meniscus": False, "mode": "follow",
    "limited": False, "step_s": 0.001,
}  # fmt: skip
EVENT = {"id": "", "kind": "recording", "level": "info", "text": "recording to x.mcap", "data": {}}


def message(topic: str, src: str, t_s: float = 1.0, seq: int = 0, **fields: Any) -> Message:
    model = TOPICS[topic].model
    header = {"seq": seq, "t_ns": round(t_s * SECOND_NS), "src": src, "v": model.version}
    return msgspec.convert({**header, **fields}, model)


def row(topic: str, src: str = "x@master", received: int = 10, **changes: Any) -> InputHealth:
    fields = {
        "topic": topic, "src": src, "received": received, "lost": 0, "gaps": 0, "repeated": 0, "restarts": 0,
        "age_valid": received > 0, "age_s": 0.001, **changes,
    }  # fmt: skip
    return InputHealth(**fields)


def health(node: str, *inputs: InputHealth, t_s: float = 1.0, **changes: Any) -> NodeHealth:
    fields = {
        "pid": 1, "state": "running", "uptime_s": 3725.0, "rate_hz": 999.9, "period_s": 0.001, "lateness_p50_s": 0.0,
        "lateness_p99_s": 0.00021, "lateness_max_s": 0.0, "overruns": 0, "rejected": {}, "cpu_percent": 25.0,
        "memory_bytes": 176_000_000, "realtime": True, "memory_locked": True, "replay": False, "inputs": inputs,
        **changes,
    }  # fmt: skip
    made = message("node/health", node, t_s, **fields)
    assert isinstance(made, NodeHealth)
    return made


def status_of(*messages: Message) -> RigStatus:
    received = RigStatus()
    for each in messages:
        received.record(each)
    return received


class FakeObserver:
    """Receives what it is given."""

    messages: tuple[Message, ...] = ()

    def __init__(self, book: AddressBook, wanted: Collection[str] = TOPICS) -> None:
        self.book = book
        self.subscribers = dict.fromkeys(book.nodes)
        self.notices = [ConnectionEvent("warning", "slave is not reached", {})]

    def listen(self, duration_s: float) -> Iterator[ObservedMessage]:
        for each in self.messages:
            yield ObservedMessage("", Received("", each, b"", 0, Arrival.NEXT))

    def close(self) -> None:
        """Nothing is open."""


def run(monkeypatch: pytest.MonkeyPatch, *messages: Message, arguments: tuple[str, ...] = ()) -> tuple[int, str, str]:
    monkeypatch.setattr(status, "Observer", FakeObserver)
    monkeypatch.setattr(FakeObserver, "messages", messages)
    return outcome("status", *arguments)


def test_the_nodes_that_report_while_a_rig_runs() -> None:
    nodes = list(AddressBook.load(DEFAULT_SITE_FILE).nodes)
    assert expected_nodes(nodes, nodes) == RIG
    assert "recorder@master" not in expected_nodes([node for node in nodes if node != "recorder@master"], nodes)
    assert expected_nodes([*nodes, "recorder@slave", "launcher@slave"], [*nodes, "recorder@slave"]) == RIG


def test_what_a_machine_cannot_reach_is_not_expected_of_it() -> None:
    nodes = AddressBook.load(DEFAULT_SITE_FILE).nodes
    assert expected_nodes(nodes, ["delay_node@slave", "afm_node@slave"]) == ["afm_node@slave"]
    # the link brings the health of the slave's nodes to the master
    at_master = ["haptic_node@master", "delay_node@master"]
    assert expected_nodes(nodes, at_master) == [*at_master, "controller@slave", "afm_node@slave"]


def test_the_newest_counts_and_a_copy_out_of_the_link_is_no_second_event() -> None:
    old, new = health("afm_node@slave", t_s=1.0, pid=3), health("afm_node@slave", t_s=2.0, pid=4)
    event = message("session/event", "afm_node@slave", **EVENT)
    received = status_of(new, old, event, event)
    assert received.newest(NodeHealth) == {"afm_node@slave": new}
    assert len(received.events) == 1


def test_a_rig_in_which_all_is_well() -> None:
    assert problems_of(status_of(*map(health, RIG)), RIG) == {}


@pytest.mark.parametrize(
    ("newest", "words"),
    [
        (None, "has not reported yet"),
        (health("afm_node@slave", state="starting"), "is still starting"),
        (health("afm_node@slave", state="stopping"), "is stopping"),
        (health("afm_node@slave", row("afm/command", received=0)), "does not receive afm/command"),
    ],
)
def test_what_is_wrong_with_a_node(newest: NodeHealth | None, words: str) -> None:
    received = [health(node) for node in RIG if node != "afm_node@slave"] + ([newest] if newest else [])
    assert problems_of(status_of(*received), RIG) == {"afm_node@slave": words}


@pytest.mark.parametrize("state", ["safe", "ready"])
def test_a_device_that_waits_for_its_operator_is_no_problem(state: str) -> None:
    assert problems_of(status_of(health("afm_node@slave", state=state)), ["afm_node@slave"]) == {}


def test_a_recorder_that_does_not_record_is_a_problem(monkeypatch: pytest.MonkeyPatch) -> None:
    fault = {**EVENT, "level": "error", "text": "recording stopped: the disk is full", "data": {"state": "failed"}}
    nodes = [health(node) for node in RIG if node != "recorder@master"]
    stopped = [*nodes, health("recorder@master", state="safe")]
    event = message("session/event", "recorder@master", **fault)
    assert problems_of(status_of(*stopped, event), RIG) == {"recorder@master": "recording stopped: the disk is full"}
    (text,) = problems_of(status_of(*stopped), RIG).values()
    assert text.startswith("records nothing: `telenano session set record.status=true --target recorder`")
    # one that soon will not, and one that has room again
    low = message("session/event", "recorder@master", seq=1, **{**fault, "data": {"state": "disk_low"}})
    room = message("session/event", "recorder@master", seq=2, **{**EVENT, "data": {"state": "disk_ok"}})
    well = [*nodes, health("recorder@master")]
    assert "recorder@master" in problems_of(status_of(*well, low), RIG)
    assert problems_of(status_of(*well, low, room), RIG) == {}
    code, out, err = run(monkeypatch, *stopped, event)
    assert code == 1
    assert "nodes with a problem: recorder@master" in err
    assert "the disk is full" in out


def test_the_launcher_is_judged_where_it_reports_and_a_console_is_not() -> None:
    visitors = [health("console@master", state="stopping"), health("player@master", state="stopping")]
    received = [*map(health, RIG), *visitors]
    assert problems_of(status_of(*received), RIG) == {}
    received.append(health("launcher@master", state="starting"))
    assert problems_of(status_of(*received), RIG) == {"launcher@master": "is still starting"}


def test_an_input_that_fell_silent_while_listening() -> None:
    node = "controller@master"
    before = health(node, row("teleop/backward"), row("haptic/state"), t_s=1.0)
    after = health(node, row("teleop/backward"), row("haptic/state", received=11), t_s=2.0)
    assert problems_of(status_of(before, after), [node]) == {node: "no longer receives teleop/backward"}


@pytest.mark.parametrize(
    ("before", "after", "span_s", "stalled"),
    [
        ([row("link/status")], [row("link/status")], 0.51, ["link/status"]),
        ([row("link/status")], [row("link/status")], 0.5, []),
        ([row("link/status", received=0)], [row("link/status", received=0)], 1.0, []),
        ([], [row("link/status")], 1.0, []),
        ([row("session/event")], [row("session/event")], 1.0, []),
        ([row("not/known")], [row("not/known")], 1.0, []),
        ([row("node/health")], [row("node/health")], 1.5, []),
        # two sources of a topic: one of them that goes on is enough, as it is at the start
        ([row("law/status", "a@x"), row("law/status", "b@x")],
         [row("law/status", "a@x"), row("law/status", "b@x", received=20)], 1.0, []),
    ],
)  # fmt: skip
def test_silence_is_judged_by_the_deadline_of_the_topic(
    before: list[InputHealth], after: list[InputHealth], span_s: float, stalled: list[str]
) -> None:
    first, newest = health("recorder@master", *before, t_s=1.0), health("recorder@master", *after, t_s=1.0 + span_s)
    assert stalled_inputs(first, newest) == stalled


def test_a_node_that_was_restarted_meanwhile_counts_anew() -> None:
    first = health("afm_node@slave", row("afm/command"), pid=3)
    assert stalled_inputs(first, health("afm_node@slave", row("afm/command"), pid=4, t_s=2.0)) == []


def test_the_facts_of_a_node() -> None:
    inputs = (row("afm/command", age_s=0.002, lost=3), row("node/health", age_s=0.4, lost=1))
    node = health("afm_node@slave", *inputs, rejected={"topic": 2}, overruns=7)
    [facts] = document_of(status_of(node), ["afm_node@slave"])["nodes"]
    assert facts == {
        "node": "afm_node@slave", "heard": True, "problem": None, "pid": 1, "state": "running", "uptime_s": 3725.0,
        "rate_hz": 999.9, "overruns": 7, "cpu_percent": 25.0, "memory_bytes": 176_000_000, "realtime": True,
        "memory_locked": True, "replay": False, "period_s": 0.001, "lateness_p50_s": 0.0, "lateness_p99_s": 0.00021,
        "lateness_max_s": 0.0, "device_latency_s": None, "device_age_s": None, "calibration": None,
        "force_limit_n": None, "travel_m": None, "oldest_input_s": 0.002,
        "received": 20, "lost": 4, "refused": {"topic": 2}, "deaf_s": {},
        "shares_with": [], "open_files": None, "most_open_files": None,
    }  # fmt: skip


def test_every_field_of_a_report_is_a_fact_and_a_heading_makes_a_column_of_it(monkeypatch: pytest.MonkeyPatch) -> None:
    node = health("afm_node@slave", shares_with=("controller@slave",), overruns=7)
    facts = node_facts(node.src, node, None)
    otherwise = {"rejected", "inputs", *Message.__struct_fields__}
    assert facts.keys() >= set(NodeHealth.__struct_fields__) - otherwise
    # another figure of the process needs no other place
    monkeypatch.setitem(messages.PROCESS_FIGURES, "overruns", "misses")
    figures.cache_clear()
    try:
        assert [name for name in figures() if name not in HEADINGS] == ["misses"]
        assert figures()["misses"].cell(facts).plain == "7"
        assert (
            figures()["misses"].cell({**facts, "node": "controller@slave", "shares_with": [node.src]}).plain == "shared"
        )
    finally:
        figures.cache_clear()


@pytest.mark.parametrize(
    ("files", "words"),
    [
        ((799, 1000), None),
        ((800, 1000), "has 800 of at most 1000 files and sockets open: `ulimit -n` raises the limit before a start"),
        ((800, None), None),
        ((None, 1000), None),
    ],
)
def test_a_process_that_has_nearly_as_many_files_open_as_it_may_is_a_problem(
    files: tuple[int | None, int | None], words: str | None
) -> None:
    node = health("afm_node@slave", open_files=files[0], most_open_files=files[1])
    document = document_of(status_of(node), ["afm_node@slave"])
    [facts] = document["nodes"]
    assert (facts["problem"], document["ok"]) == (words, words is None)
    assert figures()["files"].cell(facts).plain == " of ".join(str(number) for number in files if number is not None)


@pytest.mark.parametrize(
    ("rejected", "style"),
    [({}, ""), ({"superseded": 12}, ""), ({"superseded": 12, "stale": 1}, "red"), ({"topic": 2}, "red")],
)
def test_what_was_superseded_alarms_nobody(rejected: dict[str, int], style: str) -> None:
    [facts] = document_of(status_of(health("afm_node@slave", rejected=rejected)), ["afm_node@slave"])["nodes"]
    cell = figures()["refused"].cell(facts)
    assert (cell.style, cell.plain) == (style, ", ".join(f"{name} {count}" for name, count in rejected.items()) or "0")


def test_a_node_that_acts_on_messages_only_has_no_lateness() -> None:
    [facts] = document_of(status_of(health("controller@master", period_s=0.0)), ["controller@master"])["nodes"]
    assert (facts["lateness_p99_s"], facts["oldest_input_s"]) == (None, None)


def test_a_site_of_its_own_is_ok() -> None:
    document = document_of(status_of(health("haptic_node@master")), ["haptic_node@master"])
    assert (document["ok"], document["problems"], document["link"], document["laws"]) == (True, [], None, [])


def well() -> list[Message]:
    return [
        *map(health, RIG[:-1]),
        health("recorder@master", row("afm/state", received=1234), realtime=False, memory_locked=False, period_s=0.0),
        health("launcher@master", memory_locked=False),
        message("link/status", "delay_node@master", forward=DIRECTION, backward=SILENT, clock=CLOCK),
        message("law/status", "controller@slave", **{**LAW, "net_valid": False}),
        message("law/status", "controller@master", **LAW),
        message("haptic/state", "haptic_node@master", **HAND),
        message("afm/state", "afm_node@slave", **AFM),
        message("session/event", "recorder@master", **EVENT),
    ]


def test_a_rig_in_words(monkeypatch: pytest.MonkeyPatch) -> None:
    code, out, err = run(monkeypatch, *well())
    assert (code, err) == (0, "")
    assert not any(line.endswith(" ") for line in out.splitlines())
    for words in (
        "haptic_node@master  running", "1:02:05", "999.9", "0.210", "fifo, memory", "nothing", "launcher@master",
        "wan · delay 20.50 ms · dropped loss 3 · 2 in flight", "wan · no message · dropped 0",
        "the slave's clock is 1.500 ms ahead, ± 0.100 ms",
        "net energy 0.0025 J · last signal received 2 ms ago",
        "position · force profile at 3.2 s", "follow · in contact", "running · 1234 messages received · 0 lost",
        "slave is not reached", "recording to x.mcap", "every node reports and none waits for anything",
    ):  # fmt: skip
        assert words in out, words


@pytest.mark.parametrize(("rate_hz", "is_told"), [(474.0, True), (476.0, False), (0.0, False)])
def test_a_machine_without_room_is_told_with_the_key_that_helps(
    monkeypatch: pytest.MonkeyPatch, rate_hz: float, is_told: bool
) -> None:
    slow = [health(node, rate_hz=rate_hz, period_s=0.002) for node in ("haptic_node@master", "afm_node@slave")]
    code, out, err = run(monkeypatch, *well(), *(msgspec.structs.replace(each, t_ns=2 * 10**9) for each in slow))
    assert (code, err) == (0, "")
    assert not any(line.endswith(" ") for line in out.splitlines())
    told = (
        "machine haptic_node@master 474 of 500 Hz, afm_node@slave 474 of 500 Hz: "
        "the machine is too busy for this rate: end what else runs there, or give a lower realtime.rate_hz"
    )
    assert (told in " ".join(out.split())) is is_told


def test_a_rig_as_json(monkeypatch: pytest.MonkeyPatch) -> None:
    code, out, err = run(monkeypatch, *well(), arguments=("--json",))
    document = json.loads(out)
    assert (code, err, out.count("\n")) == (0, "", 1)
    assert (document["ok"], document["problems"]) == (True, [])
    assert [facts["node"] for facts in document["nodes"]] == [*RIG, "launcher@master"]
    assert document["link"]["forward"] == {
        "profile": "wan", "delay_mean_s": 0.0205, "dropped": {"loss": 3}, "queue_depth": 2,
    }  # fmt: skip
    assert document["link"]["backward"]["delay_mean_s"] is None
    assert document["link"]["clock"] == {"offset_s": 1.5e-3, "uncertainty_s": 1e-4}
    assert [law["src"] for law in document["laws"]] == ["controller@master", "controller@slave"]
    assert document["hand"][0]["mode"] == "position"
    assert document["afm"][0]["in_contact"] is True
    assert document["events"][0]["kind"] == "recording"


def test_a_rig_in_trouble_in_words(monkeypatch: pytest.MonkeyPatch) -> None:
    received = [
        health("haptic_node@master", replay=True, rejected={"version": 4}),
        health("controller@master", row("haptic/state", received=0)),
        message(
            "link/status", "delay_node@master", forward=DIRECTION, backward=DIRECTION, clock={**CLOCK, "valid": False}
        ),
        message(
            "law/status", "controller@master", **{**LAW, "passive": False, "heard": False, "switching": True}
        ),
        message("haptic/state", "haptic_node@master", **{**HAND, "estop": True, "limited": True, "session_s": -1.0}),
        message("afm/state", "afm_node@slave", **{**AFM, "mode": "estop", "limited": True, "meniscus": True}),
    ]  # fmt: skip
    code, out, err = run(monkeypatch, *received)
    assert code == 1
    assert err == (
        "telenano: nodes with a problem: controller@master, delay_node@master, controller@slave, afm_node@slave, "
        "recorder@master\n"
    )
    for words in (
        "replay", "version 4", "no report", "has not reported yet", "does not receive haptic/state", "not passive",
        "waits for the other half to switch", "no signal received yet", "emergency stop is latched",
        "force profile not running · at a limit", "estop · in contact · meniscus · at a limit",
    ):  # fmt: skip
        assert words in out, words
    assert "clocks" not in out


def test_a_rig_in_trouble_as_json(monkeypatch: pytest.MonkeyPatch) -> None:
    code, out, err = run(monkeypatch, *map(health, RIG[1:]), arguments=("--json",))
    document = json.loads(out)
    assert (code, document["ok"], out.count("\n")) == (1, False, 1)
    assert document["problems"] == ["haptic_node@master has not reported yet"]
    assert err == f"telenano: {document['error']}\n"
    assert document["nodes"][0] == {"node": "haptic_node@master", "heard": False, "problem": "has not reported yet"}


def test_a_silent_rig_is_an_error(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TELENANO_RUNTIME_DIR", str(tmp_path / "run"))
    result = CliRunner().invoke(app, ["status", "--duration", "0", "--json"])
    assert result.exit_code == 1
    assert "no node reports" in json.loads(result.stdout)["error"]


def test_it_listens_on_the_bus_and_only_to_what_it_needs(tmp_path: Path) -> None:
    node = "controller@master"
    book = AddressBook(nodes={node: f"ipc://{tmp_path}/node"})
    over = threading.Event()

    def publish() -> None:
        with zmq.Context[zmq.Socket[bytes]]() as context:
            publisher = ZmqPublisher(context, SystemClock(), node, book.endpoint(node))
            template = {k: v for k, v in fields_of(health(node)).items() if k not in ("seq", "t_ns", "src", "v")}
            while not over.wait(0.005):
                publisher.publish("session/event", **EVENT)
                publisher.publish("node/health", **template)
                publisher.publish("haptic/command", hand_seq=0, hand_t_ns=0, mode="off", position_m=ZERO,
                                  velocity_m_per_s=ZERO, force_n=ZERO)  # fmt: skip
            publisher.close()

    thread = threading.Thread(target=publish)
    thread.start()
    observer = Observer(book, NEEDED)
    try:
        received = listen(observer, 0.5)
        topics = {topic for topic, _ in observer.subscribers[node].trackers}
    finally:
        over.set()
        thread.join()
        observer.close()
    assert set(received.newest(NodeHealth)) == {node}
    assert received.events
    # the commands of the law are for the age of the loop, and this node publishes nothing else
    assert topics == {"node/health", "session/event", "haptic/command"}


def test_all_rigs_are_listed_with_what_each_has(monkeypatch: pytest.MonkeyPatch) -> None:
    about = {
        "process": 4711,
        "scenario": "fig12",
        "begun_s": 0.0,
        "out": "/out/1",
        "processors": [2, 3],
        "behind": False,
    }
    behind = {**about, "process": 4712, "processors": [], "behind": True}
    rigs = [RigFacts("main", "master", about), RigFacts("2", "master", behind), RigFacts("lab", "slave", {})]
    monkeypatch.setattr(status, "running_rigs", lambda: rigs)
    monkeypatch.setattr(status, "held", lambda numbers, folder: (2, 3))
    monkeypatch.setattr(status, "permitted", lambda: {0, 1, 2, 3})
    result = CliRunner().invoke(app, ["status", "--all"], env={"COLUMNS": "200"})
    assert result.exit_code == 0
    for words in ("4711", "fig12", "2, 3", "none of its own: other rigs have them", "lab@slave", "/out/1"):
        assert words in result.stdout
    assert "processors: 2 free, enough for 1 more rig" in result.stdout
    document = json.loads(CliRunner().invoke(app, ["status", "--all", "--json"]).stdout)
    assert document["processors"] == {"free": [0, 1], "held": [2, 3]}
    assert document["rigs"] == [
        {"rig": "main", "site": "master", **about},
        {"rig": "2", "site": "master", **behind},
        {"rig": "lab", "site": "slave"},
    ]


def test_no_rig_is_said_to_be_none(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(status, "running_rigs", list)
    assert "no rig of this user was found" in CliRunner().invoke(app, ["status", "--all"]).stdout


@pytest.mark.parametrize(("behind", "words"), [(False, "2, 3"), (True, "none of its own: other rigs have them")])
def test_a_rig_is_shown_with_its_processors_and_what_its_hand_feels(
    monkeypatch: pytest.MonkeyPatch, behind: bool, words: str
) -> None:
    about: dict[str, Any] = {"processors": [] if behind else [2, 3], "behind": behind}
    monkeypatch.setattr(status, "about_rig", lambda name: about)
    _, out, _ = run(monkeypatch, *map(health, RIG))
    [line] = [line for line in out.splitlines() if line.startswith("processors ")]
    assert words in line
    assert "the hand feels" not in out
    about["felt"] = "0.33 (0.31 to 0.35) times the stiffness that is there, 990 of 3000 N/m at the hand"
    _, out, _ = run(monkeypatch, *map(health, RIG))
    [line] = [line for line in out.splitlines() if line.startswith("the hand feels ")]
    assert "0.33 (0.31 to 0.35)" in line
    _, out, _ = run(monkeypatch, *map(health, RIG), arguments=("--json",))
    assert json.loads(out)["rig"] == about
