"""Emergency stops on real sockets, with devices that answer in threads of their own."""

import itertools
import json
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, closing
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import msgspec
import pytest
import zmq

from services.player.node import ReplayPublisher
from telenano.cli import estop_command
from telenano.cli.estop_command import EstopRequest, read_arguments, run_estop
from telenano.console import emergency_stop
from telenano.console import send_commands as command_client
from telenano.console.answers import Answer
from telenano.console.emergency_stop import LocalRig, Reach, _answer, _Inlet, _Sender
from telenano.runtime.bus.address_book import AddressBook
from telenano.runtime.bus.publisher import ZmqPublisher
from telenano.runtime.loop.commands import CommandHandler
from telenano.runtime.wiring.transport import EstopInlet
from telenano.settings import DEFAULT_SITE_FILE, TWO_SITES_FILE
from telenano.testing.filled_messages import examples
from telenano.timing.clock import SystemClock
from telenano.wire import decode, encode
from telenano.wire.codec import fields_of
from telenano.wire.errors import EndpointError
from telenano.wire.messages import SessionControl
from telenano.wire.nodes import DEVICES
from telenano.wire.topics import TOPICS

HAND, TIP, LINK, RECORDER = "haptic_node@master", "afm_node@slave", "delay_node@master", "recorder@master"


class Device(threading.Thread):
    """A process that takes emergency stops; `takes` are the nodes in whose name it answers, itself by default."""

    def __init__(self, folder: Path, node: str, *takes: str) -> None:
        super().__init__(daemon=True)
        self.node = node
        self.endpoint = f"ipc://{folder}/{node}"
        self.taken: list[SessionControl] = []
        self.ready = threading.Event()
        self.ended = threading.Event()
        self.takes = takes or (node,)

    def run(self) -> None:
        clock = SystemClock()
        with zmq.Context() as context, closing(ZmqPublisher(context, clock, self.node, self.endpoint)) as publisher:
            handlers = [
                CommandHandler(node, ("estop",), self.execute, self.answers(publisher, node)) for node in self.takes
            ]
            with closing(EstopInlet(context, clock, self.node, f"{self.endpoint}.estop")) as inlet:
                self.ready.set()
                while not self.ended.is_set():
                    inlet.socket.poll(20)
                    for received in inlet.receive():
                        assert isinstance(received.message, SessionControl)
                        for handler in handlers:
                            handler.handle(received.message, clock.now_ns())

    def wait_for(self, count: int) -> None:
        """Wait until so many stops have been taken, for ten seconds at most."""
        end_s = time.monotonic() + 10.0
        while len(self.taken) < count and time.monotonic() < end_s:
            time.sleep(0.01)

    def execute(self, control: SessionControl) -> str:
        self.taken.append(control)
        return "stopped"

    def answers(self, publisher: ZmqPublisher, node: str) -> Callable[..., None]:
        def event(kind: str, level: str, text: str, *, answer_to: str = "", **data: Any) -> None:
            # what the link carries has the name of the node that it comes from
            publisher.node = node
            publisher.publish("session/event", id=answer_to, kind=kind, level=level, text=text, data=data)

        return event


@pytest.fixture
def run(tmp_path: Path) -> Iterator[Callable[..., Device]]:
    devices: list[Device] = []

    def start(node: str, *takes: str) -> Device:
        device = Device(tmp_path, node, *takes)
        devices.append(device)
        device.start()
        assert device.ready.wait(10)
        return device

    yield start
    for device in devices:
        device.ended.set()
    for device in devices:
        device.join()


@pytest.fixture
def site_file(tmp_path: Path) -> Path:
    path = tmp_path / "site.yaml"
    further = ("delay_node@slave", "console@master", "controller@master", "controller@slave", "launcher@slave")
    nodes = (HAND, TIP, LINK, RECORDER, *further)
    path.write_text(json.dumps({"nodes": {node: f"ipc://{tmp_path}/{node}" for node in nodes}}))
    return path


