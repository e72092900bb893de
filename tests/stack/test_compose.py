"""The compose file on a real engine: up, healthy, the experiment, a node killed, and what is left after down."""

import json
import os
import shutil
import socket
import subprocess
import time
import urllib.request
from collections.abc import Callable, Iterator
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple

import machine
import msgpack
import pytest
from ledger import record

from services.viz_node.requests import PROTOCOL
from telenano.analysis.report import write_report
from telenano.cli.exit_codes import EXIT_INCOMPLETE
from telenano.cli.output import closing_lines
from telenano.recording.messages import RecordedMessage
from telenano.recording.reader import Recording

ROOT = Path(__file__).resolve().parents[2]
# whose copy of the project it is, where a test may give it away
OWNER = 12345 if os.geteuid() == 0 else os.getuid()
NODES = ("haptic_node", "controller_master", "delay_node", "controller_slave", "afm_node", "recorder")
VIEW = "viz_node"
# the image of every container of the rig (compose.yaml)
IMAGE = "telenano-rig"
PROJECT = f"telenano-test-{os.getpid()}"
# the first build fetches every package; later ones take seconds
BUILD_S, PATIENCE_S = 1500.0, 180.0
SOON_NS = 1_000_000_000
# the rate of each session until the machine lets one through; the first has that of its scenario
RATES_HZ = ("", "500", "250")
# round trip at which the contact becomes unstable under the paper's law (studies.md), and the part of it allowed
CRITICAL_MS, LATEST_SHARE = 51.0, 0.5


def run(
    *command: str, timeout: float = PATIENCE_S, check: bool = True, rate_hz: str = "", folder: Path = ROOT
) -> subprocess.CompletedProcess[str]:
    # what the caller's environment sets for scenarios is not for these tests
    environment = {name: value for name, value in os.environ.items() if not name.startswith("TELENANO")}
    environment["VIEW_PORT"] = str(VIEW_PORT)
    if rate_hz:
        environment["TELENANO__REALTIME__RATE_HZ"] = rate_hz
    done = subprocess.run(
        command, cwd=folder, env=environment, stdin=subprocess.DEVNULL, capture_output=True, text=True, timeout=timeout
    )
    assert done.returncode == 0 or not check, f"{' '.join(command)}\n{done.stdout[-3000:]}\n{done.stderr[-3000:]}"
    return done


def works(*command: str) -> bool:
    try:
        return subprocess.run(command, capture_output=True, timeout=30).returncode == 0
    except (OSError, subprocess.TimeoutExpired):
        return False


def compose_command() -> list[str]:
    """Give the compose command of this machine; skips where there is none, or no engine that answers."""
    if not works("docker", "info"):
        pytest.skip("no Docker engine answers (`docker info` fails): the compose files are not tried")
    for command in (["docker", "compose"], ["docker-compose"]):
        if works(*command, "version"):
            return command
    pytest.skip("neither `docker compose` nor `docker-compose` is installed: the compose files are not tried")


# It builds the images, for minutes: before a release, and where the change touches how they are made or what they
# install, which deploy/locks has.
pytestmark = [pytest.mark.timeout(1800), pytest.mark.drawn(0.0, "deploy/")]


def free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port: int = probe.getsockname()[1]
    return port


VIEW_PORT = free_port()


class Kill(NamedTuple):
    at_ns: int
    restarts: int
    pid: int


