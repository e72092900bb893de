"""The web server against pages as they should not be, without a rig and without a port."""

import asyncio
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack
from dataclasses import replace
from itertools import groupby, pairwise
from pathlib import Path
from typing import Any

import msgpack
import msgspec
import pytest
from bus_page import ACCESS, HEADERS
from bus_page import BusPage as Page
from made_source import MadeSource

from telenano.testing import until

pytest.importorskip("starlette")
pytest.importorskip("httpx2")
from starlette.testclient import TestClient
from starlette.websockets import WebSocketDisconnect

from services.viz_node import command_desk, page_hand, read_desk, server
from services.viz_node import hub as hubs
from services.viz_node.feed import SeenMessage, seen
from services.viz_node.hub import Hub
from services.viz_node.page_session import MOST_QUEUED, Session
from services.viz_node.requests import CommandRequest, EstopRequest, HandRequest, LeaseRequest
from telenano.sections.operator_section import InteractiveConfig
from telenano.serving.access import Role
from telenano.testing.filled_messages import examples
from telenano.wire.errors import RigError
from telenano.wire.topics import TOPICS


class Commander:
    def __init__(self) -> None:
        self.sent: list[tuple[Any, ...]] = []
        self.begun: list[str] = []
        self.held = threading.Event()
        self.held.set()

    def send(
        self,
        command: str,
        target: str,
        parameters: Mapping[str, Any],
        is_wanted: Callable[[], bool],
        issued_ns: int,
        by: str,
    ) -> dict[str, tuple[str, str]]:
        self.begun.append(command)
        while not self.held.wait(0.005):
            if not is_wanted():
                raise RigError(f"{command} was given up")
        self.sent.append((command, target, dict(parameters)))
        if target == "nobody":
            raise RigError("no node is meant by target 'nobody'")
        return {
            "controller@master": ("ack", "set"),
            "controller@slave": ("refused" if parameters.get("x") == -1 else "ack", "x"),
        }

    def estop(self, by: str) -> dict[str, tuple[str, str]]:
        self.sent.append(("estop",))
        return {"afm_node@slave": ("ack", "latched")}


class Hand:
    def __init__(self, log: list[Any]) -> None:
        self.log = log

    def push(self, force_n: float, across_n: tuple[float, float], by: str) -> None:
        self.log.append((force_n, *across_n) if any(across_n) else force_n)

    def now_ns(self) -> int:
        return 5_250_000_000

    def close(self) -> None:
        self.log.append("closed")


class Rig:
    def __init__(self) -> None:
        self.source, self.commander = MadeSource(), Commander()
        self.hand: list[Any] = []
        self.hub = Hub(self.source, self.commander, lambda: {"laws": ["wave"]}, lambda: Hand(self.hand))


@pytest.fixture
def rig(monkeypatch: pytest.MonkeyPatch) -> Rig:
    # what a machine that is busy with other tests holds up for a second is no old command here
    monkeypatch.setattr(command_desk, "VALIDITY_S", 60.0)
    return Rig()


@pytest.fixture
def page(tmp_path: Path) -> Path:
    (tmp_path / "index.html").write_text("<p>page</p>")
    return tmp_path


@pytest.fixture
def client(rig: Rig, page: Path) -> Iterator[TestClient]:
    with TestClient(server.make_app(rig.hub, ACCESS, page), client=("127.0.0.1", 5)) as found:
        yield found


@pytest.fixture
def stack() -> Iterator[ExitStack]:
    with ExitStack() as opened:
        yield opened


def command(**changes: Any) -> dict[str, Any]:
    return {"k": "command", "command": "set", "target": "controller", "parameters": {}, **changes}


def test_the_page_comes_with_a_policy_that_permits_nothing_from_elsewhere(client: TestClient) -> None:
    answer = client.get("/")
    assert answer.text == "<p>page</p>"
    policy = answer.headers["content-security-policy"]
    assert "default-src 'none'" in policy
    assert "unsafe" not in policy
    assert answer.headers["referrer-policy"] == "no-referrer"


@pytest.mark.parametrize(
    "headers", [{"host": "evil.example"}, {"host": "evil.example", "origin": "http://evil.example"}]
)
def test_a_name_that_is_not_ours_gets_nothing(client: TestClient, headers: dict[str, str]) -> None:
    answer = client.get("/", headers=headers)
    assert answer.status_code == 403
    assert "'evil.example' is not a name of this server" in answer.text


