"""The link for datagrams: what goes where and when, in virtual time, over sockets, and as a command."""

import errno
import io
import json
import os
import resource
import signal
import socket
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import ExitStack, closing, contextmanager
from pathlib import Path
from typing import Any

import pytest
from telenano_lab.networks.byte_link import ByteLink
from telenano_lab.networks.report_command import fates_in, figures, overflows_in
from telenano_lab.networks.udp_command import Keeper
from telenano_lab.networks.udp_link import Bounds, UdpLink, quantiles_ms
from telenano_lab.networks.udp_ports import IDLE_NS, Place, UdpPorts, make_room_for, place_of

from telenano.link import Direction
from telenano.recording import FileSettings, RecordingWriter
from telenano.settings import LinkSettings
from telenano.signals import run, start
from telenano.testing import NodeBench
from telenano.wire import ConfigError, encode

MS = 1_000_000


class RecordedPorts:
    """Ports that keep what was sent: direction, datagram, client, and when [ms]."""

    def __init__(self, bench: NodeBench) -> None:
        self.take: Callable[[Direction, bytes, str], None] = lambda direction, payload, client: None
        self.sent: list[tuple[str, bytes, str, float]] = []
        self._bench = bench
        self._begun_ns = bench.clock.now_ns()

    def send(self, direction: Direction, payload: bytes, name: str) -> None:
        now_ms = (self._bench.clock.now_ns() - self._begun_ns) / MS
        self.sent.append((direction, payload, name, now_ms))


class Line:
    """A link for datagrams in virtual time."""

    def __init__(self, bounds: Bounds | None = None, **settings: Any) -> None:
        self.bench = NodeBench("delay_node@master")
        self.ports = RecordedPorts(self.bench)
        # The node stands for its process, which hands on what it is called with.
        self.udp = UdpLink(self, self.ports, bounds or Bounds())  # type: ignore[arg-type]
        self.node = ByteLink(self.bench.context, LinkSettings().changed(settings), (self.bench,) * 2, self.udp)
        self.clock, self.arrive, self.event = self.bench.clock, self.node.arrive, self.node.event

    def send(self, payload: bytes, direction: Direction = "forward", client: str = "a:1") -> None:
        self.ports.take(direction, payload, client)

    def advance_ms(self, duration_ms: int) -> None:
        """Let time pass; what is due is done within the millisecond."""
        for _ in range(duration_ms):
            self.bench.advance_ms(1)
            now_ns = self.bench.clock.monotonic_ns()
            if self.node.deadline_ns() <= now_ns:
                self.node.on_deadline(now_ns)
            self.bench.run_deferred()

    def set(self, **parameters: Any) -> str:
        control: Any = self.bench.make(
            "session/control", "console@master", id="x", command="set", target="*", parameters=parameters
        )
        return self.node.on_control(control)


def keys(**settings: Any) -> dict[str, Any]:
    return {key.replace("__", "."): value for key, value in settings.items()}


def test_a_datagram_and_its_answer_take_the_delay_of_their_direction_and_keep_their_client() -> None:
    line = Line(**keys(forward__delay_s=0.02, backward__delay_s=0.005))
    line.send(b"question", client="a:1")
    line.send(b"another", client="b:2")
    line.advance_ms(19)
    assert line.ports.sent == []
    line.advance_ms(1)
    assert line.ports.sent == [("forward", b"question", "a:1", 20.0), ("forward", b"another", "b:2", 20.0)]
    line.send(b"answer", "backward", "b:2")
    line.advance_ms(200)
    assert line.ports.sent[2:] == [("backward", b"answer", "b:2", 25.0)]
    fates = [(report.direction, row.topic, row.seq, row.delay_ns) for report in line.bench.take("link/fates")
             for row in report.fates]  # fmt: skip
    assert fates == [
        ("forward", "udp", 0, 20 * MS), ("forward", "udp", 1, 20 * MS), ("backward", "udp", 0, 5 * MS)
    ]  # fmt: skip
    status = line.bench.take("link/status")[-1]
    assert (status.forward.messages_in, status.forward.messages_out, status.backward.messages_out) == (2, 2, 1)
    summary = line.udp.summary()
    assert summary["forward"] == {
        "arrived": 2, "sent": 2, "dropped": {}, "over_the_bound": 0, "left": 0,
        "delay_ms": {"p50": 20.0, "p99": 20.0, "p999": 20.0, "max": 20.0},
        "late_ms": {"p50": 0.0, "p99": 0.0, "p999": 0.0, "max": 0.0},
    }  # fmt: skip


