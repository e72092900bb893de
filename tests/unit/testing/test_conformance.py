"""The kit finds nothing wrong in a client that is written from the specification, and names each mistake of another."""

import json
import math
import subprocess
import sys
import threading
import time
import tracemalloc
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import msgpack
import pytest
import spec_client
import zmq
import zmq.auth.thread

from telenano.testing.conformance import examination
from telenano.testing.conformance.answers_of_client import AnswersOfClient
from telenano.testing.conformance.client_messages import MessageExaminer
from telenano.testing.conformance.commands_of_client import LATCH, CommandsOfClient
from telenano.testing.conformance.examination import Keys, examine
from telenano.testing.conformance.rules import RULES, Account
from telenano.wire import ConfigError

NOW_NS = 1_767_225_600_000_000_000
_MS = 1_000_000
_S = 1_000_000_000
VECTORS = json.loads((spec_client.CONTRACT / "golden" / "vectors.json").read_text(encoding="utf-8"))
SCHEMAS = spec_client.schemas()
Frames = list[bytes]


def fields_of(topic: str, **changes: Any) -> dict[str, Any]:
    """Return the fields of the ordinary example of a topic, with some changes."""
    [hexadecimal] = [row["hex"] for row in VECTORS if (row["topic"], row["case"]) == (topic, "ordinary")]
    fields: dict[str, Any] = msgpack.unpackb(bytes.fromhex(hexadecimal))
    return fields | changes


def course(topic: str, count: int = 4, step_ns: int = _MS) -> Iterator[tuple[dict[str, Any], int]]:
    """Yield the fields of some messages of a topic, and when each comes."""
    for number in range(count):
        t_ns = NOW_NS + number * step_ns
        yield fields_of(topic, seq=number, t_ns=t_ns), t_ns


def outcomes(account: Account) -> dict[str, tuple[str, str]]:
    return {found.rule: (found.outcome, found.seen) for found in account.findings()}


def judged(sent: list[tuple[Frames, int]]) -> dict[str, tuple[str, str]]:
    """Return what the kit says of frames that come at some times."""
    account = Account()
    examiner = MessageExaminer(account)
    for frames, now_ns in sent:
        examiner.take(frames, now_ns)
    examiner.end(sent[-1][1])
    return outcomes(account)


def broken(found: dict[str, tuple[str, str]]) -> set[str]:
    return {rule for rule, (outcome, _) in found.items() if outcome == "failed"}


def test_every_topic_as_the_specification_has_it_breaks_no_rule() -> None:
    for topic in {row["topic"] for row in VECTORS}:
        found = judged([(spec_client.write(topic, **fields), now_ns) for fields, now_ns in course(topic)])
        assert not broken(found), topic
        assert found["types"][0] == found["sequence"][0] == found["version"][0] == "passed"


