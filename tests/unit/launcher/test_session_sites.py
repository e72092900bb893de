"""A session over two sites, at the one that conducts it and at the one that follows."""

from collections.abc import Sequence
from io import StringIO
from pathlib import Path

import msgspec
import pytest
from launcher_bench import SECOND_NS, TICK_NS, Bench, Rig, health, row
from rich.console import Console

from telenano.cli.live_view import LineView, rig_picture
from telenano.launcher.readiness import READY_DEADLINE_S
from telenano.launcher.site_node import SiteNode
from telenano.launcher.supervisor import Supervisor
from telenano.wire.messages import ClockPing

MASTER = ("recorder@master", "delay_node@master", "controller@master", "haptic_node@master")
SLAVE = ("afm_node@slave", "controller@slave")
LINK = "delay_node@slave"
DEADLINE_TICKS = round(READY_DEADLINE_S * SECOND_NS / TICK_NS)
WITHOUT_INPUT = health("controller@master", inputs=(row("teleop/backward", received=False),))
ARM = "a tip that has retracted stays retracted until `telenano session arm --site "


def master(duration_s: float = 2.0) -> Rig:
    return Rig(duration_s, own=MASTER, others=SLAVE, site="master", other_site="slave")


class Slave(Bench):
    """The slave's site, with the link when it is there."""

    def __init__(self, beside: Sequence[str] = ()) -> None:
        super().__init__("launcher@slave")
        supervisor = Supervisor(self.clock, SLAVE, self.children, beside=beside)
        self.site = SiteNode(self.context, supervisor, Path("nowhere"))
        self.begin(self.site)

    def ping(self) -> None:
        self.receive(ClockPing(seq=0, t_ns=0, src=LINK, v=1), "clock/ping")

    def tick_linked(self, count: int) -> None:
        for _ in range(count):
            self.ping()
            self.tick()


@pytest.mark.check("takes 1.2 s")
def test_the_master_waits_for_the_slave_without_a_limit() -> None:
    rig = master()
    assert rig.children.started == list(MASTER)
    for _ in range(10 * DEADLINE_TICKS):
        rig.receive_health(*MASTER)
        # an input that only the other site sends does not count against this one
        rig.receive(WITHOUT_INPUT, "node/health")
        rig.tick()
    assert rig.session.phase == "starting"
    assert rig.session.causes() == dict.fromkeys(SLAVE, "has not reported yet")
    assert "controller@master" in rig.session.waiting()
    assert "for the slave's site without a limit" in rig.session.status_line()
    rig.tick_alive(6)
    assert rig.session.phase == "running"
    assert rig.reports == ["the slave's site is alive"]


def test_own_nodes_have_their_limit_whether_the_slave_is_there_or_not() -> None:
    rig = master()
    rig.receive_health(*MASTER[:3])
    rig.tick(DEADLINE_TICKS + 1)
    assert rig.finished
    assert rig.session.failure.startswith(
        "the rig was not ready within 60 s: haptic_node@master has not reported yet\nlast lines of haptic_node@master"
    )
    assert "slave" not in rig.session.failure


def test_inputs_have_their_limit_from_the_first_report_of_the_slave() -> None:
    rig = master()
    rig.receive_health(*MASTER)
    rig.tick(3 * DEADLINE_TICKS)
    for _ in range(DEADLINE_TICKS):
        rig.receive_health(*rig.rig_nodes)
        rig.receive(WITHOUT_INPUT, "node/health")
        rig.tick()
    assert not rig.finished
    rig.receive_health(*rig.rig_nodes)
    rig.receive(WITHOUT_INPUT, "node/health")
    rig.tick(3)
    assert rig.finished
    assert "controller@master does not receive teleop/backward" in rig.session.failure


