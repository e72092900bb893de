"""Two machines with a cable between them: the experiment, who is let in, and what happens when things go wrong."""

import contextlib
import json
import os
import shutil
import signal
import subprocess
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from ledger import record
from stack_rig import CONSTANT_PUSH, judged
from two_sites import MASTER, ROOT, SLAVE, Site, TwoSites, needs_namespaces, sniff

pytestmark = [needs_namespaces, pytest.mark.stack, pytest.mark.timeout(900)]

NS_PER_S = 1_000_000_000
LISTENED_S = 1.0
# what a link without keys shows to whoever listens; the fields of a sample are deflated, and no text is left of them
IN_THE_CLEAR = (b"teleop/forward", b"teleop/backward", b"afm/state", b"clock/ping", b"link/delay")
LINK_PORT, CONTROLLER_PORT, AFM_PORT, HAND_PORT = 5704, 5711, 5712, 5701
RECORDER_PORT, LAUNCHER_PORT = 5713, 5714

# a stranger's client: arguments are host, port, its own keys, the server's key, and how long it waits at most [s];
# it prints how many messages it received and how long that took [s]
CLIENT = """
import sys, time, zmq
host, port, public, secret, server, patience_s = sys.argv[1:]
context = zmq.Context()
socket = context.socket(zmq.SUB)
socket.subscribe(b"")
if public:
    socket.curve_publickey, socket.curve_secretkey = public.encode(), secret.encode()
    socket.curve_serverkey = server.encode()
begin = time.monotonic()
socket.connect(f"tcp://{host}:{port}")
received = 0
while received < 10 and socket.poll(max(0.0, begin + float(patience_s) - time.monotonic()) * 1e3):
    socket.recv_multipart()
    received += 1
print(received, time.monotonic() - begin)
context.destroy(linger=0)
"""

# sends the examples of the wire contract without encryption; arguments: address, port
PLAIN_SENDER = """
import json, sys, time, zmq
vectors = json.load(open("proto/golden/vectors.json"))
sender = zmq.Context().socket(zmq.PUB)
sender.bind(f"tcp://{sys.argv[1]}:{sys.argv[2]}")
print("bound", flush=True)
while True:
    for vector in vectors:
        sender.send_multipart([vector["topic"].encode(), bytes.fromhex(vector["hex"])])
    time.sleep(0.05)
"""
PLAIN_RECEIVER = """
import sys, time, zmq
receiver = zmq.Context().socket(zmq.SUB)
receiver.subscribe(b"")
receiver.connect(f"tcp://{sys.argv[1]}:{sys.argv[2]}")
while True:
    receiver.recv_multipart()
    print("received", flush=True)
    time.sleep(0.001)
"""

# arguments: host, port, number of connections; prints how many are accepted at once, in what time they were begun and
# accepted [s], and how many of them are closed
HALF_OPEN = """
import socket, sys, time
begun = time.monotonic()
trying = [socket.socket() for _ in range(int(sys.argv[3]))]
for s in trying:
    s.setblocking(False)
    s.connect_ex((sys.argv[1], int(sys.argv[2])))
began_s = time.monotonic() - begun
time.sleep(0.5)
waiting = []
for s in trying:
    try:
        s.getpeername()
        # Where the queue of the listener is full, its end of the connection begins with the first byte.
        s.send(b"\\xff")
        waiting.append(s)
    except OSError:
        s.close()
print(len(waiting), began_s, time.monotonic() - begun, flush=True)
accepted, end = len(waiting), time.monotonic() + 40
while waiting and time.monotonic() < end:
    for s in list(waiting):
        try:
            if not s.recv(4096):
                waiting.remove(s)
        except BlockingIOError:
            pass
        except OSError:
            waiting.remove(s)
    time.sleep(0.05)
print(accepted - len(waiting))
"""

# greets as ZeroMQ 3.1 with CURVE does, then announces a frame of 1 GB and sends some of it
HUGE = """
import socket, sys
s = socket.create_connection((sys.argv[1], int(sys.argv[2])), timeout=5)
s.sendall(b"\\xff" + bytes(8) + b"\\x7f" + b"\\x03\\x01" + b"CURVE".ljust(20, b"\\0") + bytes(32))
s.settimeout(5)
greeting = b""
while len(greeting) < 64:
    greeting += s.recv(64)
try:
    s.sendall(b"\\x06" + (1 << 30).to_bytes(8, "big") + bytes(100_000))
    print("closed" if not s.recv(1) else "open")
except ConnectionError:
    print("closed")
except TimeoutError:
    print("open")
"""