STALL = keys(forward__outage__schedule="0.01:0.5", forward__outage__mode="hold")


@pytest.mark.parametrize("bounds", [Bounds(datagrams=50), Bounds(size_bytes=50 * 100)], ids=["datagrams", "bytes"])
def test_a_stall_keeps_no_more_than_the_bound_says_which_and_lets_all_go_at_its_end(bounds: Bounds) -> None:
    line = Line(bounds, **STALL)
    line.advance_ms(11)
    for number in range(80):
        line.send(bytes([number]) * 100)
        line.advance_ms(1)
    assert line.ports.sent == []
    line.advance_ms(500)
    assert [payload[0] for _, payload, _, _ in line.ports.sent] == list(range(50))
    assert {at_ms for *_, at_ms in line.ports.sent} == {510.0}
    assert line.udp.counts["forward"].overflow == 30
    (event,) = (event for event in line.bench.take("session/event") if event.level == "warning")
    assert "in transit forward: those that arrive now are dropped" in event.text
    # there is room again
    line.send(b"later")
    assert line.ports.sent[-1][1] == b"later"
    assert (line.udp.counts["forward"].on_way, line.udp.counts["forward"].on_way_bytes) == (0, 0)


def test_settings_that_end_a_stall_let_go_what_it_holds_before_what_arrives_from_then_on() -> None:
    line = Line(**STALL)
    line.advance_ms(11)
    line.send(b"held")
    line.advance_ms(50)
    assert line.set(profile="clean") == "set profile = clean"
    line.send(b"free")
    assert [(payload, at_ms) for _, payload, _, at_ms in line.ports.sent] == [(b"held", 61.0), (b"free", 61.0)]


@pytest.mark.parametrize(
    ("settings", "sent"),
    [
        (keys(forward__loss__probability=1.0), 0),
        (keys(forward__duplication__probability=1.0, forward__delay_s=0.01), 2000),
        (keys(forward__rate__rate_bytes_per_s=1000.0, forward__queue__limit_messages=2), None),
    ],
    ids=["lost", "twice", "a full queue"],
)
def test_what_is_lost_doubled_or_queued_gives_its_place_back(settings: dict[str, Any], sent: int | None) -> None:
    line = Line(Bounds(datagrams=150), **settings)
    for _ in range(1000):
        line.send(bytes(100))
        line.advance_ms(1)
    line.advance_ms(2000)
    counts = line.udp.counts["forward"]
    assert (counts.overflow, counts.on_way, counts.on_way_bytes) == (0, 0, 0)
    assert sent is None or len(line.ports.sent) == sent
    assert counts.arrived == 1000
    if sent is None:
        assert counts.dropped["queue"] + counts.sent == 1000


def test_what_is_on_its_way_at_the_end_is_counted_and_reported() -> None:
    line = Line(**keys(forward__delay_s=1.0))
    line.send(b"late")
    line.node.make_safe()
    assert line.udp.counts["forward"].on_way == 1
    (report,) = line.bench.take("link/fates")
    assert [row.delay_ns for row in report.fates] == [1000 * MS]


@pytest.mark.parametrize(
    ("text", "needs_host", "expected"),
    [
        ("5000", False, Place("127.0.0.1", 5000)),
        (":5000", False, Place("127.0.0.1", 5000)),
        ("0.0.0.0:5000", False, Place("0.0.0.0", 5000)),
        ("[::1]:5000", True, Place("::1", 5000)),
        ("::1:5000", True, r"HOST:PORT '::1:5000': an IPv6 address needs brackets, such as \[::1\]:5000"),
        ("5000", True, r"HOST:PORT '5000': needs a host, such as 127\.0\.0\.1:5000"),
        ("afm.example", True, "HOST:PORT 'afm.example': needs a port from 1 to 65535"),
        ("afm.example:0", True, "HOST:PORT 'afm.example:0': needs a port from 1 to 65535"),
        ("afm.example:65536", True, "needs a port from 1 to 65535"),
        ("", False, "needs a port from 1 to 65535"),
    ],
)
def test_places_are_read_or_refused_in_words(text: str, needs_host: bool, expected: Place | str) -> None:
    if isinstance(expected, Place):
        assert place_of(text, "HOST:PORT", needs_host=needs_host) == expected
        return
    with pytest.raises(ConfigError, match=expected):
        place_of(text, "HOST:PORT", needs_host=needs_host)


# --- over sockets ---


