"""The page beside a rig: what keeps it away is one line, and nothing of it keeps the rig from running."""

import sys
import tempfile
import time
import urllib.request
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import msgspec
import pytest
from launcher_bench import SECOND_NS, FakeChildren, health

from telenano.launcher.page import inherited_by_page
from telenano.launcher.plan import Plan, UpRequest, make_plan
from telenano.launcher.processes import NodeProcesses, node_command
from telenano.launcher.restart_policy import CRASH_LOOP_EXITS, MAX_DELAY_S
from telenano.launcher.supervisor import Supervisor
from telenano.launcher.watchdog import ProcessSample, Watchdog
from telenano.runtime.loop.healthcheck import endpoint_of, receive_health
from telenano.runtime.wiring.main import EXIT_BAD_START, EXIT_DIED
from telenano.serving import serve
from telenano.testing import VirtualClock
from telenano.timing.clock import SystemClock
from telenano.wire.extras import how_to_install
from telenano.wire.messages import NodeHealth
from telenano.wire.nodes import PAGE, STOP_ORDER

NODE = "afm_node@slave"
PATIENCE_S = 60.0


@pytest.fixture
def runtime(monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    # a socket's path is short by law, pytest's folders are not
    with tempfile.TemporaryDirectory(prefix="tnp-") as folder:
        monkeypatch.setenv("TELENANO_RUNTIME_DIR", folder)
        yield Path(folder)


def plan_of(folder: Path, *settings: str, **options: Any) -> Plan:
    request = UpRequest(scenario="fig12", out=folder / "out", settings=settings, page=True, **options)
    return make_plan(request, folder)


def needs_page() -> None:
    pytest.importorskip("uvicorn")
    if serve.page_folder() is None:
        pytest.skip("the page has not been built: make page")


def fetched(address: str) -> bytes:
    with urllib.request.urlopen(address, timeout=PATIENCE_S) as answer:
        found: bytes = answer.read()
    return found


def said_of(plan: Plan) -> list[str]:
    shown: list[str] = []
    with inherited_by_page(plan, shown.append) as beside:
        assert beside == {}
    return shown


def test_without_its_packages_or_its_page_the_rig_runs_without_a_view(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    plan = plan_of(tmp_path)
    monkeypatch.setattr(serve, "_PACKAGES", ("no_such_package",))
    assert said_of(plan) == [f"no view: no_such_package is not installed: {how_to_install('view')}"]
    monkeypatch.setattr(serve, "_PACKAGES", ())
    monkeypatch.setattr(serve, "page_folder", lambda: None)
    assert said_of(plan) == ["no view: its page has not been built: `make page` in the repository builds it"]


def test_a_site_file_of_before_and_an_address_that_cannot_be_had_leave_the_rig_without_a_view(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr("telenano.launcher.page.missing_for_view", lambda: "")
    plan = plan_of(tmp_path, "viz_node.host=0.0.0.0")
    assert "give --certificate and --key" in said_of(plan)[0]
    old = tmp_path / "old.yaml"
    lines = plan.site_file.read_text().splitlines()
    old.write_text("\n".join(line for line in lines if PAGE not in line))
    request = UpRequest(scenario="fig12", site_file=old, out=tmp_path / "old", page=True)
    assert said_of(make_plan(request, tmp_path)) == [f"no view: {old} has no {PAGE}"]


def test_nothing_is_served_where_nobody_asked_for_it(tmp_path: Path) -> None:
    request = UpRequest(scenario="fig12", out=tmp_path / "out")
    assert said_of(make_plan(request, tmp_path)) == []
    assert not make_plan(UpRequest(scenario="fig12", site="slave", page=True), tmp_path).page


class Rig:
    """A supervisor of one node, with the page beside it, in virtual time; what it has reported, and of which level."""

    def __init__(self, children: FakeChildren) -> None:
        self.clock = VirtualClock(start_ns=SECOND_NS)
        self.children = children
        self.supervisor = Supervisor(self.clock, [NODE], children, beside=[PAGE])
        self.reported: list[tuple[str, str]] = []
        self.supervisor.launch(self.report)

    def report(self, level: str, text: str, **data: object) -> None:
        self.reported.append((level, text))

    def end(self, code: int, wait_s: float = 0.0) -> None:
        """Let the page end, and look after a time [s] whether it is due."""
        self.children.ended[PAGE] = code
        self.supervisor.handle_exits(self.report)
        self.clock.advance_ns(round(wait_s * 1e9))
        self.supervisor.restart_due(self.report)


class FailingChildren(FakeChildren):
    """No process of the page can be started."""

    def start(self, node: str) -> int:
        if node == PAGE:
            raise OSError(24, "Too many open files")
        return super().start(node)


def test_a_page_that_ends_again_and_again_is_started_each_time_and_the_rig_goes_on() -> None:
    rig = Rig(FakeChildren())
    lives = 4 * CRASH_LOOP_EXITS
    for _ in range(lives):
        rig.end(EXIT_DIED, MAX_DELAY_S)
    assert rig.children.started == [NODE, *[PAGE] * (lives + 1)]
    assert rig.supervisor.failure == ""
    assert rig.reported[0] == (
        "warning",
        f"{PAGE} ended with exit code 1 after 0.0 s (the log tail of {PAGE}): it is started again in 0.1 s",
    )
    # the nodes of the rig are those that a session needs, with their restarts
    assert rig.supervisor.nodes == (NODE,)
    assert rig.supervisor.restarts() == {NODE: 0}


def test_a_page_that_cannot_start_as_it_is_configured_is_not_retried_and_the_rig_goes_on() -> None:
    rig = Rig(FakeChildren())
    rig.end(EXIT_BAD_START, PATIENCE_S)
    assert rig.children.started == [NODE, PAGE]
    assert rig.reported[0][0] == "error"
    assert rig.reported[0][1].endswith("it cannot start as it is configured and is not retried")
    assert (rig.supervisor.failure, rig.supervisor.bad_start) == ("", False)


def test_a_page_that_cannot_be_started_is_tried_later_and_the_rig_goes_on() -> None:
    rig = Rig(FailingChildren())
    rig.clock.advance_ns(round(0.1e9))
    rig.supervisor.restart_due(rig.report)
    assert rig.children.started == [NODE]
    text = f"{PAGE} cannot be started: [Errno 24] Too many open files"
    assert rig.reported == [
        ("warning", f"{text}: it is started again in 0.1 s"),
        ("warning", f"{text}: it is started again in 0.2 s"),
    ]


class Spinning:
    """The kernel's account of processes that take every moment of a processor."""

    def __init__(self, clock: VirtualClock) -> None:
        self._clock = clock

    def read(self, process_id: int) -> ProcessSample:
        return ProcessSample("R", self._clock.monotonic_ns() * 1e-9)


def test_a_page_whose_server_hangs_is_killed_and_started_again() -> None:
    clock, children = VirtualClock(start_ns=SECOND_NS), FakeChildren()
    supervisor = Supervisor(clock, [NODE], children, Watchdog(clock, Spinning(clock)), [PAGE])
    reported: list[str] = []

    def report(level: str, text: str, **data: object) -> None:
        reported.append(text)

    supervisor.launch(report)
    supervisor.record_health(msgspec.structs.replace(health(PAGE), pid=2), report)
    while children.started.count(PAGE) < 2 and clock.monotonic_ns() < 10 * SECOND_NS:
        clock.advance_ns(SECOND_NS // 20)
        supervisor.handle_hangs(report)
        supervisor.handle_exits(report)
        supervisor.restart_due(report)
    assert children.killed == [PAGE]
    assert "it hangs and is killed" in reported[0]
    assert reported[-1] == f"{PAGE} was started again"
    assert supervisor.failure == ""


def pid_of_page(plan: Plan) -> int:
    found = receive_health(endpoint_of(PAGE, plan.site_file), PAGE, PATIENCE_S)
    assert found is not None
    assert set(found) <= set(NodeHealth.__struct_fields__)
    return int(found["pid"])


@pytest.mark.check("takes 1.7 s")
def test_the_page_is_a_process_of_the_rig_with_its_address_from_the_beginning_and_over_a_kill(
    monkeypatch: pytest.MonkeyPatch, runtime: Path, tmp_path: Path
) -> None:
    needs_page()
    shown: list[str] = []
    # a terminal is shown the token
    monkeypatch.setattr(sys.stdout, "isatty", lambda: True, raising=False)
    plan = plan_of(tmp_path, "viz_node.port=0")
    plan.prepare_folder()
    clock, reported = SystemClock(), []
    with ExitStack() as stack:
        beside = stack.enter_context(inherited_by_page(plan, shown.append))
        commands = {PAGE: node_command(PAGE, plan.site_file, plan.scenario_file)}
        children = NodeProcesses(commands, STOP_ORDER, tmp_path, clock.epoch_offset_ns, inherited=beside)
        stack.callback(children.stop)
        supervisor = Supervisor(clock, [], children, beside=tuple(beside))

        def report(level: str, text: str, **data: object) -> None:
            reported.append(text)

        supervisor.launch(report)
        address = shown[0].removeprefix("view: ")
        token = address.partition("#")[2]
        assert b"<title>telenano" in fetched(address)
        first = pid_of_page(plan)
        children.kill(PAGE)
        end = time.monotonic() + PATIENCE_S
        while f"{PAGE} was started again" not in reported:
            assert time.monotonic() < end, reported
            supervisor.handle_exits(report)
            supervisor.restart_due(report)
            time.sleep(0.005)
        assert reported[0].startswith(f"{PAGE} was killed by SIGKILL after ")
        # whoever asks meanwhile waits for the answer of the new process
        assert b"<title>telenano" in fetched(address)
        assert pid_of_page(plan) != first
    with pytest.raises(OSError):
        urllib.request.urlopen(address, timeout=5.0)
    assert token
    assert token not in (tmp_path / f"{PAGE}.log").read_text()