class Fault:
    """What the recordings have of the time after a fault."""

    def __init__(self, rig: TwoSites) -> None:
        self.rig = rig
        self.at_ns = time.time_ns()

    def changes(self, site: Site, topic: str) -> list[tuple[float, str]]:
        """Give mode and time since the fault [s] of each change of a device's mode, the mode before it first."""
        found: list[tuple[float, str]] = []
        for message in site.recording().messages(topic, self.at_ns - NS_PER_S):
            mode = message.fields()["mode"]
            if found and found[-1][1] == mode:
                continue
            entry = ((message.publish_ns - self.at_ns) / NS_PER_S, mode)
            found = [*found, entry] if message.publish_ns >= self.at_ns else [entry]
        return found

    def hand_off_s(self) -> float:
        """Give the time until the motor of the hand was off [s]."""
        return first(self.changes(self.rig.master, "haptic/state"), "off")

    def tip_s(self) -> tuple[float, float]:
        """Give the times until the tip stood still and until it was withdrawn [s]."""
        changes = self.changes(self.rig.slave, "afm/state")
        return first(changes, "hold"), first(changes, "retracted")


def first(changes: list[tuple[float, str]], mode: str) -> float:
    return next((at_s for at_s, name in changes if name == mode and at_s >= 0.0), float("nan"))


def events(site: Site, since_ns: int) -> list[Any]:
    return [message.decode() for message in site.recording().messages("session/event", since_ns)]


def lately_ns() -> int:
    """Give a time from which on every node has reported its health several times [ns]."""
    return time.time_ns() - 10 * NS_PER_S


def rejected(site: Site, node: str) -> dict[str, int]:
    """Give what a node has refused since its start, by reason."""
    health = (message for message in reversed(site.recording().messages("node/health")) if message.src == node)
    newest = next(health, None)
    return newest.fields()["rejected"] if newest else {}


def recorded_until(site: Site, topic: str) -> int:
    """Give the time of the newest message of a topic in the recording of a site [ns]."""
    received = site.recording().messages(topic)
    return received[-1].publish_ns if received else 0


def rates(site: Site, first_ns: int, last_ns: int, topics: tuple[str, ...]) -> dict[str, float]:
    """Give the rate of topics between two times [Hz], from stamps and numbers of the senders.

    Not from how many messages there are: a recorder that lacks a processor may miss some that were sent.
    """
    found = {}
    for topic in topics:
        inside = [m for m in site.recording().messages(topic, first_ns) if first_ns <= m.publish_ns < last_ns]
        span_ns = inside[-1].publish_ns - inside[0].publish_ns if len(inside) > 1 else 0
        found[topic] = (inside[-1].seq - inside[0].seq) * NS_PER_S / span_ns if span_ns else 0.0
    return found


# -- what a listener reads --------------------------------------------------------------------------------------------


@pytest.mark.endurance
def test_a_listener_reads_everything_of_a_rig_without_encryption(tmp_path: Path) -> None:
    rig = TwoSites(tmp_path, insecure=True)
    try:
        rig.start("--duration", "5")
        seen = sniff(rig.slave, LISTENED_S, tmp_path / "wire")
        assert rig.master.process is not None
        assert rig.master.process.wait(timeout=120) == 0, rig.master.logs()
        summary = rig.master.summary()
        assert summary["verdict"] != "no_data", summary["reason"]
    finally:
        rig.close()
    assert [text for text in IN_THE_CLEAR if text not in seen] == []


# -- one rig, one fault after the other ----------------------------------------------------------------------------


@pytest.fixture(scope="module")
def sites(tmp_path_factory: pytest.TempPathFactory) -> Iterator[TwoSites]:
    found = TwoSites(tmp_path_factory.mktemp("two_sites"), guest=True)
    found.master.lean = found.slave.lean = True
    try:
        yield found
    finally:
        found.close()


@pytest.fixture
def rig(sites: TwoSites) -> TwoSites:
    """Give both sites in a session, which begins here where the test of a late start does not run."""
    if sites.master.process is None:
        sites.start("--duration", "3600", "--set", CONSTANT_PUSH)
    return sites


