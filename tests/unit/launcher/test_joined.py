"""Nodes that share a process: which of them do, and how the launcher starts, ends and stops them."""

import sys
from pathlib import Path
from typing import Any

import pytest

from telenano.launcher.plan import UpRequest, make_plan
from telenano.launcher.processes import NodeProcesses, joint_command
from telenano.launcher.restart_policy import describe_exit
from telenano.runtime.loop import turn_limit
from telenano.runtime.site.site_process import check_simulated
from telenano.wire.errors import ConfigError
from telenano.wire.nodes import HAND, TIP

SITES = "realtime.processes=site"
HALF, FAR_HALF, LINK = "controller@master", "controller@slave", "delay_node@master"
BOTH = {"site@master": (LINK, HALF, HAND), "site@slave": (FAR_HALF, TIP)}
# ends at SIGTERM, and writes how often it got one
COUNTING = """
import signal, sys, time
got = []
signal.signal(signal.SIGTERM, lambda *given: (got.append(1), print("asked", flush=True)))
print("up", flush=True)
while not got:
    time.sleep(0.01)
time.sleep(0.3)
"""


def joined(out: Path, *settings: str, **changes: Any) -> dict[str, tuple[str, ...]]:
    return make_plan(UpRequest(scenario="fig12", out=out, settings=settings, **changes), out).joined


def test_each_node_has_a_process_unless_a_scenario_asks_for_another_way(tmp_path: Path) -> None:
    assert joined(tmp_path) == joined(tmp_path, "realtime.processes=node") == {}
    assert joined(tmp_path, SITES) == BOTH


def test_a_node_that_is_left_out_is_in_no_process_and_one_alone_has_its_own(tmp_path: Path) -> None:
    assert joined(tmp_path, SITES, without=(HAND, TIP)) == {"site@master": (LINK, HALF)}
    assert joined(tmp_path, SITES, without=(LINK,)) == {**BOTH, "site@master": (HALF, HAND)}
    assert joined(tmp_path, SITES, site="slave") == {"site@slave": BOTH["site@slave"]}


def test_a_real_device_keeps_a_process_of_its_own(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    plan = make_plan(UpRequest(scenario="fig12", out=tmp_path, settings=(SITES,)), tmp_path)
    assert plan.joined == BOTH
    check_simulated(plan.loaded, BOTH["site@slave"])
    of_class = {"telenano.sections.hand_section.HapticConfig": {"site@master": (LINK, HALF), **_slave()},
                "telenano.sections.afm_section.AfmConfig": {"site@master": BOTH["site@master"]}}  # fmt: skip
    for config, expected in of_class.items():
        with monkeypatch.context() as patch:
            patch.setattr(f"{config}.simulated", False)
            assert plan.joined == expected
            # A process that is started by hand refuses it as well.
            with pytest.raises(ConfigError, match=r"drives a real device .* needs a process of its own"):
                check_simulated(plan.loaded, [HAND, TIP])


def _slave() -> dict[str, tuple[str, ...]]:
    return {"site@slave": BOTH["site@slave"]}


def test_nodes_of_one_process_are_on_one_processor(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"realtime.cpus: controller@slave on 0, afm_node@slave on 1: .*one process"):
        joined(tmp_path, SITES, "realtime.cpus={controller: 0, afm_node: 1}")
    assert joined(tmp_path, SITES, "realtime.cpus={recorder: 0, afm_node: 1}") == BOTH
    assert joined(tmp_path, "realtime.cpus={controller: 0, afm_node: 1}") == {}


def test_the_command_of_a_process_names_its_nodes(tmp_path: Path) -> None:
    command = joint_command("site@slave", BOTH["site@slave"], tmp_path / "site.yaml", tmp_path / "scenario.yaml", 7)
    assert command[1:3] == ["-m", "services.site"]
    assert command[-4:] == ["--node", FAR_HALF, "--node", TIP]


@pytest.fixture
def shared(tmp_path: Path) -> NodeProcesses:
    commands = {node: [sys.executable, "-c", COUNTING] for node in (FAR_HALF, TIP)}
    names = dict.fromkeys(commands, "site@slave")
    return NodeProcesses(commands, (FAR_HALF, TIP), tmp_path, 42, joined=names)


def started(children: NodeProcesses) -> int:
    first, second = children.start(FAR_HALF), children.start(TIP)
    assert first == second, "both are in the one process"
    while b"up" not in children.log_path(TIP).read_bytes():
        pass
    return first


def test_nodes_of_one_process_start_and_end_together(shared: NodeProcesses) -> None:
    before = started(shared)
    assert shared.log_path(FAR_HALF) == shared.log_path(TIP)
    shared.kill(TIP)
    ended: dict[str, int] = {}
    while not ended:
        ended = shared.reap()
    assert ended == {FAR_HALF: -9, TIP: -9}
    assert started(shared) != before
    shared.stop()


def test_a_process_of_several_nodes_is_asked_to_stop_once(shared: NodeProcesses) -> None:
    started(shared)
    shared.stop()
    assert shared.reap() == {}
    assert shared.log_tail(TIP).count("asked") == 1


@pytest.mark.skipif(turn_limit.SIGNAL is None, reason="this system has no such signal")
def test_a_turn_that_was_too_long_is_named_as_what_it_was() -> None:
    assert turn_limit.SIGNAL is not None
    assert (
        describe_exit(-turn_limit.SIGNAL) == "hung: a turn took more than 50 ms, which ends a process of several nodes"
    )