class Echo:
    """A service that is asked by the test itself."""

    def __init__(self, host: str) -> None:
        self.socket = opened(host)
        self.address = self.socket.getsockname()

    def answer(self) -> list[bytes]:
        """Answer each datagram that has come with the same bytes and the port that it came from."""
        taken = []
        self.socket.settimeout(0.5)
        try:
            while True:
                payload, sender = self.socket.recvfrom(65536)
                self.socket.sendto(payload + b" from %d" % sender[1], sender)
                taken.append(payload)
                self.socket.settimeout(0.02)
        except TimeoutError:
            return taken


def opened(host: str) -> socket.socket:
    found = socket.socket(socket.AF_INET6 if ":" in host else socket.AF_INET, socket.SOCK_DGRAM)
    found.bind((host, 0))
    found.settimeout(5.0)
    return found


def has_ipv6() -> bool:
    try:
        opened("::1").close()
    except OSError:
        return False
    return True


IPV6 = pytest.mark.skipif(not has_ipv6(), reason="this machine has no IPv6")
HOSTS = ["127.0.0.1", pytest.param("::1", marks=IPV6)]


@pytest.fixture
def echo(request: pytest.FixtureRequest) -> Iterator[Echo]:
    service = Echo(getattr(request, "param", "127.0.0.1"))
    with closing(service.socket):
        yield service


def ports_of(target: tuple[Any, ...], host: str = "127.0.0.1", clients: int = 64, *clock: Any) -> UdpPorts:
    with closing(opened(host)) as free:
        place = Place(host, free.getsockname()[1])
    return UdpPorts(place, Place(target[0], target[1]), clients, *clock)


@pytest.mark.parametrize("host", HOSTS)
@pytest.mark.parametrize("echo", HOSTS, indirect=True)
def test_each_client_gets_its_own_answers_over_either_family(host: str, echo: Echo) -> None:
    with closing(ports_of(echo.address, host)) as ports:
        ports.take = ports.send
        clients = [opened(host) for _ in range(5)]
        for number, client in enumerate(clients):
            client.sendto(b"question %d" % number, ports.address[:2])
        ports.receive()
        assert sorted(echo.answer()) == [b"question %d" % number for number in range(5)]
        ports.receive()
        answers = [client.recvfrom(1000)[0] for client in clients]
        assert [answer.partition(b" from ")[0] for answer in answers] == [b"question %d" % n for n in range(5)]
        # the service sees five clients, as without the link
        assert len({answer.partition(b" from ")[2] for answer in answers}) == 5
        for client in clients:
            client.close()


def test_a_client_beyond_the_most_is_refused_until_another_has_been_silent(echo: Echo) -> None:
    bench = NodeBench("delay_node@master")
    with closing(ports_of(echo.address, "127.0.0.1", 2, bench.clock.monotonic_ns)) as ports:
        ports.take = ports.send
        clients = [opened("127.0.0.1") for _ in range(3)]
        for client in clients:
            client.sendto(b"hello", ports.address[:2])
        ports.receive()
        assert (len(ports.clients), ports.refused) == (2, 1)
        bench.clock.advance_ns(IDLE_NS)
        clients[1].sendto(b"still here", ports.address[:2])
        ports.receive()
        clients[2].sendto(b"again", ports.address[:2])
        ports.receive()
        assert set(ports.clients) == {f"127.0.0.1:{client.getsockname()[1]}" for client in clients[1:]}
        assert sorted(echo.answer()) == [b"again", b"hello", b"hello", b"still here"]
        # What is on its way to a client that is gone has nowhere to go.
        ports.send("backward", b"late", f"127.0.0.1:{clients[0].getsockname()[1]}")
        assert ports.unsent == {"client gone": 1}
        for client in clients:
            client.close()


def test_a_target_that_is_not_there_is_counted_and_found_when_it_comes() -> None:
    with closing(opened("127.0.0.1")) as free:
        address = free.getsockname()
    with closing(ports_of(address)) as ports, closing(opened("127.0.0.1")) as client:
        ports.take = ports.send
        for _ in range(3):
            client.sendto(b"anybody?", ports.address[:2])
            ports.receive()
            ports.receive()
        assert ports.unsent["no process listens"] >= 1
        with closing(socket.socket(socket.AF_INET, socket.SOCK_DGRAM)) as late:
            late.bind(address)
            late.settimeout(5.0)
            client.sendto(b"now", ports.address[:2])
            ports.receive()
            assert late.recv(100) == b"now"


def test_a_flood_at_one_socket_is_taken_in_parts_and_nothing_is_left(echo: Echo) -> None:
    with closing(ports_of(echo.address)) as ports, closing(opened("127.0.0.1")) as client:
        taken: list[bytes] = []
        ports.take = lambda direction, payload, name: taken.append(payload)
        for number in range(150):
            client.sendto(b"%d" % number, ports.address[:2])
        ports.receive()
        assert len(taken) == 64
        assert not ports.drained
        while not ports.drained:
            ports.receive()
        assert taken == [b"%d" % number for number in range(150)]