def process_of(site: Site, node: str) -> int:
    """Give the process of a node of a site."""
    name = f"services.{node.partition('@')[0]}"
    for entry in Path("/proc").glob("[0-9]*/cmdline"):
        with contextlib.suppress(OSError):
            words = entry.read_bytes().decode().split("\0")
            if name in words and str(site.out / "scenario.yaml") in words:
                return int(entry.parent.name)
    raise AssertionError(f"{node} does not run")


def take_up_again(rig: TwoSites) -> None:
    """Arm both devices until the tip has followed the hand for a second; on a slow machine a stall withdraws it."""

    def coupled() -> bool:
        rig.rearm()
        time.sleep(1.5)
        found = rig.slave.recording().messages("afm/state", time.time_ns() - NS_PER_S)
        return {message.fields()["mode"] for message in found} == {"follow"}

    rig.wait_until(coupled, "a second of coupled operation")


def refusals(rig: TwoSites, reason: str, node: str = "delay_node@master") -> int:
    """Give how often a node reports that it has refused something, once a report of after now is in the file."""
    now_ns = time.time_ns()

    def reported() -> bool:
        return any(message.src == node for message in rig.master.recording().messages("node/health", now_ns))

    rig.wait_until(reported, f"a report of {node}")
    return rejected(rig.master, node).get(reason, 0)


PATIENT_S = 30.0


def client(rig: TwoSites, keys: tuple[str, str, str], port: int, patience_s: float) -> "subprocess.Popen[str]":
    """Start a client at the slave's end of the cable that listens at an endpoint of the master's.

    Parameters: keys, its own, public and secret, and that of the server.
    """
    return rig.slave.python(CLIENT, MASTER, str(port), *keys, str(patience_s))


def clients(rig: TwoSites, known: tuple[str, str, str], *strangers: tuple[str, str, str]) -> tuple[int, list[int]]:
    """Return how many messages a known client receives, and strangers in twice the time that it took."""
    received, took_s = client(rig, known, LINK_PORT, PATIENT_S).communicate(timeout=60)[0].split()
    trying = [client(rig, keys, LINK_PORT, max(1.0, 2.0 * float(took_s))) for keys in strangers]
    return int(received), [int(process.communicate(timeout=90)[0].split()[0]) for process in trying]


def test_a_listener_reads_what_is_not_encrypted(sites: TwoSites, tmp_path: Path) -> None:
    """Show that the listener of the last test would read the messages if it could."""
    processes = [
        site.python(text, SLAVE, "5799") for site, text in ((sites.slave, PLAIN_SENDER), (sites.master, PLAIN_RECEIVER))
    ]
    try:
        for process, line in zip(processes, ("bound\n", "received\n"), strict=True):
            assert process.stdout is not None
            assert process.stdout.readline() == line
        seen = sniff(sites.slave, LISTENED_S, tmp_path / "wire")
    finally:
        for process in processes:
            process.kill()
            process.communicate()
    assert [text for text in IN_THE_CLEAR if text not in seen] == []


@pytest.mark.check("takes 11 s")
@pytest.mark.drawn(0.0, "telenano/runtime/", "telenano/launcher/", "services/delay_node/")
def test_late_start_of_the_slave_is_waited_for(sites: TwoSites) -> None:
    sites.master.start("--duration", "3600", "--set", CONSTANT_PUSH)
    reported_s = sites.wait_until(
        lambda: sites.master.has_log("delay_node@master", "afm_node@slave has not been reached at tcp://"),
        "the word that the slave is not reached",
    )
    record("the slave's address is not reached", "reported 5 s after the start of the link, with address and machine")
    assert reported_s > 4.0
    assert not sites.running()
    assert "afm_node@slave" in sites.master.log.read_text()
    sites.slave.start()
    began_s = sites.wait_until(sites.running, "a session that begins by itself")
    record(
        "the slave's site starts late", f"the session began by itself, {began_s:.0f} s after the slave's start command"
    )