class Composed:
    """The rig of the compose file under a project name of its own."""

    def __init__(self, command: list[str], folder: Path) -> None:
        # As a person calls it, but for the name: another rig of this machine may have that of the folder.
        self.command = [*command, "-p", PROJECT]
        self.folder = folder
        self.rate_hz = ""

    def compose(self, *arguments: str, timeout: float = PATIENCE_S, check: bool = True) -> str:
        options: dict[str, Any] = {"timeout": timeout, "check": check, "rate_hz": self.rate_hz, "folder": self.folder}
        return run(*self.command, *arguments, **options).stdout

    def container(self, service: str) -> str:
        return run("docker", "ps", "-aq", *self.label(service)).stdout.split()[0]

    def label(self, service: str) -> list[str]:
        labels = (f"com.docker.compose.project={PROJECT}", f"com.docker.compose.service={service}")
        # containers of `run` have the same service
        return [
            word for label in (*labels, "com.docker.compose.oneoff=False") for word in ("--filter", f"label={label}")
        ]

    def inspect(self, service: str) -> dict[str, Any]:
        found: dict[str, Any] = json.loads(run("docker", "inspect", self.container(service)).stdout)[0]
        return found

    def healthy(self, service: str) -> bool:
        return bool(self.inspect(service)["State"].get("Health", {}).get("Status") == "healthy")

    def logs(self, *services: str) -> str:
        return self.compose("logs", "--no-color", *services)

    def telenano(self, *arguments: str, check: bool = True) -> str:
        """Run a telenano command in a container beside the rig."""
        return self.compose("run", "--rm", "-T", "session", "telenano", *arguments, check=check)

    def recordings(self, into: Path) -> Path:
        """Copy what is on the volume of recordings."""
        run("docker", "cp", f"{self.container('recorder')}:/recordings", str(into))
        return into

    def kill(self, service: str) -> Kill:
        """kill -9 the node in a container; `docker kill` would be taken for a wish to have it stopped."""
        restarts = int(self.inspect(service)["RestartCount"])
        at_ns = time.time_ns()
        find = "set -- $(cat /proc/1/task/1/children); kill -9 $1; echo $1"
        done = run("docker", "exec", self.container(service), "sh", "-c", find)
        return Kill(at_ns, restarts, int(done.stdout))

    def wait_until(self, condition: Callable[[], bool], what: str, patience_s: float = PATIENCE_S) -> None:
        end = time.monotonic() + patience_s
        while not condition():
            assert time.monotonic() < end, f"waited in vain for: {what}\n{self.compose('ps')}\n{self.logs()[-6000:]}"
            time.sleep(0.5)


def cloned(folder: Path) -> Path:
    """Copy the files of the project that git knows, as a clone has them, and give them to their owner."""
    names = run("git", "ls-files", "-z", "--cached", "--others", "--exclude-standard").stdout.split("\0")
    for name in filter(lambda name: (ROOT / name).is_file(), names):
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(ROOT / name, folder / name)
    for path in (folder, *folder.rglob("*")):
        os.chown(path, OWNER, -1)
    return folder


@pytest.fixture(scope="module")
def rig(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Composed]:
    composed = Composed(compose_command(), cloned(tmp_path_factory.mktemp("clone")))
    try:
        composed.compose("build", timeout=BUILD_S)
        composed.compose("up", "-d")
        yield composed
    finally:
        composed.compose("down", "-v", "--remove-orphans", check=False)


@pytest.fixture(scope="module")
def first(rig: Composed, tmp_path_factory: pytest.TempPathFactory) -> tuple[dict[str, Any], Path]:
    """The session that `up` runs: its summary, and the folder with the recordings.

    Where real time is not granted, whatever else runs here can hold up a node for longer than a device waits for its
    commands, or than the law bears; such a session shows the guards and not the experiment, and `up` runs another one
    at a lower rate, in new containers.
    """
    for rate_hz in RATES_HZ:
        if rate_hz:
            rig.rate_hz = rate_hz
            rig.compose("up", "-d")
        rig.wait_until(lambda: rig.inspect("session")["State"]["Status"] == "exited", "the end of the session")
        code = rig.inspect("session")["State"]["ExitCode"]
        folder = rig.recordings(tmp_path_factory.mktemp("first") / "recordings")
        newest = max(folder.glob("sessions/fig12-*/summary.json"), key=lambda path: path.parent.name)
        summary = json.loads(newest.read_text())
        assert code == expected_code(summary), rig.logs()
        if undisturbed(summary, folder):
            return summary, folder
    machine.note(
        f"none of {len(RATES_HZ)} sessions in containers went through without a node being held up (age of the loop at "
        f"99 %: {summary['loop_age_ms']['p99']:.0f} ms): the experiment was not judged in containers"
    )
    return summary, folder