@contextmanager
def room_for(descriptors: int) -> Iterator[None]:
    """Let this process open no more than a number of further files while the block runs."""
    before, lowest = resource.getrlimit(resource.RLIMIT_NOFILE), os.dup(0)
    os.close(lowest)
    resource.setrlimit(resource.RLIMIT_NOFILE, (lowest + descriptors, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_NOFILE, before)


def test_a_client_for_which_there_is_no_descriptor_is_counted_and_the_others_go_on(echo: Echo) -> None:
    with closing(ports_of(echo.address)) as ports, ExitStack() as opened_clients:
        clients = [opened_clients.enter_context(opened("127.0.0.1")) for _ in range(6)]
        ports.take = ports.send
        for descriptors in (0, 2, 100):
            with room_for(descriptors):
                for client in clients:
                    client.sendto(b"hello", ports.address[:2])
                ports.receive()
            assert len(ports.clients) == min(descriptors, 6)
            assert ports.unsent["no descriptors"] == ports.refused > 0
        # those that were refused are admitted once there are descriptors
        assert ports.refused == 6 + 4


def test_more_clients_than_descriptors_are_refused_at_the_start_with_the_most(monkeypatch: pytest.MonkeyPatch) -> None:
    limits = {"now": (100, 1000)}
    monkeypatch.setattr(resource, "getrlimit", lambda which: limits["now"])
    monkeypatch.setattr(resource, "setrlimit", lambda which, pair: limits.update(now=pair))
    open_now = len(list(Path("/proc/self/fd").iterdir()))
    make_room_for(50 - open_now)
    assert limits["now"] == (100, 1000)
    # the soft limit is raised as far as it has to be
    make_room_for(500)
    assert 500 + open_now <= limits["now"][0] <= 600 + open_now
    with pytest.raises(
        ConfigError, match=r"--clients 1000: needs \d+ open files, .* may have 1000 \(ulimit -n\)"
    ) as said:
        make_room_for(1000)
    most = int(str(said.value).split(": ")[-1].split()[0])
    make_room_for(most)
    with pytest.raises(ConfigError):
        make_room_for(most + 2)


def test_what_the_kernel_drops_at_a_socket_that_is_not_read_is_counted(echo: Echo) -> None:
    with closing(ports_of(echo.address)) as ports, closing(opened("127.0.0.1")) as client:
        taken: list[str] = []
        ports.take = lambda direction, payload, name: taken.append(name)
        ports._listener.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        for _ in range(200):
            client.sendto(bytes(1000), ports.address[:2])
        while not taken or not ports.drained:
            ports.receive()
        assert ports.overflowed() == {"forward": 200 - len(taken), "backward": 0}
        assert 0 < len(taken) < 200


def test_addresses_that_cannot_be_used_are_named(echo: Echo) -> None:
    with closing(opened("127.0.0.1")) as taken:
        place, target = Place(*taken.getsockname()), Place(*echo.address)
        with pytest.raises(ConfigError, match=f"cannot listen at {place}: Address already in use"):
            UdpPorts(place, target, 1)
    with pytest.raises(ConfigError, match=r"the target no\.such\.host\.invalid:5 has no address: "):
        UdpPorts(Place("127.0.0.1", place.port), Place("no.such.host.invalid", 5), 1)


# --- what is kept and reported of it ---


class FullDisk(io.BytesIO):
    """A file that takes no more than so many bytes."""

    room = 1 << 30

    def write(self, data: Any) -> int:
        if self.tell() + len(data) > self.room:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        return super().write(data)


def test_a_full_disk_ends_the_recording_and_not_the_link() -> None:
    line, disk = Line(), FullDisk()
    keeper = Keeper(RecordingWriter(disk, Path("x.mcap"), "delay_node@master", FileSettings()))
    line.send(b"one")
    line.advance_ms(200)
    for topic, message in line.bench.sent:
        keeper(topic, message.seq, message.t_ns, message.src, encode(message))
    assert not keeper.fault
    disk.room = disk.tell()
    for at_s in range(3):
        late = line.bench.make("link/delay", "delay_node@master", direction="forward", hand_t_ns=0, delay_ns=0,
                               transit_ns=0, clock_ahead_ns=0)  # fmt: skip
        line.bench.advance_ms(1500)
        keeper("link/delay", late.seq, late.t_ns, late.src, encode(late))
        line.send(b"%d" % at_s)
    assert keeper.fault == "the recording ends before the link: x.mcap: cannot be written: No space left on device"
    assert len(line.ports.sent) == 4
    keeper.close()


def test_what_the_sockets_had_no_room_for_is_in_the_recording_and_its_report(tmp_path: Path) -> None:
    settings = FileSettings.model_validate({"directory": tmp_path, "file_name": "line.mcap"})
    keeper = Keeper(RecordingWriter.create("delay_node@master", settings))
    keeper.close({"forward": 7, "backward": 0})
    assert overflows_in(keeper.path) == {"forward": 7}


def test_quantiles_are_those_of_what_was_counted() -> None:
    assert quantiles_ms({}, 1000) is None
    assert quantiles_ms({2: 989, 7: 10, 40: 1}, MS) == {"p50": 2.0, "p99": 7.0, "p999": 7.0, "max": 40.0}


def test_figures_count_losses_stalls_and_overtaking() -> None:
    rows = [("udp", n, n * 10 * MS, 20 * MS, 0, "", False) for n in range(20)]
    rows[5:8] = [("udp", n, n * 10 * MS, (100 - 10 * n) * MS, (80 - 10 * n) * MS, "", False) for n in (5, 6, 7)]
    rows[10:12] = [("udp", n, n * 10 * MS, 0, 0, "loss", False) for n in (10, 11)]
    rows[15] = ("udp", 15, 150 * MS, 1 * MS, 0, "", True)
    rows.append(("other", 0, 0, 5 * MS, 0, "", False))
    found = figures(rows, None)
    assert (found["topic"], found["messages"], found["dropped"]) == ("udp", 20, {"loss": 2})
    assert (found["lost_share"], found["lost_in_a_row"], found["overtaken"]) == (0.1, 2, 1)
    assert (found["stalls"], found["longest_hold_ms"], found["delay_max_ms"]) == (1, 30.0, 50.0)
    assert figures(rows, "other")["messages"] == 1
    assert figures([], None)["messages"] == 0


@pytest.mark.check("starts the command, whose link is a rig of its own")
def test_the_command_carries_datagrams_changes_records_and_reports(tmp_path: Path, echo: Echo) -> None:
    environment = {"TELENANO_RUNTIME_DIR": str(tmp_path), "PATH": "/usr/bin:/bin"}
    telenano = [sys.executable, "-m", "telenano"]
    with closing(opened("127.0.0.1")) as free:
        port = free.getsockname()[1]
    out = tmp_path / "out.mcap"
    target = f"127.0.0.1:{echo.address[1]}"
    link = start(
        [*telenano, "link", "udp", str(port), target, "--set", "forward.delay_s=0.02", "--set",
         "backward.loss.probability=1", "--record", str(out), "--json"],
        env=environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
    )  # fmt: skip
    try:
        assert link.stderr is not None
        assert (
            f"ready: datagrams to 127.0.0.1:{port} are forwarded to {target} over the network custom"
            in link.stderr.readline()
        )
        with closing(opened("127.0.0.1")) as client:
            for number in range(100):
                client.sendto(b"%d" % number, ("127.0.0.1", port))
            assert echo.answer() == [b"%d" % number for number in range(100)]
            change = [*telenano, "link", "set", "profile=clean"]
            answer = run(change, env=environment, capture_output=True, text=True)
            assert answer.stdout == "delay_node@master ack: set profile = clean\n", answer.stderr
            client.sendto(b"last", ("127.0.0.1", port))
            assert echo.answer() == [b"last"]
            assert client.recv(100).startswith(b"last from ")
        beside = run([*telenano, "link", "udp", "1", target], env=environment, capture_output=True, text=True)
        assert (beside.returncode, beside.stdout) == (1, "")
        assert "another link runs beside it with --rig NAME" in beside.stderr
    finally:
        link.send_signal(signal.SIGINT)
        text, error = link.communicate(timeout=30.0)
    assert link.returncode == 0, error
    document = json.loads(text)
    assert (document["forward"]["arrived"], document["forward"]["sent"], document["unsent"]) == (101, 101, {})
    assert (document["backward"]["arrived"], document["backward"]["dropped"]) == (101, {"loss": 100})
    assert document["recording"] == str(out)
    fates = fates_in(out)
    assert [row[3] for row in fates["forward"]] == [20 * MS] * 100 + [0]
    report = run([*telenano, "link", "report", str(out), "--json"], capture_output=True, text=True, check=True)
    assert json.loads(report.stdout)["backward"]["lost_share"] == pytest.approx(100 / 101)