@pytest.mark.drawn(0.0, "telenano/runtime/", "telenano/launcher/")
def test_who_is_not_known_receives_nothing(rig: TwoSites) -> None:
    import zmq

    public, secret = (key.decode() for key in zmq.curve_keypair())
    guest = rig.guest.own("guest")
    known = (guest.public.decode(), guest.secret.decode(), rig.keys["master"])
    strangers = {
        "a key that is not listed": ("unlisted", (public, secret, rig.keys["master"])),
        "a wrong server key": ("handshake", (guest.public.decode(), guest.secret.decode(), public)),
        "no encryption": ("handshake", ("", "", "")),
    }
    before = {reason: refusals(rig, reason) for reason, _ in strangers.values()}
    received, nothing = clients(rig, known, *(keys for _, keys in strangers.values()))
    # the same client receives with a key that is listed
    assert received >= 10
    assert nothing == [0, 0, 0]
    for reason, at_least in (("unlisted", 1), ("handshake", 2)):
        # what is in the file may lag on a busy machine
        rig.wait_until(
            lambda r=reason, n=at_least: refusals(rig, r) >= before[r] + n, f"{at_least} to be counted as {reason}"
        )
    for fault, (reason, _) in strangers.items():
        counted = refusals(rig, reason) - before[reason]
        record(fault, f"received nothing, counted as `{reason}` ({counted}, all strangers together)")
    # of several refusals in half a second the log has the last
    assert rig.master.has_log("delay_node@master", "refused: ")


@pytest.mark.drawn(0.0, "telenano/runtime/", "telenano/launcher/")
def test_an_observer_observes_and_commands_nobody(rig: TwoSites) -> None:
    looked = rig.guest_command("topic", "echo", "haptic/state", "--count", "3")
    assert looked.returncode == 0, looked.stderr
    sent = rig.guest_command("session", "estop", "--target", "haptic_node")
    assert sent.returncode != 0
    rig.wait_until(lambda: refusals(rig, "role", "haptic_node@master") > 0, "commands to be counted as refused")
    refused = refusals(rig, "role", "haptic_node@master")
    state = rig.master.recording().messages("haptic/state", lately_ns())[-1].fields()
    assert state["estop"] is False
    assert state["mode"] == "position"
    assert rig.master.has_log("haptic_node@master", "lacks the role control")
    record("an observer that sends e-stop", f"no node obeyed, the hand went on; counted as `role` ({refused})")
    # and with the role it is obeyed, without a restart of anything
    rig.master.keyring.allow("guest", rig.keys["guest"], ["observe", "control"])
    rig.wait_until(
        lambda: rig.guest_command("session", "estop", "--target", "haptic_node").returncode == 0,
        "an e-stop that is obeyed once the role is given",
    )
    rig.master.keyring.allow("guest", rig.keys["guest"], ["observe"])
    take_up_again(rig)


@pytest.mark.drawn(0.0, "telenano/runtime/", "telenano/launcher/")
def test_a_key_revoked_while_it_listens_is_shut_out(rig: TwoSites) -> None:
    environment = {**rig.slave.environment, "TELENANO_KEYS_DIR": str(rig.guest.folder), "TELENANO_MACHINE": "guest"}
    command = rig.slave.command("topic", "echo", "haptic/state", "--site-file", str(rig.slave.site_file))
    listener = subprocess.Popen(command, env=environment, cwd=ROOT, stdout=subprocess.PIPE, text=True)
    assert listener.stdout is not None
    try:
        assert "position_m" in listener.stdout.readline()
        reported = rig.master.keys_command("revoke", "guest")
        revoked_ns = time.time_ns()
        assert reported.returncode == 0, reported.stderr
        rig.wait_until(
            lambda: rig.master.has_log("haptic_node@master", "the key of guest is no longer allowed"), "a closed door"
        )
        time.sleep(1.0)
        newest_ns = 0
        for line in drained(listener):
            newest_ns = json.loads(line)["t_ns"]
    finally:
        listener.kill()
        listener.communicate()
    late_s = (newest_ns - revoked_ns) / NS_PER_S
    assert late_s < 2.0
    guest = rig.guest.own("guest")
    keys = (guest.public.decode(), guest.secret.decode(), rig.keys["master"])
    assert client(rig, keys, HAND_PORT, 1.0).communicate(timeout=60)[0].split()[0] == "0"
    record("a key revoked while it listens", f"cut off {max(late_s, 0.0):.1f} s after the command; the link went on")