def expected_code(summary: dict[str, Any]) -> int:
    """Return the exit code of a session, whose recorder says what it lost when the machine held it up."""
    return 0 if summary["recording"]["complete"] else EXIT_INCOMPLETE


def undisturbed(summary: dict[str, Any], folder: Path) -> bool:
    """Return whether the machine let a session be the experiment."""
    in_time = summary["loop_age_ms"]["p99"] < LATEST_SHARE * CRITICAL_MS and summary["recording"]["complete"]
    return in_time and coupled_throughout(folder / Path(summary["recording"]["file"]).name)


def coupled_throughout(path: Path) -> bool:
    """Return whether the tip followed from its first command to the end of a recording."""
    modes = [message.decode().mode for message in Recording(path).messages(["afm/state"])]
    return set(modes[modes.index("follow") :]) == {"follow"}


def test_every_node_gets_healthy(rig: Composed) -> None:
    rig.wait_until(lambda: all(map(rig.healthy, NODES)), "health of every node")
    for service in NODES:
        checks = rig.inspect(service)["State"]["Health"]["Log"]
        assert any(" Hz, up for " in check["Output"] for check in checks if check["ExitCode"] == 0)


def test_the_engine_holds_every_container_to_its_limits(rig: Composed) -> None:
    for service in (*NODES, VIEW):
        limits = rig.inspect(service)["HostConfig"]
        assert limits["Memory"] >= 512 * 2**20, service
        assert 0 < limits["PidsLimit"] <= 256, service


def test_the_page_is_on_loopback_and_shows_the_rig(rig: Composed) -> None:
    from websockets.sync.client import connect

    rig.wait_until(lambda: rig.healthy(VIEW), "health of the page")
    # as docs/deployment.md says
    addresses = rig.compose("exec", "-T", VIEW, "telenano", "view", "--addresses").splitlines()
    operator = next(line for line in addresses if line.startswith("operator: "))
    base, _, token = operator.split()[1].partition("/#")
    log = rig.logs(VIEW)
    assert base in log
    assert token not in log
    assert base == f"http://127.0.0.1:{VIEW_PORT}"
    with urllib.request.urlopen(base, timeout=PATIENCE_S) as answer:
        assert b"<title>telenano" in answer.read()
    found: set[str] = set()
    with connect(base.replace("http", "ws") + "/bus", origin=base, max_size=None) as page:  # type: ignore[arg-type]
        page.send(msgpack.packb({"k": "hello", "token": token, "protocol": PROTOCOL}))
        while len(found) < len(NODES):
            found |= set(msgpack.unpackb(page.recv(timeout=PATIENCE_S)).get("nodes", {}))
    assert {"afm_node@slave", "haptic_node@master"} <= found


def test_experiment_is_that_of_the_bare_machine(first: tuple[dict[str, Any], Path]) -> None:
    summary, folder = first
    if not undisturbed(summary, folder):
        pytest.skip("no session in containers went through without a node being held up")
    assert summary["stable"] is True
    assert summary["hold_ratio"] == pytest.approx(1.050, abs=0.005)
    assert summary["contact_x_cm"] == pytest.approx(0.703, abs=0.010)
    assert abs(summary["release_force_nn"]) < 0.02


def test_recording_of_the_volume_says_the_same_here(first: tuple[dict[str, Any], Path], tmp_path: Path) -> None:
    summary, folder = first
    path = folder / Path(summary["recording"]["file"]).name
    again = write_report(path, tmp_path)
    assert again["recording"].pop("file") == str(path)
    assert again["recording"] == {key: summary["recording"][key] for key in again["recording"]}
    assert again["loop_age_ms"] == summary["loop_age_ms"]
    assert again["hold_ratio"] == summary["hold_ratio"]


def test_closing_lines_and_nodes_are_in_the_logs(rig: Composed, first: tuple[dict[str, Any], Path]) -> None:
    summary, folder = first
    session = rig.logs("session")
    assert closing_lines(summary, folder)[0] in session
    # compose says to which container it attached
    said = [line for line in session.splitlines() if line.strip() and "warning: " not in line]
    assert len(said) <= 12, session
    output = rig.logs("afm_node")
    assert "afm_node@slave: ready" in output
    assert "armed: the tip " in output


