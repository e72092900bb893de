"""What is said of each device that was asked: who asks, what, and every state of each device, against what happened.

The world below knows which device has obeyed and which will find the stop. The rules are its own: a row of a device is
an acknowledgement exactly if it has obeyed, "kept" only if it, or the link, will find the stop, and the exit code is 0
exactly if all who were asked have obeyed.
"""

import io
import itertools
import json
import os
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, redirect_stderr, redirect_stdout
from pathlib import Path
from types import SimpleNamespace
from typing import Any, NamedTuple

import msgspec
import pytest
import typer

from services.viz_node.commander import RigCommander
from telenano.cli import estop_command
from telenano.cli.commands.session import send_command
from telenano.cli.estop_command import EstopRequest, run_estop
from telenano.console import emergency_stop, send_commands
from telenano.console.answers import Answer
from telenano.console.emergency_stop import LocalRig
from telenano.runtime.bus import holders
from telenano.runtime.bus.holders import Holder, Look
from telenano.runtime.bus.local_endpoint import Peer
from telenano.runtime.loop.commands import CommandClient
from telenano.testing import VirtualClock
from telenano.wire.errors import RigError, TelenanoError
from telenano.wire.messages import SessionEvent
from telenano.wire.nodes import is_meant

HAND, TIP, LINK = "haptic_node@master", "afm_node@slave", "delay_node@master"
RECORDER, HALVES = "recorder@master", ("controller@master", "controller@slave")
OURS = Peer(1, os.geteuid())
STATES = ("running", "starting", "killed", "ended", "hung", "cut off", "not configured")
# Which sites have their processes on the machine of who asks.
MACHINES = {"one": ("master", "slave"), "the operator's": ("master",), "the instrument's": ("slave",)}


class World(NamedTuple):
    """The rig as it is: the machine of who asks, the state of each device, and whether launchers and the link run."""

    machine: str
    hand: str
    tip: str
    launchers: bool
    link: bool

    def state(self, device: str) -> str:
        return self.hand if device == HAND else self.tip

    def is_here(self, node: str) -> bool:
        return node.partition("@")[2] in MACHINES[self.machine]

    def is_cut(self, device: str) -> bool:
        return not self.is_here(device) and "cut off" in (self.hand, self.tip)

    def runs(self, node: str) -> bool:
        """Whether a process of a node runs at all, wherever it is."""
        if node in (HAND, TIP):
            # A device whose line is cut runs.
            return self.state(node) in ("running", "hung", "cut off")
        if node == LINK:
            return self.link
        return self.launchers if node.startswith("launcher") else True

    def obeys(self, device: str) -> bool:
        """Whether a device obeys a stop that is brought to it."""
        is_back = self.state(device) == "starting" and self.launchers
        return is_back or self.state(device) in ("running", "cut off")

    def nodes(self, folder: Path) -> dict[str, Any]:
        """The section `nodes` of the site file, with network endpoints at the slave's where there are two machines."""
        launchers = ("launcher@master", "launcher@slave") if self.machine != "one" else ("launcher@master",)
        entries: dict[str, Any] = {}
        for node in (HAND, TIP, LINK, RECORDER, *HALVES, *launchers, "console@master"):
            if node not in (HAND, TIP) or self.state(node) != "not configured":
                is_networked = self.machine != "one" and node.endswith("@slave")
                network = {"network": "tcp://10.9.9.9:5712"} if is_networked else {}
                entries[node] = {"local": f"ipc://{folder}/{node}", **network}
        return entries