def test_both_devices_are_stopped_each_under_the_name_of_its_site(
    run: Callable[..., Device], site_file: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    hand, tip, recorder = run(HAND), run(TIP), run(RECORDER)
    assert run_estop(EstopRequest(site_file=site_file)) == 0
    assert sorted(capsys.readouterr().out.splitlines()) == [f"{TIP} ack: stopped", f"{HAND} ack: stopped"]
    assert {control.src for control in hand.taken} == {"estop@master"}
    assert {control.src for control in tip.taken} == {"estop@slave"}
    # the recorder, which is not waited for, has the stop of either site
    recorder.wait_for(2)
    assert {control.src for control in recorder.taken} == {"estop@master", "estop@slave"}
    assert len({control.id for control in (*hand.taken, *tip.taken)}) == 1


@pytest.fixture
def two_rigs(tmp_path: Path, run: Callable[..., Device], monkeypatch: pytest.MonkeyPatch) -> Iterator[list[Device]]:
    """The instrument of the first rig and that of another one, each with its hand."""
    monkeypatch.setenv("TELENANO_RUNTIME_DIR", str(tmp_path))
    monkeypatch.setenv("TELENANO_RIG", "")
    (tmp_path / "rig-lab").mkdir(mode=0o700)
    devices = [run(node) for node in (HAND, TIP)]
    others = [Device(tmp_path / "rig-lab", node) for node in (HAND, TIP)]
    for device in others:
        device.start()
        assert device.ready.wait(10)
    yield [*devices, *others]
    for device in others:
        device.ended.set()
        device.join()


def test_whoever_names_no_rig_stops_all_of_them(two_rigs: list[Device], capsys: pytest.CaptureFixture[str]) -> None:
    assert run_estop(EstopRequest(as_json=True)) == 0
    printed = capsys.readouterr()
    answers = json.loads(printed.out)["answers"]
    assert sorted(answers) == sorted(f"{rig}/{node}" for rig in ("main", "lab") for node in (HAND, TIP))
    assert "no rig was named, and the stop went to each one of this user that was found: lab, main;" in printed.err
    assert all(device.taken for device in two_rigs)


@pytest.mark.parametrize(
    ("rig", "stopped"), [("main", [True, True, False, False]), ("lab", [False, False, True, True])]
)
def test_whoever_names_a_rig_stops_that_one(two_rigs: list[Device], rig: str, stopped: list[bool]) -> None:
    assert run_estop(EstopRequest(rig=rig)) == 0
    assert [bool(device.taken) for device in two_rigs] == stopped


def test_a_rig_that_does_not_answer_does_not_keep_the_stop_from_the_others(
    two_rigs: list[Device], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    real = estop_command.emergency_stop

    def stop(rig: LocalRig, *given: Any) -> Any:
        if "rig-lab" in rig.endpoints[TIP]:
            return real(rig, *given)
        two_rigs[3].wait_for(1)
        return {TIP: Answer(TIP, "kept", "did not answer estop within 5 s")}

    monkeypatch.setattr(estop_command, "emergency_stop", stop)
    assert run_estop(EstopRequest()) == 1
    assert two_rigs[2].taken and two_rigs[3].taken
    assert f"telenano: main/{TIP} did not answer estop within 5 s" in capsys.readouterr().err


def test_a_rig_in_folders_of_its_site_file_is_stopped_once(
    tmp_path: Path,
    run: Callable[..., Device],
    site_file: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setenv("TELENANO_RUNTIME_DIR", str(tmp_path))
    (tmp_path / "rig-lab").mkdir(mode=0o700)
    run(HAND), run(TIP)
    assert run_estop(EstopRequest(site_file=site_file)) == 0
    assert sorted(capsys.readouterr().out.splitlines()) == [f"{TIP} ack: stopped", f"{HAND} ack: stopped"]


def test_from_one_site_the_tip_is_stopped_through_the_link(
    run: Callable[..., Device], site_file: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    hand, link = run(HAND), run(LINK, TIP)
    assert run_estop(EstopRequest(site="master", site_file=site_file, as_json=True)) == 0
    answers = json.loads(capsys.readouterr().out)
    assert answers == {
        "command": "estop",
        "target": "*",
        "answers": {node: {"kind": "ack", "text": "stopped"} for node in (HAND, TIP)},
    }
    assert {control.src for control in (*hand.taken, *link.taken)} == {"estop@master"}


def test_a_stop_of_either_site_goes_to_both_devices(run: Callable[..., Device], site_file: Path) -> None:
    hand, tip, link = run(HAND), run(TIP), run(LINK, TIP)
    for count, site in enumerate(("slave", "master"), 1):
        assert run_estop(EstopRequest(site=site, site_file=site_file)) == 0
        assert [len({control.id for control in device.taken}) for device in (hand, tip)] == [count, count]
    assert link.taken == []


def test_at_the_instruments_machine_a_hand_that_is_not_heard_of_is_out_of_reach(
    run: Callable[..., Device], site_file: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("telenano.console.emergency_stop._DEADLINE_S", 0.5)
    tip, folder = run(TIP), site_file.parent
    assert run_estop(EstopRequest(site_file=site_file, as_json=True)) == 1
    answers = json.loads(capsys.readouterr().out)["answers"]
    assert {node: row["kind"] for node, row in answers.items()} == {TIP: "ack", HAND: "unreached"}
    assert {control.target for control in tip.taken} == {"*"}, "the instrument's answer has whom the stop is for"
    assert not (folder / f"{HAND}.estop.kept").exists(), "nobody would read it here"


def test_a_device_that_does_not_run_is_named_and_the_other_one_stopped(
    run: Callable[..., Device], site_file: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    run(LINK, TIP)
    tip = run(TIP)
    assert run_estop(EstopRequest(site_file=site_file)) == 1
    said = f"telenano: {HAND} is not running: the stop is kept, and it will start in emergency stop\n"
    assert capsys.readouterr() == (f"{TIP} ack: stopped\n", said)
    assert tip.taken


def test_a_rig_that_does_not_run_is_told_at_once(site_file: Path, capsys: pytest.CaptureFixture[str]) -> None:
    # a socket that a killed process left behind
    with zmq.Context() as context, context.socket(zmq.SUB) as left:
        left.bind(f"ipc://{site_file.parent}/{TIP}.estop")
    assert run_estop(EstopRequest(site_file=site_file)) == 1
    assert "no device of the site file was found here" in capsys.readouterr().err


def test_a_device_that_does_not_answer_is_named(
    run: Callable[..., Device], site_file: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("telenano.console.emergency_stop._DEADLINE_S", 0.3)
    run(HAND)
    with (
        zmq.Context() as context,
        closing(EstopInlet(context, SystemClock(), TIP, f"ipc://{site_file.parent}/{TIP}.estop")),
    ):
        assert run_estop(EstopRequest(site_file=site_file)) == 1
    out, err = capsys.readouterr()
    assert out == f"{HAND} ack: stopped\n"
    later = "it will stop as soon as it continues or is started again"
    assert err == f"telenano: {TIP} did not answer estop within 0.3 s: {later}\n"
    kept = decode("session/control", (site_file.parent / f"{TIP}.estop.kept").read_bytes())
    assert isinstance(kept, SessionControl)
    assert (kept.src, kept.command, kept.target) == ("estop@slave", "estop", "*")


def test_a_stop_is_kept_for_a_device_whose_folder_was_removed_while_it_is_started_again(
    run: Callable[..., Device], site_file: Path
) -> None:
    nodes = json.loads(site_file.read_text())["nodes"]
    gone = site_file.parent / "gone"
    site_file.write_text(json.dumps({"nodes": nodes | {TIP: f"ipc://{gone}/{TIP}"}}))
    run(HAND), run("controller@slave")
    run_estop(EstopRequest(site_file=site_file))
    kept = decode("session/control", (gone / f"{TIP}.estop.kept").read_bytes())
    assert isinstance(kept, SessionControl)
    assert (kept.src, kept.command) == ("estop@slave", "estop")
    assert gone.stat().st_mode & 0o777 == 0o700


def test_a_stop_for_the_other_site_is_kept_at_the_link(
    run: Callable[..., Device], site_file: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("telenano.console.emergency_stop._DEADLINE_S", 0.3)
    run(HAND)
    # the link takes it, and nobody answers from beyond it
    run(LINK)
    assert run_estop(EstopRequest(site="master", site_file=site_file)) == 1
    later = f"the link sends it to {TIP} until that has obeyed it, and no sample of the hand before"
    assert capsys.readouterr().err == f"telenano: {TIP} did not answer estop within 0.3 s: {later}\n"
    kept = decode("session/control", (site_file.parent / f"{LINK}.estop.kept").read_bytes())
    assert isinstance(kept, SessionControl)
    assert (kept.src, kept.command, kept.target) == ("estop@master", "estop", "*")
    assert not (site_file.parent / f"{TIP}.estop.kept").exists()


class Endless:
    """A socket at which something waits always."""

    def poll(self, timeout: int) -> int:
        return 1

    def get(self, option: int) -> int:
        return zmq.POLLIN

    def recv(self) -> bytes:
        return b"\x01session/control"


def test_readers_that_subscribe_for_ever_keep_nothing_from_being_sent() -> None:
    socket: Any = SimpleNamespace(socket=Endless())
    assert command_client._new_subscriptions(socket) > 0
    inlet = _Inlet.__new__(_Inlet)
    inlet.socket, inlet.ready, inlet._whole, inlet._taken = socket.socket, False, False, 0
    assert inlet.read_subscription(0)
    player = ReplayPublisher.__new__(ReplayPublisher)
    player.publisher, player.subscriptions, player.was_read = socket, set(), False
    assert player.read_subscriptions()


def test_events_that_come_faster_than_they_are_read_do_not_keep_a_stop_from_being_sent_again(
    site_file: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(emergency_stop, "_DEADLINE_S", 0.5)
    # an event takes longer to be read than to be sent
    monkeypatch.setattr(emergency_stop, "_answer", lambda *_: time.sleep(0.01))
    ended = threading.Event()
    address = f"ipc://{site_file.parent}/{TIP}"
    with zmq.Context() as context, closing(EstopInlet(context, SystemClock(), TIP, f"{address}.estop")) as inlet:

        def flood() -> None:
            with closing(context.socket(zmq.PUB)) as publisher:
                publisher.set(zmq.LINGER, 0)
                publisher.bind(address)
                end_s = time.monotonic() + 3.0
                while time.monotonic() < end_s and not ended.is_set():
                    publisher.send_multipart([b"session/event", b"x"])
                    time.sleep(0.001)

        flooding = threading.Thread(target=flood)
        flooding.start()
        stopping = threading.Thread(target=run_estop, args=(EstopRequest(target=TIP, site_file=site_file),))
        stopping.start()
        stops = 0
        while stopping.is_alive():
            if inlet.socket.poll(10):
                inlet.socket.recv_multipart()
                stops += 1
        ended.set()
        flooding.join()
        stopping.join()
    assert stops >= 3


def test_a_stop_needs_nothing_that_another_sender_has(run: Callable[..., Device], site_file: Path) -> None:
    tip = run(TIP)
    clock = SystemClock()
    with zmq.Context() as context:
        # a console at work, a stop that was sent and hangs, and one whose clock is an hour ahead
        console = ZmqPublisher(context, clock, "console@master", f"ipc://{site_file.parent}/console@master")
        inlet = _Inlet(context, tip.endpoint, whole=False)
        hung = _Sender("slave", "hung", "*", [inlet])
        hung._clock.epoch_offset_ns += 3600 * 10**9
        try:
            assert inlet.socket.poll(10_000)
            for _ in range(20):
                hung.send(again=True)
            for _ in range(2):
                assert run_estop(EstopRequest(target=TIP, site_file=site_file)) == 0
        finally:
            inlet.close()
            console.close()
    assert len({control.id for control in tip.taken}) == 3


def test_the_inlet_takes_nothing_but_stops(tmp_path: Path) -> None:
    done: list[str] = []
    handler = CommandHandler(
        TIP, ("arm", "estop"), lambda control: done.append(control.command) or "", lambda *_, **__: None
    )
    fields = {**fields_of(examples(TOPICS["session/control"])["minimal"]), "target": "*", "t_ns": 10}
    with zmq.Context() as context, closing(EstopInlet(context, SystemClock(), TIP, f"ipc://{tmp_path}/x")) as inlet:
        for src, command in (("console@master", "estop"), ("estop@slave", "arm"), ("estop@slave", "estop")):
            control = msgspec.convert({**fields, "src": src, "command": command, "id": command}, SessionControl)
            received = inlet.decode_and_track([b"session/control", encode(control)], 0)
            if received is not None:
                handler.handle(control, 10)
        assert inlet.rejected == {"source": 1}
    assert done == ["estop"]


def test_a_recorder_gets_what_was_sent_before_it_was_ready(tmp_path: Path) -> None:
    received: dict[str, list[SessionControl]] = {"tip": [], "recorder": []}
    with zmq.Context() as context, ExitStack() as stack:
        inlets = {name: _Inlet(context, f"ipc://{tmp_path}/{name}", whole=name == "recorder") for name in received}
        for inlet in inlets.values():
            stack.enter_context(closing(inlet))
        sender = _Sender("slave", "abc", "*", list(inlets.values()))
        bound = {}
        # the recorder comes when the tip has had two
        for name, count in (("tip", 2), ("recorder", 3)):
            bound[name] = EstopInlet(context, SystemClock(), name, f"ipc://{tmp_path}/{name}.estop")
            stack.enter_context(closing(bound[name]))
            while not inlets[name].ready:
                bound[name].pending()
                sender.send(again=False)
            while len(received["tip"]) < count:
                sender.send(again=len(received["tip"]) == len(sender._messages))
                for other, inlet in bound.items():
                    received[other] += [message.message for message in inlet.receive()]
        while len(received["recorder"]) < 3:
            received["recorder"] += [message.message for message in bound["recorder"].receive()]
    assert received["tip"] == received["recorder"]
    assert [control.seq for control in received["tip"]] == [0, 1, 2]
    # a message of the first version, which nodes of an older one take
    assert {(c.command, c.target, c.src, c.v, c.id) for c in received["tip"]} == {
        ("estop", "*", "estop@slave", 1, "abc")
    }
    assert all(abs(SystemClock().now_ns() - control.t_ns) < 10**10 for control in received["tip"])


def test_no_event_of_others_is_taken_for_an_answer() -> None:
    event = msgspec.structs.replace(examples(TOPICS["session/event"])["minimal"], id="a", kind="ack")
    assert _answer([b"session/event", encode(event)], "a") is not None
    for other in (msgspec.structs.replace(event, id="b"), msgspec.structs.replace(event, kind="mode")):
        assert _answer([b"session/event", encode(other)], "a") is None
    for junk in (b"", b"\xc1", b"\x93\x01\x02\x03", b"\x80"):
        assert _answer([b"session/event", junk], "a") is None


def test_ways_to_devices_that_are_not_here(run: Callable[..., Device], tmp_path: Path) -> None:
    here = f"ipc://{tmp_path}/"
    both = {"local": here + TIP, "network": "tcp://10.0.0.2:5712"}
    # nothing runs: an ipc socket alone says so, what has a network endpoint may run elsewhere
    assert LocalRig({HAND: here + HAND, TIP: both}).reach("*", "") == Reach(by_console=(TIP,), absent=(HAND,))
    assert LocalRig({HAND: "tcp://10.0.0.1:5701"}).reach("*", "") == Reach(by_console=(HAND,))
    assert LocalRig({}).reach("*", "") == Reach()
    run(LINK)
    rig = LocalRig({HAND: here + HAND, TIP: both, LINK: {"local": here + LINK}})
    assert rig.reach("*", "") == rig.reach("*", "master") == Reach(by_link=(TIP,), absent=(HAND,))
    assert rig.reach("haptic_node", "slave") == Reach(absent=(HAND,))
    # a node of an older version has an endpoint and no inlet
    with zmq.Context() as context, closing(ZmqPublisher(context, SystemClock(), HAND, here + HAND)):
        assert rig.reach("haptic*", "master") == Reach(by_console=(HAND,))


@pytest.mark.parametrize("path", [DEFAULT_SITE_FILE, TWO_SITES_FILE])
def test_the_files_of_the_project_need_not_be_read(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TELENANO_RUNTIME_DIR", "/run/rig")
    known, read = LocalRig.packaged(two_machines=path == TWO_SITES_FILE), LocalRig.read(path)
    stopped = (*DEVICES, LINK, RECORDER, *(node for node in read.nodes if node == "recorder@slave"))
    assert [known.endpoints[node] for node in stopped] == [read.endpoints[node] for node in stopped]
    for target, site in itertools.product(("*", HAND, TIP), ("", "master", "slave")):
        assert known.reach(target, site) == read.reach(target, site)


def test_the_endpoints_are_those_of_the_address_book(site_file: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TELENANO_RUNTIME_DIR", "/run/rig")
    nodes = {HAND: "ipc://{runtime}/hand", TIP: {"local": "ipc:///x", "network": "tcp://a:1"}, LINK: "tcp://a:2"}
    book, rig = AddressBook.model_validate({"nodes": nodes}), LocalRig(nodes)
    assert rig.endpoints == {HAND: "ipc:///run/rig/hand", TIP: "ipc:///x"}
    assert {node: book.local_endpoint(node) for node in rig.endpoints} == rig.endpoints
    assert book.estop_endpoint(HAND) == "ipc:///run/rig/hand.estop"
    assert book.estop_endpoint(LINK) is None
    for length, fits in ((101, True), (102, False)):
        long = AddressBook.model_validate({"nodes": {HAND: "ipc:///" + "x" * (length - 1)}})
        assert (long.estop_endpoint(HAND) is not None) == fits
    for wrong in ("[", "[]", "nodes: 5", ""):
        site_file.write_text(wrong)
        assert LocalRig.read(site_file).nodes == frozenset()
    assert LocalRig.read(site_file / "absent").nodes == frozenset()


def test_an_inlet_leaves_no_socket_and_belongs_to_one_node(tmp_path: Path) -> None:
    with zmq.Context() as context:
        EstopInlet(context, SystemClock(), TIP, f"ipc://{tmp_path}/x").close()
        assert list(tmp_path.iterdir()) == []
        with pytest.raises(EndpointError, match="afm_node@slave cannot bind"):
            EstopInlet(context, SystemClock(), TIP, f"ipc://{tmp_path}/absent/x")


@pytest.mark.parametrize(
    ("line", "request_"),
    [
        ("estop", EstopRequest()),
        ("session estop", EstopRequest()),
        ("estop --site slave --json", EstopRequest(site="slave", as_json=True)),
        ("estop --site=master", EstopRequest(site="master")),
        ("session estop --target afm_node", EstopRequest(target="afm_node")),
        ("estop --site-file my.yaml", EstopRequest(site_file=Path("my.yaml"))),
        ("estop --rig lab", EstopRequest(rig="lab")),
        # what stands twice stops as much as it could mean
        ("estop --json --json --rig lab --rig=lab", EstopRequest(rig="lab", as_json=True)),
        ("estop --rig lab --rig other", EstopRequest()),
        ("estop --target afm_node --target haptic_node --site slave --site master", EstopRequest()),
        ("estop --site-file my.yaml --site-file other.yaml", None),
        # what is wrong or asks for help is left to the usual way
        ("estop --help", None),
        ("estop --site", None),
        ("estop --site nowhere", None),
        ("estop --rig ../lab", None),
        ("estop now", None),
        ("estop --fast", None),
        ("session mark estop=1", None),
        ("session arm", None),
        ("session session estop", None),
        ("mark estop", None),
        ("session", None),
    ],
)
def test_the_command_line_is_read_without_typer(line: str, request_: EstopRequest | None) -> None:
    assert read_arguments(line.split()) == request_


def test_a_stop_imports_no_models(run: Callable[..., Device], site_file: Path) -> None:
    run(TIP)
    code = "import atexit, sys, telenano.cli.app as root; "
    code += f"sys.argv = ['telenano', 'estop', '--site-file', {str(site_file)!r}, '--target', 'afm_node']; "
    code += "slow = {'pydantic', 'numpy', 'typer', 'click', 'rich', 'telenano.wire.messages', 'asyncio'}; "
    code += "atexit.register(lambda: print(slow & set(sys.modules))); root.main()"
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert result.stdout == f"{TIP} ack: stopped\nset()\n"