def drained(process: "subprocess.Popen[str]") -> list[str]:
    """Give the lines that wait in the pipe of a process that has gone silent."""
    import os
    import select

    assert process.stdout is not None
    text = ""
    while select.select([process.stdout], [], [], 1.0)[0]:
        chunk = os.read(process.stdout.fileno(), 1 << 20).decode()
        if not chunk:
            break
        text += chunk
    return [line for line in text.splitlines() if line.startswith("{") and line.endswith("}")]


# one of each node of the loop: a command to the tip answers what came through the link, and what comes back the tip
FAST_AT_MASTER = ("haptic/state", "haptic/command", "teleop/backward@master")
FAST_AT_SLAVE = ("afm/state", "afm/command")


def rates_of_both(rig: TwoSites, first_ns: int, last_ns: int) -> dict[str, float]:
    recorded = [*((rig.master, topic) for topic in FAST_AT_MASTER), *((rig.slave, topic) for topic in FAST_AT_SLAVE)]
    rig.wait_until(
        lambda: min(recorded_until(*place) for place in recorded) > last_ns, "the end of a time in both recordings"
    )
    return {
        **rates(rig.master, first_ns, last_ns, FAST_AT_MASTER),
        **rates(rig.slave, first_ns, last_ns, FAST_AT_SLAVE),
    }


# half-open connections that each stranger begins
TRIED = 500


@pytest.mark.check("takes 8 s")
@pytest.mark.drawn(0.0, "telenano/runtime/", "telenano/launcher/", "services/delay_node/")
def test_half_open_connections_are_closed_and_counted_and_the_loop_goes_on(rig: TwoSites) -> None:
    doors = (
        (rig.master, "delay_node@master", rig.slave, MASTER, LINK_PORT),
        (rig.slave, "controller@slave", rig.master, SLAVE, CONTROLLER_PORT),
        (rig.slave, "afm_node@slave", rig.master, SLAVE, AFM_PORT),
        (rig.slave, "recorder@slave", rig.master, SLAVE, RECORDER_PORT),
        (rig.slave, "launcher@slave", rig.master, SLAVE, LAUNCHER_PORT),
    )
    start = {node: rejected(victim, node).get("handshake", 0) for victim, node, *_ in doors}
    opening = [attacker.python(HALF_OPEN, host, str(port), str(TRIED)) for *_, attacker, host, port in doors]
    accepted = []
    for process in opening:
        made_text, _, _, closed_text = process.communicate(timeout=90)[0].split()
        made = int(made_text)
        assert int(closed_text) == made > 0
        accepted.append(made)
    for made, (victim, node, *_) in zip(accepted, doors, strict=True):
        rig.wait_until(
            lambda v=victim, n=node, m=made: rejected(v, n).get("handshake", 0) - start[n] >= m,
            "half-open ones to be counted",
        )
    begin_ns = time.time_ns()
    rates = rates_of_both(rig, begin_ns, begin_ns + NS_PER_S)
    assert min(rates.values()) > 0.0, rates
    ports = f"at each of {len(doors)} ports, {max(accepted)} at most"
    record("500 half-open connections", f"accepted {ports}, all closed after 5 s; the loop went on")


@pytest.mark.check("takes 3 s")
@pytest.mark.drawn(0.0, "telenano/runtime/", "telenano/launcher/", "services/delay_node/")
def test_a_huge_frame_takes_no_memory(rig: TwoSites) -> None:
    outs = []
    for site, host, port in ((rig.slave, MASTER, LINK_PORT), (rig.master, SLAVE, AFM_PORT)):
        process = site.python(HUGE, host, str(port))
        outs.append(process.communicate(timeout=30)[0].strip())
    assert outs == ["closed", "closed"]
    time.sleep(1.2)
    reported = rig.master.recording().messages("node/health", lately_ns())
    sizes = [message.fields()["memory_bytes"] for message in reported]
    assert max(sizes) < 1 << 30
    record("a frame of 1 GB announced", f"connection closed; no node above {max(sizes) / 1e6:.0f} MB")