def test_an_address_that_is_not_allowed_gets_nothing(rig: Rig, page: Path) -> None:
    with TestClient(server.make_app(rig.hub, ACCESS, page), client=("10.0.0.9", 5)) as stranger:
        answer = stranger.get("/")
        assert (answer.status_code, "10.0.0.9 are not allowed" in answer.text) == (403, True)
        with pytest.raises(WebSocketDisconnect), stranger.websocket_connect("/bus", headers=HEADERS):
            pass


def test_a_monitoring_system_reads_the_reports_and_a_stranger_none(rig: Rig, page: Path, client: TestClient) -> None:
    answer = client.get("/metrics")
    assert answer.headers["content-type"].startswith("text/plain; version=0.0.4")
    assert "# TYPE telenano_rate_hertz gauge" in answer.text
    with TestClient(server.make_app(rig.hub, ACCESS, page), client=("10.0.0.9", 5)) as stranger:
        assert stranger.get("/metrics").status_code == 403


@pytest.mark.parametrize(
    ("token", "status"),
    [
        (ACCESS.observer_token, 200),
        (ACCESS.operator_token, 200),
        ("participant-token-01", 401),
        ("wrong-token-0123456", 401),
        ("\xb5", 401),
        ("", 401),
    ],
)
def test_from_another_machine_the_reports_need_a_token(
    rig: Rig, page: Path, monkeypatch: pytest.MonkeyPatch, token: str, status: int
) -> None:
    monkeypatch.setattr(server, "_WRONG_TOKEN_S", 0.0)
    access = replace(ACCESS, networks=("10.0.0.0/8",), participant_token="participant-token-01")
    with TestClient(server.make_app(rig.hub, access, page), client=("10.0.0.9", 5)) as far:
        answer = far.get("/metrics", headers={b"authorization": f"Bearer {token}".encode("latin-1")})
        assert answer.status_code == status
        assert ("# TYPE telenano_rate_hertz" in answer.text) is (status == 200)
        assert far.get("/health").status_code == 200