def test_a_session_is_whole_in_out_and_belongs_to_the_owner_of_the_project(
    rig: Composed, first: tuple[dict[str, Any], Path]
) -> None:
    summary, folder = first
    newest = max((folder / "sessions").glob("fig12-*")).name
    out = rig.folder / "out" / newest
    assert {"fig12.png", "session.mcap", "summary.json"} <= {path.name for path in out.iterdir()}
    found = [rig.folder / "out", *(rig.folder / "out").rglob("*")]
    assert {path.stat().st_uid for path in found} == {OWNER}
    recorded = folder / Path(summary["recording"]["file"]).name
    assert (out / "session.mcap").read_bytes() == recorded.read_bytes()
    here = json.loads((out / "summary.json").read_text())
    assert here["recording"].pop("file") == f"out/{newest}/session.mcap"
    assert here == {**summary, "recording": {k: v for k, v in summary["recording"].items() if k != "file"}}
    log = rig.logs("session")
    assert f"./out/{newest} has " in log
    assert "next: Ctrl-C or `docker compose down` ends the nodes" in log
    assert f"page: http://127.0.0.1:{VIEW_PORT}/; " in log


def test_a_port_that_is_taken_is_reported_by_the_variable_that_sets_it(rig: Composed) -> None:
    with socket.socket() as other:
        other.bind(("127.0.0.1", 0))
        other.listen()
        given = ["-e", "TELENANO_NODE=viz_node@master", "-e", f"TELENANO__VIZ_NODE__PORT={other.getsockname()[1]}"]
        done = run("docker", "run", "--rm", "--network", "host", *given, IMAGE, check=False)
    assert done.returncode == 2
    assert "Address already in use: set VIEW_PORT to another one" in done.stderr
    assert "Traceback" not in done.stderr


def test_what_is_not_granted_is_warned_of(rig: Composed) -> None:
    rig.wait_until(lambda: all(map(rig.healthy, NODES)), "health of every node")
    for service in NODES[:-1]:
        output = rig.logs(service)
        granted = "realtime=True memory_locked=True" in output
        assert granted or "is not permitted" in output or "cannot be locked" in output, output


def test_containers_run_as_nobody_special(rig: Composed) -> None:
    look = (
        "id -u; touch /opt/x 2>&- || echo read-only; grep -E 'CapEff|NoNewPrivs' /proc/self/status; ls /sys/class/net"
    )
    for service in NODES:
        output = run("docker", "exec", rig.container(service), "sh", "-c", look).stdout.split()
        assert output == ["10001", "read-only", "CapEff:", "0000000000000000", "NoNewPrivs:", "1", "lo"]


@pytest.fixture(scope="module")
def wreck(rig: Composed, first: object, tmp_path_factory: pytest.TempPathFactory) -> tuple[Kill, Path, Any]:
    """A second session, in which the AFM's process is killed; ended as Ctrl-C does."""
    container = rig.compose(
        "run", "-d", "session", "telenano", "up", "--attach", "--scenario", "fig12", "--duration", "600", "--headless"
    ).split()[-1]
    try:
        rig.wait_until(lambda: "running for" in run("docker", "logs", container).stdout, "a second session")
        time.sleep(3.0)  # coupled operation before the kill, so that the recording has it
        kill = rig.kill("afm_node")
        rig.wait_until(lambda: rig.logs("afm_node").count("afm_node@slave: ready") >= 2, "the restart")
        rig.wait_until(lambda: rig.healthy("afm_node"), "health after the restart")
        state = rig.inspect("afm_node")
        run("docker", "stop", "-t", "30", container)
        assert "Traceback" not in run("docker", "logs", container).stderr
    finally:
        run("docker", "rm", "-f", container, check=False)
    return kill, rig.recordings(tmp_path_factory.mktemp("wreck") / "recordings"), state


def test_killed_container_is_started_again(wreck: tuple[Kill, Path, Any]) -> None:
    kill, _, state = wreck
    assert state["RestartCount"] == kill.restarts + 1
    assert state["State"]["Running"] is True