@pytest.mark.skipif(shutil.which("nft") is None, reason="the command `nft` (nftables) is not installed")
def test_without_tcp_no_datagram_keeps_the_loop_alive(rig: TwoSites) -> None:
    take_up_again(rig)
    ends = ((rig.master, "delay_node@master"), (rig.slave, "controller@slave"))
    fault = Fault(rig)
    rig.cable.drop_tcp(dropped=True)
    try:
        rig.wait_until(lambda: fault.tip_s()[1] > 0.0, "a withdrawn tip", 30.0)
        withdrawn_ns = time.time_ns()
        # Datagrams cross as before, so that nothing but the missing connection has ended the loop.
        rig.wait_until(lambda: len(set(arrivals(rig, withdrawn_ns))) > 1, "datagrams that cross nevertheless")
        for site, node in ends:
            rig.wait_until(lambda s=site, n=node: s.has_log(n, "no command can cross"), f"the word of {node}")
        hand_s, (hold_s, gone_s) = fault.hand_off_s(), fault.tip_s()
    finally:
        rig.cable.drop_tcp(dropped=False)
    for site, node in ends:
        rig.wait_until(lambda s=site, n=node: s.has_log(n, "the link's datagrams continue"), f"{node} in touch again")
    assert hold_s < gone_s
    record(
        "TCP is cut between the sites, and UDP is not",
        f"tip held after {hold_s * 1e3:.0f} ms, withdrawn after {gone_s * 1e3:.0f} ms, hand off after "
        f"{hand_s * 1e3:.0f} ms; samples count again once TCP is back, and the tip waits to be armed",
    )


def arrivals(rig: TwoSites, since_ns: int) -> list[int]:
    """Give how many datagrams had arrived at the slave's end, by each of its reports since a time [ns]."""
    found = rig.slave.recording().messages("link/network", since_ns)
    return [message.fields()["arrived"] for message in found if message.src == "controller@slave"]


@pytest.mark.parametrize("seconds", [5, pytest.param(60, marks=pytest.mark.endurance)])
def test_a_pulled_cable_leaves_both_sides_safe_and_comes_back(rig: TwoSites, seconds: int) -> None:
    take_up_again(rig)
    fault = Fault(rig)
    rig.cable.pull()
    time.sleep(seconds)
    rig.cable.plug()
    plugged_ns = time.time_ns()
    rig.wait_until(lambda: first_received_s(rig, plugged_ns) is not None, "messages of the slave's site again")
    back_s = first_received_s(rig, plugged_ns)
    take_up_again(rig)
    hand_s, (hold_s, gone_s) = fault.hand_off_s(), fault.tip_s()
    assert 0.0 <= hand_s < 1.0
    assert 0.0 <= hold_s < 1.0
    assert hold_s < gone_s < 2.0
    expected_events = {(node, kind) for node in ("delay_node@master", "controller@slave") for kind in ("down", "up")}
    rig.wait_until(lambda: expected_events <= connections(rig, fault.at_ns), "the word of both that they were parted")
    reported = (*events(rig.master, fault.at_ns), *events(rig.slave, fault.at_ns))
    assert [event for event in reported if "started again" in event.text] == []
    record(
        f"the cable is pulled for {seconds} s",
        f"hand off after {hand_s * 1e3:.0f} ms, tip held after {hold_s * 1e3:.0f} ms, withdrawn after "
        f"{gone_s * 1e3:.0f} ms; received again {back_s:.1f} s after the cable was back",
    )


@pytest.mark.endurance
@pytest.mark.parametrize("seconds", [30, 300])
@pytest.mark.parametrize("node", ["delay_node@master", "controller@slave"])
def test_an_end_of_the_link_that_stands_still_leaves_both_sides_safe_and_comes_back(
    rig: TwoSites, node: str, seconds: int
) -> None:
    """A process that is stopped keeps its sockets and its keys: what waited in them meanwhile may not be obeyed."""
    take_up_again(rig)
    site = rig.master if node.endswith("@master") else rig.slave
    process_id = process_of(site, node)
    fault = Fault(rig)
    os.kill(process_id, signal.SIGSTOP)
    time.sleep(seconds)
    os.kill(process_id, signal.SIGCONT)
    back_ns = time.time_ns()
    rig.wait_until(lambda: first_received_s(rig, back_ns) is not None, "messages of the slave's site again")
    back_s = first_received_s(rig, back_ns)
    # No device goes on by what waited.
    modes = {mode for at_s, mode in fault.changes(rig.slave, "afm/state") if at_s > 2.0}
    take_up_again(rig)
    hand_s, (hold_s, gone_s) = fault.hand_off_s(), fault.tip_s()
    assert 0.0 <= hand_s < 1.0
    assert 0.0 <= hold_s < 1.0
    assert hold_s < gone_s < 2.0
    assert modes <= {"retracted"}
    assert process_of(site, node) == process_id
    record(
        f"{node}, an end of the link, stands still for {seconds} s",
        f"hand off after {hand_s * 1e3:.0f} ms, tip held after {hold_s * 1e3:.0f} ms, withdrawn after "
        f"{gone_s * 1e3:.0f} ms; received again {back_s:.1f} s after it went on, armed and both follow",
    )