# The mistakes of a client in one message: the topic, what it does with the fields, the rule, and what is said.
FIELDS: dict[str, tuple[str, Callable[[dict[str, Any]], object], str, str]] = {
    "a key is missing": ("afm/state", lambda f: f.pop("limited"), "required keys", "afm/state: limited is missing"),
    "a key is misspelled": (
        "afm/state",
        lambda f: f.update(limitd=True),
        "further keys",
        "limitd is not known",
    ),
    "a number is text": (
        "afm/state",
        lambda f: f.update(deflection_m="1e-9"),
        "types",
        "'1e-9', must be float",
    ),
    "a flag is a number": ("afm/state", lambda f: f.update(limited=1), "types", "limited is 1, must be bool"),
    "a vector has two numbers": ("afm/state", lambda f: f.update(tip_force_n=[0.0, 0.0]), "types", "tip_force_n"),
    "text is bytes": ("session/event", lambda f: f.update(text=b"held"), "types", "text is b'held', must be str"),
    "bytes are text": (
        "afm/scanline",
        lambda f: f["height_m"].update(data="\0" * len(f["height_m"]["data"])),
        "types",
        "must be bytes",
    ),
    "an array does not fill its shape": (
        "afm/scanline",
        lambda f: f["height_m"].update(shape=[7]),
        "types",
        "shape [7]",
    ),
    "an integer is a float": ("afm/state", lambda f: f.update(command_seq=1.0), "types", "command_seq"),
    "a later version": ("afm/state", lambda f: f.update(v=9), "version", "version 9 from"),
    "the next version": ("session/event", lambda f: f.update(v=2), "version", "version 2 from"),
    "nanometres": (
        "afm/state",
        lambda f: f.update(deflection_m=25.0),
        "ranges",
        "25.0, must be -10 to 10 m",
    ),
    "not a number": ("afm/state", lambda f: f.update(deflection_m=math.nan), "ranges", "finite"),
    "a word that is not known": ("afm/state", lambda f: f.update(mode="flying"), "words", "'flying'"),
    "a source without its site": ("afm/state", lambda f: f.update(src="afm_node"), "words", "src"),
    "another publisher": (
        "afm/state",
        lambda f: f.update(src="console@master"),
        "publisher",
        "console@master sends on afm/state, which is for afm_node",
    ),
    "time in ms": ("afm/state", lambda f: f.update(t_ns=f["t_ns"] // _MS), "clock", "which is a time in ms"),
    "time in us": ("afm/state", lambda f: f.update(t_ns=f["t_ns"] // 1000), "clock", "which is a time in us"),
    "time in s": ("afm/state", lambda f: f.update(t_ns=f["t_ns"] // _S), "clock", "which is a time in s"),
    "time since the start": ("afm/state", lambda f: f.update(t_ns=5 * _S), "clock", "behind the clock"),
    "a clock ahead": ("afm/state", lambda f: f.update(t_ns=f["t_ns"] + 5 * _S), "clock", "5.000 s ahead of"),
    "time goes back": ("afm/state", lambda f: f.update(t_ns=f["t_ns"] - 500 * _MS), "order of time", "back by 0.499"),
    "seq goes back": ("afm/state", lambda f: f.update(seq=0), "sequence", "seq 2 goes back to 0"),
    "seq comes again": ("afm/state", lambda f: f.update(seq=2), "sequence", "seq 2 comes again"),
    "seq skips": ("afm/state", lambda f: f.update(seq=9), "sequence", "6 missing between 2 and 9"),
    "a header of text": ("afm/state", lambda f: f.update(seq="3"), "types", "seq"),
}


@pytest.mark.parametrize("name", FIELDS)
def test_a_mistake_in_a_message_is_named(name: str) -> None:
    topic, change, rule, said = FIELDS[name]
    sent = []
    for fields, now_ns in course(topic):
        if fields["seq"] == 3:
            change(fields)
        sent.append((spec_client.write(topic, **fields), now_ns))
    found = judged(sent)
    assert found[rule][0] == "failed"
    assert said in found[rule][1]
    # time that is in another unit goes back as well
    assert broken(found) <= {rule, "order of time"}


def _twice(frames: Frames) -> Frames:
    pair = msgpack.packb("seq") + msgpack.packb(3)
    count = len(msgpack.unpackb(frames[1]))
    return [frames[0], frames[1].replace(b"\xde" + count.to_bytes(2), b"\xde" + (count + 1).to_bytes(2), 1) + pair]


# The mistakes of a client in the frames.
FRAMES: dict[str, tuple[Callable[[Frames], Frames], str, str]] = {
    "one frame": (lambda frames: [b"".join(frames)], "frames", "a message has 1 frame"),
    "three frames": (lambda frames: [*frames, b""], "frames", "a message has 3 frames"),
    "the frames in the other order": (lambda frames: frames[::-1], "frames", "the topic afm/state comes behind it"),
    "a topic of its own": (lambda frames: [b"afm/wobble", frames[1]], "topic", "b'afm/wobble' is not in the table"),
    "a topic with a prefix": (lambda frames: [b"/afm/state", frames[1]], "topic", "b'/afm/state' is not in the table"),
    "a topic in UTF-16": (lambda frames: [frames[0].decode().encode("utf-16"), frames[1]], "topic", "not in the table"),
    "two topics mixed up": (
        lambda frames: [b"haptic/state", frames[1]],
        "topic",
        "on haptic/state comes a message with the keys of afm/state",
    ),
    "JSON": (
        lambda frames: [frames[0], json.dumps({"seq": 3}).encode()],
        "msgpack",
        "a msgpack int, must be a map",
    ),
    "a list": (lambda frames: [frames[0], msgpack.packb([3, NOW_NS])], "msgpack", "must be a map"),
    "a key twice": (_twice, "msgpack", "a map has a key twice"),
    "a timestamp of msgpack": (
        lambda frames: [frames[0], msgpack.packb(msgpack.unpackb(frames[1]) | {"t_ns": msgpack.Timestamp(1, 0)})],
        "types",
        "t_ns is",
    ),
    "too many bytes": (
        lambda frames: [frames[0], msgpack.packb(msgpack.unpackb(frames[1]) | {"mode": "x" * 5000})],
        "size",
        "at most 4096 are allowed",
    ),
}


@pytest.mark.parametrize("name", FRAMES)
def test_a_mistake_in_the_frames_is_named(name: str) -> None:
    change, rule, said = FRAMES[name]
    sent = [(spec_client.write("afm/state", **fields), now_ns) for fields, now_ns in course("afm/state")]
    sent[-1] = (change(sent[-1][0]), sent[-1][1])
    found = judged(sent)
    assert found[rule][0] == "failed"
    assert said in found[rule][1]
    assert broken(found) == {rule}


def answered(command: str) -> Frames:
    """Return the answer of a hand to a command."""
    data = {"command": command}
    event = fields_of("session/event", seq=0, t_ns=NOW_NS, src="haptic_node@master", kind="ack", data=data)
    return spec_client.write("session/event", **event)


@pytest.mark.parametrize(
    ("acknowledged", "fields", "seen"),
    [
        ("arm", {"armed": True}, ""),
        ("estop", {"armed": False, "estop": True}, ""),
        ("arm", {"armed": False}, "has acknowledged an arm, and does not say that it is armed"),
        ("arm", {}, "has acknowledged an arm, and does not say that it is armed"),
        ("estop", {"armed": True}, "is armed in emergency stop"),
        ("arm", {"armed": True, "estop": True}, "is armed in emergency stop"),
    ],
)
def test_a_stand_in_for_the_hand_says_that_it_is_armed_when_it_is(
    acknowledged: str, fields: dict[str, Any], seen: str
) -> None:
    said = [fields_of("haptic/state", seq=number, t_ns=NOW_NS + number * _MS) for number in range(3)]
    states = [
        spec_client.write("haptic/state", **{**{"estop": False}, **each, "estop": False, **fields}) for each in said
    ]
    found = judged([(answered(acknowledged), NOW_NS), *((frames, NOW_NS) for frames in states)])["armed hand"]
    assert found[0] == ("failed" if seen else "passed" if fields["armed"] else "not seen")
    assert seen in found[1]


def test_a_controller_takes_no_hand_for_armed_that_did_not_say_so() -> None:
    account = Account()
    examiner = MessageExaminer(account, is_hand=True)
    for number in range(2):
        fields = fields_of("afm/command", seq=number, t_ns=NOW_NS + number, hand_armed=number == 1)
        examiner.take(spec_client.write("afm/command", **fields), NOW_NS)
    assert "the hand was never armed" in outcomes(account)["armed hand"][1]


def test_a_pause_and_a_node_without_health_are_named() -> None:
    sent = [(spec_client.write("afm/state", **fields), at) for fields, at in course("afm/state", step_ns=_S)]
    found = judged(sent)
    assert found["rate"] == ("failed", "afm/state of afm_node@slave pauses for 1.000 s, and is stale after 0.05 s")
    assert found["health"] == ("failed", "afm_node@slave sends no node/health")


@pytest.mark.parametrize(("told", "outcome"), [(4, "passed"), (3, "failed"), (None, "failed")])
def test_the_counts_of_the_last_message_are_compared(told: int | None, outcome: str) -> None:
    sent = [(spec_client.write("afm/state", **fields), at) for fields, at in course("afm/state")]
    counts = {"state": "ended", "sent.session/event": 1} | ({} if told is None else {"sent.afm/state": told})
    last = fields_of("session/event", seq=0, t_ns=NOW_NS, src="afm_node@slave", kind="node", data=counts)
    assert judged([*sent, (spec_client.write("session/event", **last), NOW_NS)])["last message"][0] == outcome


# --- commands, in the time of the test ---


def commanded(quote: bool = True, **mistakes: Any) -> dict[str, tuple[str, str]]:
    """Return what the kit says of a client that arms the instrument, sending it every 100 ms until it is taken."""
    account = Account()
    answered: list[dict[str, Any]] = []

    def answers(node: str, fields: dict[str, Any]) -> int:
        answered.append(fields | {"src": node, "t_ns": now_ns + 7})
        return now_ns + 7

    examiner = CommandsOfClient(account, answers)
    for step in range(300):
        now_ns = NOW_NS + step * 10 * _MS
        is_strict = mistakes.get("strict", False)
        is_taken = any(a["kind"] == "ack" and not (is_strict and "further_k" in a) for a in answered)
        if step % 10 == 0 and (not is_taken or mistakes.get("goes_on")) and not (step and mistakes.get("once")):
            quoted: dict[str, Any] = {}
            if answered and answered[0]["kind"] == "refused" and quote:
                node = answered[0]["src"]
                quoted = {"node_t_ns": {node: mistakes.get("told_ns", answered[0]["t_ns"])}}
                quoted["node_latch"] = {node: mistakes.get("latch", answered[0]["data"]["latch"])}
            parameters = {"step": step} if mistakes.get("changes") else {}
            t_ns = NOW_NS if mistakes.get("same_time") else now_ns
            frames = spec_client.command(step // 10, "a-1", "arm", "afm_node@slave", **parameters)
            examiner.take(spec_client.read(frames)[1] | quoted | {"t_ns": t_ns}, now_ns)
        examiner.tick(now_ns)
    return outcomes(account)


def test_a_client_that_commands_as_the_specification_says_breaks_no_rule() -> None:
    found = commanded()
    assert not broken(found)
    rules = ("identifiers", "repetition", "unknown keys", "end of repetition", "quoted clock", "quoted stop")
    assert {found[rule][0] for rule in rules} == {"passed"}


@pytest.mark.parametrize(
    ("mistakes", "rule", "said"),
    [
        ({"once": True}, "repetition", "a-1 has no answer for 0.5 s, and is not sent again"),
        ({"same_time": True}, "repetition", "a-1 comes again with the t_ns of before"),
        ({"strict": True}, "unknown keys", "the ack of a-1 was taken without further_k alone"),
        ({"goes_on": True}, "end of repetition", "a-1 is sent again after its ack"),
        ({"changes": True}, "identifiers", "the id a-1 is that of two commands"),
        ({"quote": False}, "quoted clock", "a-1 was refused by afm_node@slave, and does not come with node_t_ns"),
        ({"quote": False}, "quoted stop", "does not come with node_latch"),
        ({"told_ns": 1}, "quoted clock", "a-1 quotes 1 in node_t_ns"),
        ({"latch": "mine"}, "quoted stop", f"a-1 quotes mine in node_latch, and not {LATCH}"),
    ],
)
def test_a_mistake_in_commanding_is_named(mistakes: dict[str, Any], rule: str, said: str) -> None:
    found = commanded(**mistakes)
    assert found[rule][0] == "failed"
    assert said in found[rule][1]


def node(asked: dict[str, Any], age_ns: int, taken: dict[str, dict[str, Any]]) -> dict[str, Any] | None:
    """Return the answer of a node that refuses every mark, and each that is too old or has a key that is not known."""
    if asked["target"] != "afm_node@slave" or "dry_run" in asked:
        return None
    expired = age_ns > _S
    text = "it is too old" if expired else "this node knows no mark"
    answer = {"id": asked["id"], "kind": "refused", "text": text, "data": {"expired": True} if expired else {}}
    return taken.setdefault(asked["id"], answer)


Answering = Callable[[dict[str, Any], int, dict[str, dict[str, Any]]], dict[str, Any] | None]


def answering(answer: Answering, is_deaf_after: bool = False) -> dict[str, tuple[str, str]]:
    """Return what the kit says of a node that answers so."""
    account, taken, disturbed = Account(), dict[str, dict[str, Any]](), list[bool]()
    waiting: list[dict[str, Any]] = []

    def commands(asked: dict[str, Any], age_ns: int) -> None:
        found = answer(asked, age_ns, taken)
        if found is not None and not (disturbed and is_deaf_after):
            waiting.append(found)

    examiner = AnswersOfClient(account, commands, lambda: disturbed.append(True))
    examiner.begin("afm_node@slave", NOW_NS)
    for step in range(1000):
        while waiting:
            examiner.take(waiting.pop(0))
        examiner.tick(NOW_NS + step * 10 * _MS)
    assert examiner.done
    return outcomes(account)


def test_a_node_that_answers_as_the_specification_says_breaks_no_rule() -> None:
    found = answering(node)
    assert not broken(found)
    rules = ("answer", "same answer", "expired command", "unknown command key", "others' commands", "robustness")
    assert {found[rule][0] for rule in rules} == {"passed"}


@pytest.mark.parametrize(
    ("answer", "rule", "said"),
    [
        (lambda asked, age_ns, taken: None, "answer", "afm_node@slave does not answer a mark to it within 1 s"),
        (
            lambda asked, age_ns, taken: {"id": asked["id"], "kind": "mode", "text": "", "data": {}},
            "answer",
            "answers a mark by 'mode'",
        ),
        (
            lambda asked, age_ns, taken: {
                **(node(asked, age_ns, {}) or {}),
                "text": str(taken.update(x={}) or id(asked)),
            },
            "same answer",
            "at first, and then",
        ),
        (
            lambda asked, age_ns, taken: {"id": asked["id"], "kind": "ack", "text": "", "data": {}},
            "expired command",
            "a command that is 10 s old has the answer 'ack'",
        ),
        (
            lambda asked, age_ns, taken: {"id": asked["id"], "kind": "ack", "text": "", "data": {}},
            "unknown command key",
            "with the key dry_run is acknowledged",
        ),
        (
            lambda asked, age_ns, taken: {"id": asked["id"], "kind": "ack", "text": "", "data": {}, "src": "b@slave"},
            "others' commands",
            "a command to absent@slave is answered by b@slave",
        ),
    ],
)
def test_a_mistake_in_answering_is_named(answer: Answering, rule: str, said: str) -> None:
    found = answering(answer)
    assert found[rule][0] == "failed"
    assert said in found[rule][1]


def test_a_node_that_falls_silent_after_what_breaks_the_rules_is_named() -> None:
    assert answering(node, is_deaf_after=True)["robustness"][0] == "failed"


def test_an_emergency_stop_of_a_client_needs_no_last_message_and_its_node_does() -> None:
    examiner = MessageExaminer(Account())
    stop = {"src": "estop@master", "seq": 0, "t_ns": NOW_NS}
    examiner.take(spec_client.write("session/control", **fields_of("session/control", **stop)), NOW_NS)
    node_of = {"src": "afm_node@slave", "t_ns": NOW_NS}
    examiner.take(spec_client.write("node/health", **fields_of("node/health", seq=0, **node_of)), NOW_NS)
    assert not examiner.has_ended
    data = {"state": "ended", "sent.node/health": 1, "sent.session/event": 1}
    last = fields_of("session/event", seq=0, kind="node", data=data, **node_of)
    examiner.take(spec_client.write("session/event", **last), NOW_NS)
    assert examiner.has_ended


# --- over sockets ---


class Client:
    """A node and a console that are written from the specification, in one program.

    Args:
        folder: Where its endpoint is bound, beside the one of the kit, which it reads.
        in_ms: Whether it makes the mistake of sending times in ms.
        pair: Its keys for CURVE, with which it binds an endpoint of TCP; None for plain.
    """

    def __init__(self, folder: Path, *, in_ms: bool = False, pair: tuple[bytes, bytes] | None = None) -> None:
        self.kit = f"ipc://{folder}/kit"
        self._factor = _MS if in_ms else 1
        self._numbers: dict[tuple[str, str], int] = {}
        self._context = zmq.Context()
        self._publisher, self._reader = self._context.socket(zmq.PUB), self._context.socket(zmq.SUB)
        if pair is not None:
            self._publisher.curve_server, self._publisher.curve_secretkey = True, pair[1]
        self._publisher.bind("tcp://127.0.0.1:*" if pair else f"ipc://{folder}/client")
        self.address = self._publisher.getsockopt_string(zmq.LAST_ENDPOINT)
        for topic in (b"session/control", b"session/event"):
            self._reader.subscribe(topic)
        self._reader.connect(self.kit)
        self._ends = threading.Event()
        self._thread = threading.Thread(target=self._run)

    def __enter__(self) -> "Client":
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._ends.set()
        self._thread.join()
        for socket in (self._publisher, self._reader):
            socket.close(linger=0)
        self._context.term()

    def _send(self, topic: str, src: str, **fields: Any) -> None:
        seq = self._numbers.get((topic, src), 0)
        self._numbers[topic, src] = seq + 1
        whole = fields | {"seq": seq, "t_ns": time.time_ns() // self._factor, "src": src}
        self._publisher.send_multipart(spec_client.write(topic, **whole))

    def _run(self) -> None:
        taken: dict[str, dict[str, Any]] = {}
        quoted: dict[str, Any] = {}
        is_taken, due_s = False, 0.0
        health = {key: value for key, value in fields_of("node/health").items() if key not in ("seq", "t_ns", "src")}
        while not self._ends.is_set():
            while self._reader.poll(10):
                fields = _read(self._reader.recv_multipart())
                if fields is None:
                    continue
                if "command" in fields:
                    answer = node(fields, time.time_ns() - fields["t_ns"], taken)
                    if answer is not None:
                        self._send("session/event", "afm_node@slave", v=1, level="info", **answer)
                elif fields["id"] == "mine":
                    is_taken |= fields["kind"] == "ack"
                    if fields["kind"] == "refused":
                        quoted = {"validity_s": 5.0, "node_t_ns": {fields["src"]: fields["t_ns"]}}
                        quoted["node_latch"] = {fields["src"]: fields["data"]["latch"]}
            if time.monotonic() < due_s:
                continue
            due_s = time.monotonic() + 0.1
            self._send("node/health", "afm_node@slave", **health)
            if not is_taken:
                whole = {"v": 1, "id": "mine", "command": "arm", "target": "afm_node@slave", "parameters": {}} | quoted
                self._send("session/control", "console@master", **whole)


def _read(frames: list[bytes]) -> dict[str, Any] | None:
    """Return the fields of a message that a reader takes: of a version that it knows, with what its schema requires."""
    try:
        topic, fields = spec_client.read(frames)
        schema = SCHEMAS[topic]
    except (ValueError, TypeError, KeyError, AttributeError, msgpack.exceptions.UnpackException):
        return None
    return fields if "dry_run" not in fields and spec_client.conforms(fields, schema, schema) else None


@pytest.mark.check("examines a client for 6 s")
def test_a_client_of_the_specification_passes_over_sockets(tmp_path: Path) -> None:
    with Client(tmp_path) as client:
        findings = {found.rule: found for found in examine(client.address, client.kit, duration_s=6.0)}
    assert [found.line() for found in findings.values() if found.outcome == "failed"] == []
    unseen = {rule for rule, found in findings.items() if found.outcome == "not seen"}
    assert unseen == {"encryption", "strangers", "rate", "last message", "armed hand"}


@pytest.mark.check("examines a client for 1.5 s")
def test_the_command_names_the_mistake_of_a_client_and_fails(tmp_path: Path) -> None:
    # `telenano conformance` is the same function, whose options the documents are compared with
    command = [sys.executable, "-P", "-m", "telenano.testing.conformance", "--duration", "1.5"]
    with Client(tmp_path, in_ms=True) as client:
        command += ["--client", client.address, "--rig", client.kit]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 1
    [line] = [line for line in done.stdout.splitlines() if line.startswith("failed    clock")]
    assert "which is a time in ms. Right: t_ns is in ns since 1970" in line
    assert "SPEC.md" in line


@pytest.mark.check("examines a client for 1.5 s")
@pytest.mark.parametrize("keeps_list", [True, False])
def test_a_client_with_curve_is_read_and_has_to_refuse_strangers(tmp_path: Path, keeps_list: bool) -> None:
    server, own = zmq.curve_keypair(), zmq.curve_keypair()
    with Client(tmp_path, pair=server) as client:
        if keeps_list:
            allowed = tmp_path / "allowed"
            allowed.mkdir()
            (allowed / "kit.key").write_text(f'metadata\ncurve\n    public-key = "{own[0].decode()}"\n')
            authenticator = zmq.auth.thread.ThreadAuthenticator(client._context)
            authenticator.start()
            authenticator.configure_curve(domain="*", location=str(allowed))
        try:
            found = examine(client.address, duration_s=1.5, keys=Keys(server[0], *own))
        finally:
            if keeps_list:
                authenticator.stop()
    outcome = {each.rule: each.outcome for each in found}
    assert (outcome["connection"], outcome["encryption"]) == ("passed", "passed")
    assert outcome["strangers"] == ("passed" if keeps_list else "failed")


FLOOD = """
import os, sys, time, itertools, zmq
sys.path[:0] = {path!r}
import spec_client
from test_conformance import fields_of
fields = fields_of("afm/state")
kinds = {{
    "topics": lambda n: [b"topic/%d" % n, b"\\x80"],
    "sources": lambda n: spec_client.write("afm/state", **fields | {{"src": "afm_node%d@slave" % n}}),
    "crash": lambda n: None,
}}
# The kit must be slower than this, so that each message is there already.
sent = [kinds[{kind!r}](number) for number in range(3000)]
socket = zmq.Context().socket(zmq.XPUB)
socket.set_hwm(1000)
socket.bind({address!r})
socket.recv()
for number in range(100) if {kind!r} == "crash" else ():
    socket.send_multipart(spec_client.write("afm/state", **fields | {{"seq": number, "t_ns": time.time_ns()}}))
    time.sleep(0.01)
if {kind!r} == "crash":
    os._exit(9)
for frames in itertools.cycle(sent):
    socket.send_multipart(frames)
"""


@contextmanager
def flooding(kind: str, folder: Path) -> Iterator[str]:
    """Run a client that sends as fast as it can, in a process of its own; yield its address."""
    address = f"ipc://{folder}/flood"
    folders = [str(Path(__file__).parent), *filter(None, sys.path)]
    code = FLOOD.format(path=folders, address=address, kind=kind)
    client = subprocess.Popen([sys.executable, "-c", code])
    try:
        while not (folder / "flood").exists() and client.poll() is None:
            time.sleep(0.01)
        yield address
    finally:
        client.kill()
        client.wait()


@pytest.mark.check("a client that floods the kit in a process of its own, for seconds of the processor")
@pytest.mark.parametrize("kind", ["topics", "sources"])
def test_a_flood_ends_with_the_examination_and_is_named(kind: str, tmp_path: Path) -> None:
    with flooding(kind, tmp_path) as address:
        tracemalloc.start()
        begun_s = time.thread_time()
        found = {each.rule: each for each in examine(address, duration_s=20.0)}
        spent_s, grown = time.thread_time() - begun_s, tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
    assert "sends faster than it can be read" in found["pace"].seen
    # one second of reading, with what judges the rest
    assert spent_s < 3.0
    assert grown < 20e6


@pytest.mark.check("takes 1.3 s")
def test_no_more_of_a_client_waits_than_the_mark_says(tmp_path: Path) -> None:
    """ZeroMQ keeps what is not read yet in memory, with a mark of nought all of it."""
    address = f"ipc://{tmp_path}/client"
    with zmq.Context() as context:
        client = context.socket(zmq.PUB)
        client.set_hwm(0)
        client.bind(address)
        reader, monitor = examination._reader(context, address, None)
        end_s = time.monotonic() + 30.0
        while not reader.poll(10) and time.monotonic() < end_s:
            client.send(b"first")
        for _ in range(5 * examination._MOST_WAITING):
            client.send(bytes(10_000))
        # the time in which all of it would be handed over; what the client still has then goes with it
        time.sleep(1.0)
        client.close(linger=0)
        waiting = 0
        while reader.poll(200):
            reader.recv()
            waiting += 1
        reader.disable_monitor()
        for each in (reader, monitor):
            each.close(linger=0)
    # The buffers of the kernel hold some messages beside those of the mark.
    assert 0 < waiting < 1.5 * examination._MOST_WAITING


def test_what_a_client_makes_up_fills_no_memory() -> None:
    account = Account()
    examiner, commands = MessageExaminer(account), CommandsOfClient(account, None)
    fields = fields_of("session/control")
    for number in range(3000):
        account.fail("topic", f"the topic {number}")
        examiner._course("afm/state", fields_of("afm/state"), NOW_NS) if number == 0 else None
        if examiner._is_followed("afm/state", f"afm_node{number}@slave"):
            examiner._streams["afm/state", f"afm_node{number}@slave"] = examiner._streams["afm/state", "afm_node@slave"]
        commands.take(fields | {"id": str(number)}, NOW_NS)
    found = outcomes(account)
    assert "(and at least 997 more)" in found["topic"][1]
    assert len(examiner._streams) <= 1001 and "more than 1000 sources" in found["publisher"][1]
    assert len(commands._commands) == 1000 and "more than 1000 commands" in found["identifiers"][1]


@pytest.mark.check("a client in a process of its own")
def test_a_client_that_crashes_is_named_before_the_pause_that_follows(tmp_path: Path) -> None:
    with flooding("crash", tmp_path) as address:
        lines = [each for each in examine(address, duration_s=3.0) if each.outcome == "failed"]
    rules = [each.rule for each in lines]
    assert "the client was gone after" in lines[0].seen and rules[0] == "connection"
    assert rules.index("rate") > 0
    assert "pace" not in rules


def test_an_address_where_nobody_is_fails(tmp_path: Path) -> None:
    found = {each.rule: each for each in examine(f"ipc://{tmp_path}/nobody", duration_s=0.5)}
    assert found["connection"].outcome == found["frames"].outcome == "failed"
    assert "nothing came within 0.5 s" in found["frames"].line()


@pytest.mark.parametrize(
    ("client", "said"),
    [("tcp://127.0.0.1:5999", "is not encrypted: give --server-key"), ("nonsense", "is not an endpoint")],
)
def test_an_address_that_cannot_be_used_is_refused(client: str, said: str) -> None:
    with pytest.raises(ConfigError, match=said):
        examine(client)


def test_a_pair_that_cannot_be_read_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"none\.key_secret: cannot be read: No such file"):
        Keys.of("x" * 40, tmp_path / "none.key_secret")
    for text in ("no key", "curve\n    public-key"):
        (tmp_path / "text.key_secret").write_text(text)
        with pytest.raises(ConfigError, match="is not a file with a pair of keys"):
            Keys.of("x" * 40, tmp_path / "text.key_secret")


def test_the_rules_name_sections_of_the_specification() -> None:
    spec = (spec_client.CONTRACT / "SPEC.md").read_text(encoding="utf-8")
    for rule in RULES:
        section, _, part = rule.section.partition(", ")
        assert f"\n## {section}" in spec, rule
        assert not part or f"**{part}**" in spec, rule