def test_a_node_that_dies_late_in_a_long_wait_has_its_time_again() -> None:
    rig = master()
    rig.receive_health(*MASTER)
    rig.tick(2 * DEADLINE_TICKS)
    rig.children.ended = {"haptic_node@master": -9}
    rig.tick(DEADLINE_TICKS - 1)
    assert not rig.finished
    assert rig.children.started[-1] == "haptic_node@master"
    rig.receive_health("haptic_node@master")
    rig.tick(DEADLINE_TICKS)
    assert not rig.finished


def test_a_pulled_cable_is_reported_and_the_session_goes_on() -> None:
    rig = master(duration_s=100.0)
    rig.tick_alive(10)
    assert rig.session.phase == "running"
    for silence in (5, 60):
        rig.reports.clear()
        rig.tick_alive(20 * silence, missing=SLAVE)
        assert [text[:38] for text in rig.reports] == ["the slave's site has been silent since"]
        assert rig.session.status_line().endswith("silent: the slave's site")
        assert rig.session.phase == "running"
        rig.tick_alive(5)
        assert rig.reports[1].startswith(f"the slave's site is alive again after {silence}.")
        assert rig.reports[1].endswith(f"{ARM}master`")
        assert len(rig.reports) == 2
    states = [event.data["state"] for event in rig.bus.events() if event.data.get("about_node") == "the slave's site"]
    assert states == ["heard", "silent", "heard", "silent", "heard"]
    # only the operator arms again
    assert [control.command for control in rig.bus.controls()] == ["arm", "arm", "start"]


def test_one_node_of_the_slave_is_reported_by_its_name() -> None:
    rig = master(duration_s=100.0)
    rig.tick_alive(10)
    rig.reports.clear()
    rig.tick_alive(80, missing=["afm_node@slave"])
    assert [text[:31] for text in rig.reports] == ["afm_node@slave has been silent "]


def test_the_end_stops_the_own_nodes_only() -> None:
    rig = master(duration_s=1.0)
    rig.tick_alive(40)
    assert rig.finished
    rig.session.make_safe()
    assert rig.children.stopped == 1
    assert rig.bus.events()[-1].text == "the session is over, the nodes are stopped"


def test_the_slave_keeps_its_nodes_and_conducts_nothing() -> None:
    rig = Slave()
    assert rig.children.started == list(SLAVE)
    assert "has not reported yet" in rig.site.status_line()
    # a node is ready once it runs: its inputs come from the other site
    rig.receive(health("controller@slave", inputs=(row("teleop/forward", received=False),)), "node/health")
    assert rig.site.waiting() == {"afm_node@slave": "has not reported yet"}
    rig.receive_health("afm_node@slave")
    rig.tick()
    assert (rig.site.phase, rig.reports) == ("running", [])
    rig.tick_linked(3 * DEADLINE_TICKS)
    assert rig.reports == ["the master's site is alive"]
    assert rig.site.status_line() == "running, the master's site is alive and conducts; Ctrl-C stops the nodes here"
    assert rig.bus.controls() == []
    rig.site.interrupt()
    rig.tick()
    assert rig.finished
    assert rig.site.failure == ""
    assert rig.site.phase == "ending"
    rig.site.make_safe()
    assert rig.children.stopped == 1


@pytest.mark.parametrize(
    ("last", "alarm"),
    [
        ("warning: the relay r:1 cannot be reached or was lost: reset; trying again", " (relay@slave: the relay r:1 "),
        ("warning: the relay r:1 cannot be reached or was lost: reset\ninfo: the relay r:1 is reached", ""),
        ("", ""),
    ],
)
def test_a_relay_that_is_gone_is_named_with_the_site_that_it_silences(last: str, alarm: str) -> None:
    rig = Slave(beside=("viz_node@slave", "relay@slave"))
    rig.children.tails["relay@slave"] = last
    rig.receive_health(*SLAVE)
    rig.tick_linked(5)
    rig.tick(20 * 60)
    text = rig.reports[-1]
    assert text.startswith("the master's site has been silent since")
    assert (alarm in text) if alarm else ("(" not in text)