class Stops:
    """What happens to a stop in a world, in the place of the sockets."""

    def __init__(self, world: World, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        self.world, self.folder = world, folder
        self.obeyed: set[str] = set()
        folder.mkdir()
        self.site_file = folder / "site.yaml"
        self.site_file.write_text(json.dumps({"nodes": world.nodes(folder)}))
        here = [node for node in world.nodes(folder) if world.is_here(node) and world.runs(node)]
        bound = {f"ipc://{folder}/{node}" for node in here}
        bound |= {f"ipc://{folder}/{node}.estop" for node in here if node in (HAND, TIP, LINK)}
        held = tuple(Holder(7, "7", node, f"{folder}/{node}", takes_signal=False) for node in here)
        monkeypatch.setattr(emergency_stop, "bound_by", lambda endpoint: OURS if endpoint in bound else None)
        for module in (emergency_stop, estop_command, holders):
            monkeypatch.setattr(module, "look", lambda: Look(held))
        monkeypatch.setattr(emergency_stop, "_send", self.send)
        monkeypatch.setattr(send_commands, "send_control", self.by_console)
        monkeypatch.setattr("services.viz_node.commander.send_control", self.by_console)
        # Parsing the site file takes longer than all else.
        nodes = world.nodes(folder)
        read = staticmethod(lambda path, seen=None: LocalRig(nodes, seen or Look(held)))
        monkeypatch.setattr(LocalRig, "read", read)

    def send(self, rig: Any, reach: Any, wanted: Any, answers: dict[str, Answer], on_answer: Any, *_: Any) -> Any:
        emergency_stop.keep_stop(rig, reach, wanted.target, wanted.identifier)
        world = self.world
        sent = set(emergency_stop._stopped_at(reach, wanted.near))
        # Nothing can be sent to what is not on this machine.
        assert all(world.is_here(node) for node in sent)
        reached = {node for node in sent if node in (HAND, TIP) and world.obeys(node)}
        if LINK in sent and world.link and is_meant(TIP, wanted.target) and world.obeys(TIP) and not world.is_cut(TIP):
            reached.add(TIP)
        # The instrument's answer carries it to the hand, and the link reports that to who listens.
        is_carried = TIP in reached and world.link and is_meant(HAND, wanted.target) and not world.is_cut(HAND)
        if is_carried and world.obeys(HAND):
            reached.add(HAND)
        self.obeyed |= reached
        heard = {node for node in reached if node in wanted.near or node in wanted.far}
        for node in sorted(heard):
            answers[node] = Answer(node, "ack", "stopped")
            on_answer(answers[node])
        return {}

    def by_console(self, *_: Any, **__: Any) -> dict[str, SessionEvent]:
        raise RigError("no console reaches it")

    def is_kept(self, device: str) -> bool:
        """Whether a device will find the stop when it can: in its own folder, or the link has it."""
        own = (self.folder / f"{device}.estop.kept").exists() and self.world.is_here(device)
        return own or (device == TIP and (self.folder / f"{LINK}.estop.kept").exists() and self.world.is_here(LINK))


def given(who: str, target: str, stops: Stops) -> tuple[int, dict[str, str]]:
    """Give a stop; return the exit code, 0 for the page where it says that all is well, and the kind of each row."""
    if who == "page":
        try:
            answers = RigCommander(stops.site_file).estop("Ada")
        except TelenanoError as error:
            return 1, {"": type(error).__name__}
        kinds = {node: kind for node, (kind, _) in answers.items()}
        return 0 if kinds and set(kinds.values()) == {"ack"} else 1, kinds
    out = io.StringIO()
    with redirect_stdout(out), redirect_stderr(io.StringIO()):
        code = run_estop(EstopRequest(target, {"command": ""}.get(who, who), stops.site_file, as_json=True))
    document = json.loads(out.getvalue().splitlines()[-1])
    return code, {node: row["kind"] for node, row in document.get("answers", {}).items()}


@pytest.mark.grid(machine="the instrument's", launchers=True)
@pytest.mark.parametrize("launchers", [True, False], ids=["supervised", "alone"])
@pytest.mark.parametrize("machine", MACHINES)
def test_an_estop_says_of_each_device_what_became_of_it(
    machine: str, launchers: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    cells = itertools.product(STATES, STATES, (True, False), ("command", "master", "slave", "page"), ("*", "afm_node"))
    count = 0
    for number, (hand, tip, link, who, target) in enumerate(cells):
        if who == "page" and (target != "*" or machine == "the instrument's"):
            # The page's stop is for both, and its server runs at the operator's.
            continue
        world = World(machine, hand, tip, launchers, link)
        stops = Stops(world, tmp_path / str(number), monkeypatch)
        code, kinds = given(who, target, stops)
        cell = f"{world}, {who} stops {target}: {code} {kinds}"
        asked = {node for node in (HAND, TIP) if is_meant(node, target) and world.state(node) != "not configured"}
        assert (code == 0) == (bool(asked) and asked <= stops.obeyed), cell
        if kinds.keys() - {""}:
            assert set(kinds) == asked, cell
        for node, kind in kinds.items():
            assert (kind == "ack") == (node in stops.obeyed), cell
            assert kind != "kept" or stops.is_kept(node), cell
            if kind == "absent":
                assert not world.runs(node), cell
        # The price: what runs on this machine and obeys is stopped, from wherever.
        assert {node for node in asked if world.is_here(node) and world.obeys(node)} <= stops.obeyed, cell
        count += 1
    assert count > 300


# --- commands other than the stop ---

# Who is asked, as COMMANDS.md says it: nodes that a pattern reaches, or those of the name.
BY_PATTERN = {
    "arm": (HAND, TIP),
    "start": (HAND,),
    "stop": (HAND,),
    "set": (*HALVES, LINK),
    "mark": (RECORDER,),
}
NAMED = (
    ("stop", "afm_node", (TIP,)),
    ("set", "delay_node", (LINK,)),
    ("set", "controller", HALVES),
    ("arm", "afm_node", (TIP,)),
)
NODE_STATES = ("running", "refuses", "hung", "killed")


class Console:
    """The console of a rig without sockets: nodes answer what is published, in virtual time."""

    def __init__(self, states: dict[str, str]) -> None:
        self.states, self.clock = states, VirtualClock()
        self._waiting: list[Any] = []
        self.socket = SimpleNamespace(poll=lambda timeout: 0)
        self.network = SimpleNamespace(process_events=lambda: ())
        self.key, self._seq = "console@master", 0

    def publish(self, topic: str, **control: Any) -> None:
        for node, state in self.states.items():
            if is_meant(node, control["target"]) and state in ("running", "refuses"):
                pattern = any(sign in control["target"] for sign in "*?[")
                if pattern and node not in BY_PATTERN[control["command"]]:
                    continue
                kind = "ack" if state == "running" else "refused"
                data = {"command": control["command"]}
                self._event(node, control["id"], kind, data)
                if control["command"] == "arm" and node == TIP and kind == "ack":
                    self._event(node, "", "mode", {"placed": True, "mode": "follow"})

    def _event(self, node: str, identifier: str, kind: str, data: dict[str, Any]) -> None:
        header = {"seq": self._seq, "t_ns": self.clock.now_ns(), "src": node, "v": 1, "level": "info", "text": "so"}
        self._seq += 1
        event = msgspec.convert({**header, "id": identifier, "kind": kind, "data": data}, SessionEvent)
        self._waiting.append(SimpleNamespace(message=event))

    def receive(self) -> Sequence[Any]:
        taken, self._waiting = self._waiting, []
        return taken

    def subscribers(self, *_: Any) -> list[Any]:
        return [self]

    def bind(self, *_: Any, **__: Any) -> Any:
        return SimpleNamespace(publish=self.publish, socket=SimpleNamespace(poll=lambda t: 0, set=lambda *_: None))

    def command_client(self, commands: Any, publish: Any, **given: Any) -> CommandClient:
        return CommandClient(self.clock, publish, commands, issued_ns=self.clock.monotonic_ns())

    def wait(self, *_: Any) -> None:
        self.clock.advance_ns(20_000_000)


@contextmanager
def as_console(console: Console, seen: Look, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    @contextmanager
    def at_console(*_: Any) -> Iterator[Console]:
        yield console

    monkeypatch.setattr(send_commands, "_at_console", at_console)
    monkeypatch.setattr(send_commands, "require_rig", lambda *_: None)
    monkeypatch.setattr(send_commands.zmq, "select", console.wait)
    monkeypatch.setattr(emergency_stop, "look", lambda: seen)
    yield
    monkeypatch.undo()


@pytest.mark.grid(site="slave")
@pytest.mark.parametrize("site", ["master", "slave"])
def test_a_command_says_of_each_node_what_became_of_it(
    site: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    nodes = (HAND, TIP, LINK, RECORDER, *HALVES)
    folder = tmp_path / "r"
    folder.mkdir()
    site_file = folder / "site.yaml"
    entries = {node: f"ipc://{folder}/{node}" for node in (*nodes, "console@master", "console@slave")}
    site_file.write_text(json.dumps({"nodes": entries}))
    cases = [(command, "*", who) for command, who in BY_PATTERN.items()] + list(NAMED)
    count = 0
    for command, target, who in cases:
        for states in itertools.product(NODE_STATES, repeat=len(who)):
            of = {**dict.fromkeys(nodes, "running"), **dict(zip(who, states, strict=True))}
            console = Console(
                {node: state for node, state in of.items() if site == "master" or node.endswith("@slave")}
            )
            console.key = f"console@{site}"
            alive = tuple(Holder(7, "7", node, f"{folder}/{node}") for node, state in of.items() if state != "killed")
            out, parameters = io.StringIO(), ["forward.delay_s=0.0"] if command == "set" else []
            with as_console(console, Look(alive), monkeypatch), redirect_stdout(out), redirect_stderr(io.StringIO()):
                try:
                    send_command(command, parameters, target, site_file, site, as_json=True)
                    code = 0
                except typer.Exit as end:
                    code = end.exit_code
            document = json.loads(out.getvalue().splitlines()[-1])
            cell = f"{command} {target} from {site}, {dict(zip(who, states, strict=True))}: {code} {document}"
            near = [node for node in who if site == "master" or node.endswith("@slave")]
            if not near:
                assert code == 2, cell
                continue
            assert (code == 0) == (near == list(who) and set(states) == {"running"}), cell
            rows = {node: row["kind"] for node, row in document["answers"].items()}
            assert set(rows) == set(who), cell
            truth = {"running": "ack", "refuses": "refused", "hung": "unreached", "killed": "absent"}
            for node, state in zip(who, states, strict=True):
                # A command to both devices goes to the tip only after the hand has obeyed.
                unsent = command == "arm" and node == TIP and HAND in near and of[HAND] != "running"
                wanted = "unreached" if unsent or node not in near else truth[state]
                assert rows[node] == wanted, cell
            count += 1
    assert count > 20