def connections(rig: TwoSites, since_ns: int) -> set[tuple[str, Any]]:
    """Give which nodes reported which event of a connection since a time [ns]."""
    reported = (*events(rig.master, since_ns), *events(rig.slave, since_ns))
    return {(event.src, event.data.get("connection")) for event in reported if event.kind == "network"}


def first_received_s(rig: TwoSites, since_ns: int) -> float | None:
    """Give when the slave's half was first received through the link after a time [s from it]; None if it was not."""
    received = rig.master.recording().messages("teleop/backward@master", since_ns)
    fresh = (message.log_ns for message in received if message.publish_ns > since_ns)
    return next(((at_ns - since_ns) / NS_PER_S for at_ns in fresh), None)


def killed(site: Site) -> float:
    """Kill the launcher of a site, and give the time until it was gone, which takes it a processor [s]."""
    begin = time.monotonic()
    site.stop(signal.SIGKILL)
    return time.monotonic() - begin


def test_the_slave_killed_and_started_again_is_taken_up(rig: TwoSites) -> None:
    take_up_again(rig)
    fault = Fault(rig)
    dead_s = killed(rig.slave)
    time.sleep(2.0)
    rig.slave.start()
    started_ns = time.time_ns()
    rig.wait_until(lambda: first_received_s(rig, started_ns) is not None, "messages of the slave again")
    back_s = first_received_s(rig, started_ns)
    take_up_again(rig)
    hand_s = fault.hand_off_s()
    assert 0.0 <= hand_s < dead_s + 1.0
    assert first(Fault.changes(fault, rig.master, "haptic/state"), "position") > 0.0
    record(
        "the slave's site is killed and started again",
        f"hand off after {hand_s * 1e3:.0f} ms; received again {back_s:.0f} s after its start, armed and going on",
    )


def test_the_master_killed_and_started_again_begins_anew(rig: TwoSites) -> None:
    take_up_again(rig)
    fault = Fault(rig)
    dead_s = killed(rig.master)
    time.sleep(2.0)
    # the slave's recorder begins a new file with the new session
    rig.wait_until(lambda: fault.tip_s()[1] > 0.0, "the withdrawn tip in the recording")
    hold_s, gone_s = fault.tip_s()
    rig.master.lean = False  # its report needs all of the loop
    rig.master.start("--duration", "8")
    rig.wait_until(rig.running, "a new session")
    assert 0.0 <= hold_s < dead_s + 1.0
    assert hold_s < gone_s < dead_s + 2.0
    record(
        "the master's site is killed and started again",
        f"tip held after {hold_s * 1e3:.0f} ms, withdrawn after {gone_s * 1e3:.0f} ms; a new session began by itself",
    )


def test_the_new_session_is_the_experiment_and_nobody_can_read_it(rig: TwoSites, tmp_path: Path) -> None:
    seen = sniff(rig.slave, LISTENED_S, tmp_path / "wire")
    assert rig.master.process is not None
    assert rig.master.process.wait(timeout=120) == 0, rig.master.logs()
    assert rig.slave.stop() == 0
    summary = rig.master.summary()
    if judged(summary, "the session after a restart of the master's site"):
        assert summary["stable"] is True
        assert summary["hold_ratio"] == pytest.approx(1.050, abs=0.005)
        assert summary["contact_x_cm"] == pytest.approx(0.703, abs=0.010)
        assert abs(summary["release_force_nn"]) < 0.02
    # the loop in both directions went by, and nothing of it could be read
    assert len(seen) > 50_000 * LISTENED_S
    assert [text for text in IN_THE_CLEAR if text in seen] == []