def test_the_slave_reports_the_masters_silence_and_return() -> None:
    rig = Slave()
    rig.receive_health(*SLAVE)
    rig.tick_linked(5)
    rig.tick(20 * 60)
    assert rig.reports[-1].startswith("the master's site has been silent since")
    assert "is silent, the nodes here wait for it" in rig.site.status_line()
    rig.tick_linked(20)
    assert rig.reports[-1].startswith("the master's site is alive again after 60.")
    assert rig.reports[-1].endswith(f"{ARM}slave`")
    assert len(rig.reports) == 3
    assert not rig.finished


def test_the_slave_starts_what_died_again_and_gives_up_what_cannot_run() -> None:
    rig = Slave()
    rig.receive_health(*SLAVE)
    rig.tick(2)
    rig.children.ended = {"afm_node@slave": -11}
    rig.tick(4)
    assert rig.children.started == [*SLAVE, "afm_node@slave"]
    assert "afm_node@slave was killed by SIGSEGV" in rig.reports[0]
    assert rig.reports[1] == "afm_node@slave was started again"
    rig.children.ended = {"controller@slave": 2}
    rig.tick()
    assert rig.finished
    assert "cannot start as it is configured" in rig.site.failure
    assert rig.site.supervisor.bad_start


def test_the_slave_gives_its_own_nodes_a_limit() -> None:
    rig = Slave()
    rig.receive_health("controller@slave")
    rig.tick_linked(DEADLINE_TICKS - 1)
    assert not rig.finished
    rig.tick_linked(2)
    assert rig.finished
    assert rig.site.failure.startswith("the site was not ready within 60 s: afm_node@slave has not reported yet\nlast")


def test_lines_show_news_and_missing_nodes() -> None:
    rig = master()
    text = StringIO()
    view = LineView(Console(file=text, width=200))
    rig.node.observe = view.observe
    for _ in range(400):
        rig.receive_health(*MASTER, "afm_node@slave")
        rig.tick()
    rig.tick_alive(6)
    lines = text.getvalue().splitlines()
    assert lines[0] == "the slave's site is alive"
    assert lines[1].startswith("waiting for 1 of 6 nodes to be ready (up to 60 s; ")
    assert "still waiting: controller@slave has not reported yet" in lines
    assert len([line for line in lines if line.startswith("still waiting")]) == 1
    assert lines[-1].startswith("running for 2 s")


def test_the_live_view_draws_a_site_without_a_session() -> None:
    rig = Slave()
    rig.node.observe = lambda node: None
    text = StringIO()
    Console(file=text, width=200).print(rig_picture(rig.site))
    assert "afm_node@slave has not reported yet" in text.getvalue()
    rig.receive_health(*SLAVE)
    rig.tick_linked(1)
    Console(file=text, width=200).print(rig_picture(rig.site))
    assert "the master's site is alive and conducts" in text.getvalue()


def test_the_master_waits_at_the_end_for_what_the_slave_sent_last_and_names_what_did_not_come() -> None:
    rig = master(duration_s=2.0)
    rig.tick_alive(6)
    assert rig.session.phase == "running"

    def tick(recorded_s_ago: float) -> None:
        now_ns = rig.clock.now_ns()
        rows = tuple(row("node/health", node, age_s=recorded_s_ago) for node in SLAVE)
        for node, inputs in (*((node, ()) for node in (*MASTER[1:], *SLAVE)), (MASTER[0], rows)):
            rig.receive(msgspec.structs.replace(health(node, inputs=inputs), t_ns=now_ns), "node/health")
        rig.tick()

    for _ in range(45):
        tick(0.1)
    assert rig.session.phase == "ending"
    # four seconds of what the slave sent are under way when the session ends, and the line gives up
    for _ in range(60):
        tick(4.0)
    assert not rig.finished
    assert any("waiting for the last messages of afm_node@slave, controller@slave" in line for line in rig.reports)
    for _ in range(19 * 20):
        tick(30.0)
    assert rig.finished
    assert [text.partition(" in the last ")[0] for text in rig.session.not_recorded] == [
        f"what {node} sent" for node in SLAVE
    ]