def test_the_reports_are_made_once_a_second_whatever_asks(rig: Rig, monkeypatch: pytest.MonkeyPatch) -> None:
    made: list[int] = []
    monkeypatch.setattr(hubs, "metrics_text", lambda nodes, now_ns, age: f"{made.append(now_ns)}")
    # 50 requests a tenth of a second for 3 s, and a clock that was set back
    for now_ns in [*(n // 50 * 100_000_000 for n in range(1500)), 5]:
        rig.hub.metrics(now_ns)
    assert made == [0, 1_000_000_000, 2_000_000_000, 5]


def test_a_page_of_another_server_cannot_open_the_socket(client: TestClient) -> None:
    opening = client.websocket_connect("/bus", headers={"origin": "http://evil.example"})
    with pytest.raises(WebSocketDisconnect) as refused, opening:
        pass
    assert "evil.example" in refused.value.reason


def test_a_page_that_has_not_been_built_says_how(rig: Rig) -> None:
    with TestClient(server.make_app(rig.hub, ACCESS, None), client=("127.0.0.1", 5)) as bare:
        assert "make page" in bare.get("/").text


@pytest.mark.parametrize(
    ("hello", "fault"),
    [
        ({"token": "wrong-token-01234"}, "the token is wrong"),
        ({"protocol": 2}, "load the page again"),
        ({"token": 7}, "$.token"),
        ({"k": "estop", "id": "a"}, "the first frame must be hello"),
    ],
)
def test_who_does_not_say_hello_properly_is_told_why(
    client: TestClient, stack: ExitStack, monkeypatch: pytest.MonkeyPatch, hello: dict[str, Any], fault: str
) -> None:
    monkeypatch.setattr(server, "_WRONG_TOKEN_S", 0.01)
    page = Page(stack, client, **hello) if "token" not in hello else Page(stack, client, **{"token": hello["token"]})
    assert fault in page.take("refused")["text"]


def test_who_says_nothing_is_sent_away(client: TestClient, stack: ExitStack, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(server, "_HELLO_S", 0.01)
    socket = stack.enter_context(client.websocket_connect("/bus", headers=HEADERS))
    assert "no token came" in msgpack.unpackb(socket.receive_bytes())["text"]


def test_a_page_gets_a_snapshot_and_then_what_changes(rig: Rig, client: TestClient, stack: ExitStack) -> None:
    page = Page(stack, client)
    snapshot = page.take("snapshot")
    assert (snapshot["role"], snapshot["commands"], snapshot["hand"]) == ("operator", True, True)
    assert (snapshot["forms"] or page.take("forms")["forms"]) == {"laws": ["wave"]}
    fields = {"kind": "mode", "level": "info", "text": "gap closed", "seq": 0, "data": {}}
    rig.source.waiting.append(SeenMessage("session/event", "afm_node@slave", 10**18, fields))
    assert page.take("tick")["events"][0]["text"] == "gap closed"


@pytest.mark.parametrize("frame", [b"", b"\xc1", b"\x81" * 50, msgpack.packb({"k": "nonsense"})])
def test_a_malformed_frame_ends_that_page_and_no_other(
    rig: Rig, client: TestClient, stack: ExitStack, frame: bytes
) -> None:
    good, bad = Page(stack, client), Page(stack, client)
    bad.take("snapshot")
    bad.socket.send_bytes(frame)
    assert bad.take("refused")["text"]
    assert good.ask(**command())["ok"] is True


def test_text_is_refused(client: TestClient, stack: ExitStack) -> None:
    page = Page(stack, client)
    page.take("snapshot")
    page.socket.send_text("{}")
    assert "binary frames" in page.take("refused")["text"]


def test_each_role_has_its_places_and_observers_keep_nobody_out(
    rig: Rig, client: TestClient, stack: ExitStack, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(hubs, "_END_S", 0.0)
    most = hubs.MOST_PAGES
    observers = [Page(stack, client, ACCESS.observer_token) for _ in range(most[Role.OBSERVER] + 10)]
    # The oldest goes first for the next one, and is told why.
    for page in observers[:10]:
        assert "made room for another one" in page.take("refused")["text"]
    operators = [Page(stack, client) for _ in range(most[Role.OPERATOR])]
    snapshots = [page.take("snapshot") for page in operators]
    assert operators[0].ask(k="lease", action="take")["ok"] is True
    assert operators[1].ask(**command(command="mark", target="recorder"))["ok"] is True
    # The page that holds control stays, though it is the oldest, and so does the one that did something last.
    Page(stack, client).take("snapshot")
    assert "made room" in operators[2].take("refused")["text"]
    assert operators[0].ask(k="estop")["ok"] is True
    assert operators[1].ask(k="estop")["ok"] is True
    assert len({snapshot["me"] for snapshot in snapshots}) == len(operators)
    Page(stack, client, ACCESS.participant_token).take("refused")
    assert all(page.ask(k="estop")["ok"] is True for page in observers[-3:])
    counted = {role: sum(each.role is role for each in rig.hub.sessions) for role in most}
    assert (counted[Role.OBSERVER], counted[Role.OPERATOR]) == (most[Role.OBSERVER], most[Role.OPERATOR])
    assert rig.hub.desk.refused.rejected["room"] == 11


def test_where_all_pages_of_a_role_are_busy_the_next_is_refused_with_the_number(
    rig: Rig, client: TestClient, stack: ExitStack, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(hubs.MOST_PAGES, Role.OPERATOR, 1)
    page = Page(stack, client)
    assert page.ask(k="lease", action="take")["ok"] is True
    refused = Page(stack, client).take("refused")["text"]
    assert refused == "1 pages of this kind are open, which is the most allowed"
    assert page.ask(**command(lease=rig.hub.desk.lease.number))["ok"] is True


def test_a_page_that_reads_nothing_loses_its_connection_when_it_makes_room(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(hubs, "_END_S", 0.01)

    async def made() -> bool:
        hub = hubs.Hub(MadeSource())
        dropped = asyncio.Event()
        first = hub.join(Role.PARTICIPANT)
        first.drop = dropped.set
        hub.join(Role.PARTICIPANT)
        assert hub.make_room(Role.PARTICIPANT) == ""
        assert first.ended and first not in hub.sessions
        await asyncio.wait_for(dropped.wait(), 10.0)
        return True

    assert asyncio.run(made())


def test_a_command_is_answered_with_what_the_nodes_said(rig: Rig, client: TestClient, stack: ExitStack) -> None:
    page = Page(stack, client)
    good = page.ask(**command(parameters={"law": "wave"}))
    assert (good["ok"], good["text"]) == (True, "controller@master: set; controller@slave: x")
    assert page.ask(**command(parameters={"x": -1}))["ok"] is False
    assert page.ask(**command(target="nobody"))["text"] == "no node is meant by target 'nobody'"
    assert rig.commander.sent[0] == ("set", "controller", {"law": "wave"})


def test_an_observer_commands_nothing(rig: Rig, client: TestClient, stack: ExitStack) -> None:
    page = Page(stack, client, ACCESS.observer_token)
    for request in (command(), {"k": "transport", "action": "play", "value": 0}, {"k": "lease", "action": "ask"}):
        assert "observer" in page.ask(**request)["text"]
    page.send({"k": "hand", "force_n": 1.0, "held": True})
    assert page.take("hand")["held"] is False
    assert (rig.commander.sent, rig.hand) == ([], [])
    # anybody who sees the tip may stop it
    assert page.ask(k="estop")["ok"] is True
    assert rig.hub.desk.refused.rejected == {"role": 4}


def test_an_emergency_stop_does_not_wait_for_the_command_before_it_and_ends_it(
    rig: Rig, client: TestClient, stack: ExitStack
) -> None:
    page = Page(stack, client)
    rig.commander.held.clear()
    page.send({"id": "slow", **command()})
    page.send({"k": "estop", "id": "stop"})
    # neither waits for the other, so either may come first
    answers = {answer.pop("id"): answer for answer in (page.take("answer"), page.take("answer"))}
    assert answers == {
        "stop": {"k": "answer", "ok": True, "text": "afm_node@slave: latched"},
        "slow": {"k": "answer", "ok": False, "text": "set was given up"},
    }


def test_an_emergency_stop_empties_the_queues_of_all_pages(rig: Rig, client: TestClient, stack: ExitStack) -> None:
    first, second = Page(stack, client), Page(stack, client)
    rig.commander.held.clear()
    first.send({"id": "begun", **command()})
    until(lambda: rig.commander.begun)
    first.send({"id": "waits", **command(command="arm", target="afm_node")})
    second.send({"id": "other", **command(command="mark", target="recorder")})
    until(lambda: len(rig.hub.commands.wishes) == 3)
    stopper = Page(stack, client)
    assert stopper.ask(k="estop")["ok"] is True
    until(lambda: not rig.hub.commands.wishes)
    rig.commander.held.set()
    for page, number in ((first, 2), (second, 1)):
        for _ in range(number):
            assert page.take("answer")["ok"] is False
    assert rig.commander.sent == [("estop",)]
    # what is asked for afterwards is carried out
    assert first.ask(**command(command="arm"))["ok"] is True


def test_any_command_of_a_page_ends_a_tip_that_goes_back_and_no_other_command(
    rig: Rig, client: TestClient, stack: ExitStack
) -> None:
    goes, other = Page(stack, client), Page(stack, client)
    for word, is_ended in (({"place_m": 0.0, "speed_m_per_s": 5e-8}, True), ({}, False)):
        rig.commander.held.clear()
        begun = len(rig.commander.begun)
        goes.send({"id": "goes", **command(command="arm", target="*", parameters=word)})
        until(lambda begun=begun: len(rig.commander.begun) > begun)
        other.send({"id": "other", **command(command="mark", target="recorder")})
        if is_ended:
            assert goes.take("answer")["ok"] is False
        else:
            until(lambda: len(rig.hub.commands.wishes) == 2)
        rig.commander.held.set()
        if not is_ended:
            assert goes.take("answer")["ok"] is True
        assert other.take("answer")["ok"] is True


def test_a_page_that_leaves_takes_its_commands_with_it_and_leaves_those_of_others(
    rig: Rig, client: TestClient, stack: ExitStack
) -> None:
    stays = Page(stack, client)
    rig.commander.held.clear()
    with ExitStack() as short:
        leaves = Page(short, client)
        leaves.send({"id": "begun", **command()})
        until(lambda: rig.commander.begun)
        leaves.send({"id": "waits", **command(command="arm", target="afm_node")})
        stays.send({"id": "stays", **command(command="mark")})
        until(lambda: len(rig.hub.commands.wishes) == 3)
    until(lambda: rig.commander.begun == ["set", "mark"])
    rig.commander.held.set()
    assert stays.take("answer")["ok"] is True
    assert [sent[0] for sent in rig.commander.sent] == ["mark"]


def test_a_stop_is_obeyed_whoever_leaves_and_whatever_comes_after_it(
    rig: Rig, client: TestClient, stack: ExitStack
) -> None:
    rig.commander.held.clear()
    with ExitStack() as short:
        leaves = Page(short, client)
        leaves.send({"id": "a", **command(command="stop")})
        until(lambda: rig.commander.begun)
        assert leaves.ask(k="estop")["ok"] is True
    rig.commander.held.set()
    until(lambda: [sent[0] for sent in rig.commander.sent] == ["estop", "stop"])


def test_a_page_queues_a_few_commands_and_is_told_when_there_are_more(
    rig: Rig, client: TestClient, stack: ExitStack
) -> None:
    page = Page(stack, client)
    rig.commander.held.clear()
    for i in range(command_desk.MOST_COMMANDS + 1):
        page.send({"id": f"c-{i}", **command()})
    refused = page.take("answer")
    assert (refused["id"], refused["ok"]) == ("c-4", False)
    assert "4 commands of this page wait already" in refused["text"]
    rig.commander.held.set()
    assert [page.take("answer")["ok"] for _ in range(4)] == [True] * 4


def asked(rig: Rig, name: str, arrived_s: float) -> dict[str, Any]:
    """Return the answer to a command that arrived at a time [s]."""
    session = Session(server.Role.OPERATOR)
    rig.hub.sessions.add(session)
    request = CommandRequest("a", name, "controller", {})
    asyncio.run(rig.hub.handle(session, request, arrived_s))
    answer: dict[str, Any] = msgpack.unpackb(session._answers.pop())
    return answer


def test_a_command_that_waited_for_longer_than_it_is_valid_is_refused_and_a_stop_is_not(
    rig: Rig, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(command_desk, "VALIDITY_S", 1.0)
    now_s = 50.0
    monkeypatch.setattr(hubs.time, "monotonic", lambda: now_s)
    assert asked(rig, "arm", now_s - command_desk.VALIDITY_S)["ok"] is True
    answer = asked(rig, "arm", now_s - command_desk.VALIDITY_S - 0.1)
    assert (answer["ok"], answer["text"][:12]) == (False, "arm expired:")
    assert asked(rig, "stop", now_s - 60.0)["ok"] is True


def test_what_may_have_waited_while_the_server_stood_still_is_refused(
    rig: Rig, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(command_desk, "VALIDITY_S", 1.0)
    now_s = 50.0
    monkeypatch.setattr(hubs.time, "monotonic", lambda: now_s)
    rig.hub.tick()
    now_s += 3.0
    # it was received only now, whenever it was sent
    answer = asked(rig, "arm", now_s)
    assert "the view was held up for 3.0 s" in answer["text"]
    assert asked(rig, "stop", now_s)["ok"] is True
    for _ in range(20):
        now_s += 0.1
        rig.hub.tick()
    assert asked(rig, "arm", now_s)["ok"] is True


@pytest.mark.parametrize(
    ("kind", "words", "is_refused"),
    [
        ("refused", "refused", True),
        ("kept", "kept for it", False),
        ("absent", "absent", False),
        ("unreached", "out of reach", False),
    ],
)
def test_a_node_that_has_not_acknowledged_is_given_with_what_it_did_instead(
    rig: Rig, monkeypatch: pytest.MonkeyPatch, kind: str, words: str, is_refused: bool
) -> None:
    answers = {"afm_node@slave": (kind, "so it is"), "haptic_node@master": ("ack", "latched")}
    monkeypatch.setattr(rig.commander, "send", lambda *given: answers)
    answer = asked(rig, "set", time.monotonic())
    assert (answer["ok"], answer.get("refused", True)) == (False, is_refused)
    assert answer["text"] == f"afm_node@slave {words}: so it is; haptic_node@master acknowledged: latched"


def test_who_holds_the_key_down_stops_a_few_times_and_once_more(rig: Rig, monkeypatch: pytest.MonkeyPatch) -> None:
    answering = threading.Event()
    begun: list[int] = []

    def estop(by: str) -> dict[str, tuple[str, str]]:
        begun.append(1)
        answering.wait(5.0)
        return {"afm_node@slave": ("ack", "latched")}

    monkeypatch.setattr(rig.commander, "estop", estop)
    session = Session(server.Role.OPERATOR)

    async def press() -> None:
        asking = [asyncio.create_task(rig.hub.handle(session, EstopRequest(str(i)), 0.0)) for i in range(50)]
        while len(begun) < command_desk._MOST_STOPS:
            await asyncio.sleep(0.002)
        answering.set()
        await asyncio.gather(*asking)

    asyncio.run(press())
    assert len(begun) == command_desk._MOST_STOPS + 1
    assert all(msgpack.unpackb(frame)["ok"] for frame in session._answers)
    assert len(session._answers) == 50


def test_who_asked_for_an_emergency_stop_is_told_whatever_kept_it_from_being_sent(
    rig: Rig, client: TestClient, stack: ExitStack, monkeypatch: pytest.MonkeyPatch
) -> None:
    def estop(by: str) -> dict[str, tuple[str, str]]:
        raise OSError(24, "Too many open files")

    monkeypatch.setattr(rig.commander, "estop", estop)
    answer = Page(stack, client).ask(k="estop")
    assert (answer["ok"], "Too many open files" in answer["text"]) == (False, True)


def test_a_running_rig_has_no_transport(client: TestClient, stack: ExitStack) -> None:
    assert "only a recording" in Page(stack, client).ask(k="transport", action="seek", value=1)["text"]


def push(page: Page, force_n: float, held: bool = True) -> None:
    page.send({"k": "hand", "force_n": force_n, "held": held})


def changes(rig: Rig) -> list[float]:
    """Return the forces at the haptic node without their repetitions."""
    return [force for force, _ in groupby(rig.hand)]


def test_one_page_holds_the_hand_until_it_lets_go(
    rig: Rig, client: TestClient, stack: ExitStack, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(page_hand, "HAND_FRESH_S", 60.0)
    first, second = Page(stack, client), Page(stack, client)
    push(first, 1.5)
    until(lambda: changes(rig) == [1.5])
    push(second, 9.0)
    assert second.take("hand")["text"] == "window A holds control: ask for it"
    push(first, 0.0, held=False)
    until(lambda: changes(rig) == [1.5, 0.0])
    push(second, 2.0)
    until(lambda: changes(rig) == [1.5, 0.0, 2.0])


def test_a_window_that_asks_gets_control_when_the_other_one_has_done_and_each_has_a_letter(
    rig: Rig, client: TestClient, stack: ExitStack, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(page_hand, "HAND_FRESH_S", 60.0)
    pages = [Page(stack, client) for _ in range(2)]
    snapshots = [page.take("snapshot") for page in pages]
    assert [each["window"] for each in snapshots] == ["A", "B"]
    push(pages[0], 1.5)
    until(lambda: changes(rig) == [1.5])
    asked = pages[1].ask(k="lease", action="ask")
    assert asked["text"] == "lease: window A holds control"
    assert asked["lease"]["asking"] == [[snapshots[1]["me"], "window B"]]
    push(pages[0], 0.0, held=False)
    until(lambda: rig.hub.desk.lease.holder is not None and rig.hub.desk.lease.holder.label == "window B")
    # A window that is loaded again has the letter that it had, and asks for nothing.
    pages[0].socket.close()
    until(lambda: len(rig.hub.sessions) == 1)
    assert Page(stack, client).take("snapshot")["window"] == "A"
    assert rig.hub.desk.lease.asking == ()


def test_the_hand_of_a_page_that_falls_silent_or_closes_is_let_go(
    rig: Rig, client: TestClient, stack: ExitStack
) -> None:
    silent = Page(stack, client)
    push(silent, 1.0)
    until(lambda: changes(rig)[-1:] == [0.0])
    assert changes(rig) == sorted(changes(rig), reverse=True)
    assert changes(rig)[0] == 1.0
    # who pressed and has vanished has the tip withdrawn, and the hand is anybody's
    until(lambda: [each[:2] for each in rig.commander.sent] == [("stop", "afm_node@slave")])
    with ExitStack() as short:
        push(Page(short, client), 2.0)
        until(lambda: 2.0 in rig.hand)
    until(lambda: rig.hand[-1] == 0.0)
    until(lambda: len(rig.commander.sent) == 2)


@pytest.mark.parametrize("request_", [HandRequest(force_n=1.0, held=True), LeaseRequest(id="x", action="take")])
def test_what_is_read_of_a_page_that_has_left_gives_the_hand_to_nobody(rig: Rig, request_: Any) -> None:
    async def late() -> None:
        session = rig.hub.join(Role.OPERATOR)
        rig.hub.leave(session)
        await rig.hub.handle(session, request_, time.monotonic())

    asyncio.run(late())
    assert rig.hub.desk.lease.holder is None and not any(rig.hand)


def test_a_page_that_pauses_for_a_moment_keeps_its_force(
    rig: Rig, client: TestClient, stack: ExitStack, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(page_hand, "HAND_FRESH_S", 60.0)
    push(Page(stack, client), 1.5)
    until(lambda: rig.hand[:4] == [1.5] * 4)
    # the haptic node lets go when it hears nothing for longer than two of these
    assert InteractiveConfig(kind="interactive").force_deadline_s / 2 > hubs.TICK_S


def test_a_server_that_stood_still_does_not_take_that_for_silence_of_the_page(
    rig: Rig, monkeypatch: pytest.MonkeyPatch
) -> None:
    now_s = 50.0
    monkeypatch.setattr(hubs.time, "monotonic", lambda: now_s)
    rig.hub._push(Session(server.Role.OPERATOR), HandRequest(1.5, True))
    now_s += 20.0 * page_hand.HAND_FADE_S
    rig.hub.tick()
    assert changes(rig) == [1.5]
    for _ in range(20):
        now_s += hubs.TICK_S
        rig.hub.tick()
    assert changes(rig)[0] == 1.5
    assert changes(rig)[-1] == 0.0


def test_the_force_of_a_silent_page_fades_and_comes_back_as_slowly(rig: Rig, monkeypatch: pytest.MonkeyPatch) -> None:
    now_s = 50.0
    monkeypatch.setattr(hubs.time, "monotonic", lambda: now_s)
    session = Session(server.Role.OPERATOR)
    forces: list[tuple[float, float]] = []

    def go_on(until_s: float, frames: bool) -> None:
        nonlocal now_s
        while now_s < until_s:
            now_s += hubs.TICK_S
            if frames:
                rig.hub._push(session, HandRequest(2.0, True, across_x_n=1.0))
            rig.hub.tick()
            forces.append((now_s, rig.hand[-1][0] if isinstance(rig.hand[-1], tuple) else rig.hand[-1]))

    go_on(51.0, frames=True)
    assert {force for _, force in forces} == {2.0}
    go_on(51.3, frames=False)
    faded = [force for _, force in forces if force < 2.0]
    # Never more than what passes in a tick of the time in which it fades.
    most = 2.0 * hubs.TICK_S / page_hand.HAND_FADE_S + 1e-9
    steps = [abs(after - before) for (_, before), (_, after) in pairwise(forces)]
    assert max(steps) <= most
    assert 0.0 < faded[-1] < 1.0
    go_on(52.0, frames=True)
    steps = [abs(after - before) for (_, before), (_, after) in pairwise(forces)]
    assert max(steps) <= most
    assert forces[-1][1] == 2.0
    # It is nothing after the fresh time and the fading.
    go_on(52.0 + page_hand.HAND_FRESH_S + page_hand.HAND_FADE_S + 2 * hubs.TICK_S, frames=False)
    assert forces[-1][1] == 0.0
    told = [msgpack.unpackb(frame) for frame in session._answers]
    late = [frame["late_s"] for frame in told if frame["k"] == "hand"]
    assert [late_s > page_hand.HAND_FRESH_S for late_s in late] == [True, False, True]


def test_a_force_that_waited_or_was_overtaken_is_dropped_and_counted_and_a_hand_is_let_go_at_any_age(
    rig: Rig, monkeypatch: pytest.MonkeyPatch
) -> None:
    now_s = 50.0
    monkeypatch.setattr(hubs.time, "monotonic", lambda: now_s)
    session = Session(server.Role.OPERATOR)
    # The clock of the page is another one.
    rig.hub._push(session, HandRequest(1.0, True, number=1, stamp_s=7.0))
    now_s = 50.2
    rig.hub._push(session, HandRequest(2.0, True, number=2, stamp_s=7.15))
    assert rig.hand == [1.0, 2.0 * rig.hub.hand.share]
    pushed = len(rig.hand)
    rig.hub._push(session, HandRequest(3.0, True, number=3, stamp_s=7.05))
    rig.hub._push(session, HandRequest(4.0, True, number=2, stamp_s=7.2))
    assert len(rig.hand) == pushed
    assert rig.hub.desk.refused.rejected == {"late": 2}
    rig.hub._push(session, HandRequest(0.0, held=False, number=1, stamp_s=0.1))
    assert rig.hand[-1] == 0.0
    (frame,) = [msgpack.unpackb(frame) for frame in session._answers]
    assert frame == {"k": "hand", "held": True, "text": "", "late_s": pytest.approx(0.15)}


@pytest.mark.parametrize("role", Role)
def test_a_force_of_an_operator_that_counts_is_answered_with_the_newest_that_is_felt_and_its_age(
    rig: Rig, role: Role
) -> None:
    session = Session(role)

    def answered(number: int, stamp_s: float) -> list[dict[str, Any]]:
        session._answers.clear()
        rig.hub._push(session, HandRequest(1.0, True, number=number, stamp_s=stamp_s))
        frames = [msgpack.unpackb(frame) for frame in session._answers]
        return [frame for frame in frames if frame["k"] == "felt"]

    assert answered(1, 7.0) == []
    for sent_ns, felt_n in ((4_000_000_000, 1.0), (5_000_000_000, -2.5)):
        command = examples(TOPICS["haptic/command"])["ordinary"]
        said = msgspec.structs.replace(command, t_ns=sent_ns, src="controller@master", force_n=(0.5, 0.25, felt_n))
        rig.source.waiting.append(seen("haptic/command", said.src, sent_ns, said))
    felt = {"k": "felt", "force_n": -2.5, "age_s": 0.25, "number": 3, "stamp_s": 7.1}
    assert answered(3, 7.1) == ([felt] if role is Role.OPERATOR else [])
    # One that was overtaken, and one that cannot be told from others by its time, are not.
    assert answered(2, 7.1) == []
    assert answered(4, 0.0) == []


def test_the_server_ends_with_a_source_that_cannot_be_read(
    rig: Rig, page: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    ended: list[int] = []
    rig.hub.on_end = lambda: ended.append(1)

    def broken(*, watched: bool) -> list[SeenMessage]:
        raise RigError("session.mcap: cannot be read any more")

    monkeypatch.setattr(rig.source, "poll", broken)
    with TestClient(server.make_app(rig.hub, ACCESS, page), client=("127.0.0.1", 5)) as client:
        client.get("/health")
        until(lambda: ended)
    assert str(rig.hub.fault) == "session.mcap: cannot be read any more"


def test_a_hand_that_pushes_without_end_is_passed_on_no_faster_than_a_page_may_ask(
    rig: Rig, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(hubs.time, "monotonic", lambda: 50.0)
    session = Session(server.Role.OPERATOR)
    for i in range(1000):
        rig.hub._push(session, HandRequest(float(i), True))
    assert rig.hand == [float(i) for i in range(200)]


def test_a_page_that_does_not_read_holds_up_nobody_and_begins_anew(rig: Rig) -> None:
    slow, quick = Session(server.Role.OBSERVER), Session(server.Role.OBSERVER)
    rig.hub.sessions = {slow, quick}
    for i in range(MOST_QUEUED + 1):
        fields = {"kind": "mode", "level": "info", "text": str(i), "seq": i, "data": {}}
        rig.source.waiting.append(SeenMessage("session/event", "afm_node@slave", 10**18, fields))
        rig.hub.tick()
        quick._frames.clear()
    assert len(slow._frames) == 1
    snapshot = msgpack.unpackb(slow._frames[0])
    assert (snapshot["k"], snapshot["events"][-1]["text"]) == ("snapshot", str(MOST_QUEUED))


def test_an_answer_is_not_dropped_with_what_a_page_has_not_read(rig: Rig) -> None:
    session = Session(server.Role.OPERATOR)
    rig.hub.sessions = {session}
    for i in range(2 * MOST_QUEUED):
        fields = {"kind": "mode", "level": "info", "text": str(i), "seq": i, "data": {}}
        rig.source.waiting.append(SeenMessage("session/event", "afm_node@slave", 10**18, fields))
        rig.hub.tick()
        if i in (MOST_QUEUED // 2, MOST_QUEUED):
            # one before the page begins anew, one while no more changes fit in
            asyncio.run(rig.hub.handle(session, CommandRequest(str(i), "arm", "controller", {}), time.monotonic()))
    frames = [msgpack.unpackb(asyncio.run(asyncio.wait_for(session.next_frame(), 5.0))) for _ in range(3)]
    assert [frame.get("id") for frame in frames[:2]] == [str(MOST_QUEUED // 2), str(MOST_QUEUED)]
    assert all(frame["ok"] for frame in frames[:2])
    assert frames[2]["k"] == "snapshot"


class ShortDocument:
    """A recording of ten seconds that holds whoever reads in it, as long as it is held itself."""

    def __init__(self) -> None:
        self.held = threading.Event()
        self.held.set()

    def about(self) -> Mapping[str, Any]:
        return {"length_s": 10.0, "read": 1.0}

    def part(self, from_s: float, to_s: float, spans: int) -> Mapping[str, Any]:
        self.held.wait(20.0)
        return {"from_s": from_s, "to_s": to_s, "width_s": 0.0, "streams": {}}


def test_who_only_looks_may_read_in_a_recording(page: Path, stack: ExitStack) -> None:
    hub = Hub(MadeSource(), document=ShortDocument())
    client = stack.enter_context(TestClient(server.make_app(hub, ACCESS, page), client=("127.0.0.1", 5)))
    observer = Page(stack, client, ACCESS.observer_token)
    assert observer.ask(k="document")["found"]["length_s"] == 10.0
    assert observer.ask(k="part", from_s=1.0, to_s=2.0, spans=100)["found"]["to_s"] == 2.0


def test_a_running_rig_is_no_document(client: TestClient, stack: ExitStack) -> None:
    answer = Page(stack, client).ask(k="document")
    assert (answer["ok"], "only a recording can be read in parts" in answer["text"]) == (False, True)


def test_no_more_parts_are_read_at_once_than_may_be(page: Path, stack: ExitStack) -> None:
    document = ShortDocument()
    hub = Hub(MadeSource(), document=document)
    client = stack.enter_context(TestClient(server.make_app(hub, ACCESS, page), client=("127.0.0.1", 5)))
    reader = Page(stack, client)
    document.held.clear()
    for number in range(read_desk._MOST_READS + 1):
        reader.send({"k": "part", "id": f"a-{number}", "from_s": 0.0, "to_s": 1.0, "spans": 10})
    refused = reader.take("answer")
    assert (refused["ok"], "are already being read" in refused["text"]) == (False, True)
    document.held.set()
    assert all(reader.take("answer")["ok"] for _ in range(read_desk._MOST_READS))