def of_kill(folder: Path, topic: str, kill: Kill) -> list[RecordedMessage]:
    """Give what was recorded on a topic from the kill on, whichever file it is in."""
    messages = [m for path in sorted(folder.glob("*.mcap")) for m in Recording(path).messages([topic])]
    return sorted((m for m in messages if m.publish_ns >= kill.at_ns), key=lambda message: message.publish_ns)


def test_recording_shows_the_safe_state(wreck: tuple[Kill, Path, Any]) -> None:
    kill, folder, _ = wreck
    tip = of_kill(folder, "afm/state", kill)
    # the kill is told when the engine has carried it out, so what comes before the tip falls silent is not of it
    last, first = max(pairwise(tip), key=lambda pair: pair[1].publish_ns - pair[0].publish_ns)
    back = first.decode()
    # the new process begins to count, and begins safe
    assert back.seq < 1000
    assert back.mode == "retracted"
    hand = [
        (message.publish_ns, message.decode().mode)
        for message in of_kill(folder, "haptic/state", kill)
        if last.publish_ns <= message.publish_ns <= first.publish_ns
    ]
    driven = [published_ns for published_ns, mode in hand if mode != "off"]
    off_ns = max(driven, default=last.publish_ns)
    # within a second off, and off for as long as there is no tip
    assert off_ns - last.publish_ns < SOON_NS, hand[-1]
    assert hand[-1][1] == "off"
    record(
        "the AFM's process is killed in its container",
        f"hand off after {(off_ns - last.publish_ns) * 1e-6:.0f} ms; the tip was back, withdrawn, "
        f"{(first.publish_ns - last.publish_ns) * 1e-9:.1f} s after the kill",
    )


def test_recording_has_the_restart(wreck: tuple[Kill, Path, Any]) -> None:
    kill, folder, _ = wreck
    output = [message.decode().text for message in of_kill(folder, "session/event", kill)]
    # which of both depends on how long the engine took
    back = ("afm_node@slave was restarted", "afm_node@slave is alive again")
    assert any(text.startswith(back) for text in output), output


def test_wrong_setting_does_not_loop_for_ever(rig: Composed) -> None:
    name = f"{PROJECT}-wrong"
    wrong = ["-e", "TELENANO_NODE=controller@master", "-e", "TELENANO__CONTROLLER__LAW=magic"]
    try:
        run("docker", "run", "-d", "--name", name, "--network", "none", "--restart", "on-failure:5", *wrong,
            IMAGE)  # fmt: skip

        def given_up() -> bool:
            state = json.loads(run("docker", "inspect", name).stdout)[0]
            return bool(state["State"]["Status"] == "exited" and state["RestartCount"] == 5)

        rig.wait_until(given_up, "an end of the restarts")
        state = json.loads(run("docker", "inspect", name).stdout)[0]["State"]
        assert state["ExitCode"] == 2
        output = run("docker", "logs", name)
        assert "controller.law" in output.stdout + output.stderr
        assert "Traceback" not in output.stderr
    finally:
        run("docker", "rm", "-f", name, check=False)


def test_down_leaves_the_recording(rig: Composed, first: tuple[dict[str, Any], Path], wreck: object) -> None:
    summary, _ = first
    rig.compose("stop")
    codes = {service: rig.inspect(service)["State"]["ExitCode"] for service in NODES}
    assert codes == dict.fromkeys(NODES, 0)
    rig.compose("down")
    assert run("docker", "ps", "-aq", "--filter", f"label=com.docker.compose.project={PROJECT}").stdout == ""
    volume = f"{PROJECT}_recordings"
    run("docker", "volume", "inspect", volume)
    report = ["telenano", "report", summary["recording"]["file"], "--out", "/recordings/again", "--json"]
    command = ("docker", "run", "--rm", "--network", "none", "-v", f"{volume}:/recordings", IMAGE)
    done = run(*command, *report, check=False)
    assert done.returncode == expected_code(summary), done.stderr
    assert json.loads(done.stdout) == summary
