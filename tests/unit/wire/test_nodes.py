"""The table of nodes against everything else that names them: folders, topics, scenario, sites, containers, images."""

import ast
import importlib
import importlib.util
import re
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import pytest
import yaml
from makefile import makefile_words

from telenano.launcher.processes import node_command
from telenano.runtime.bus.address_book import AddressBook
from telenano.runtime.wiring.main import NodeKind, node_kind
from telenano.settings import DEFAULT_SITE_FILE, TWO_SITES_FILE
from telenano.settings.included import SITE_DIRECTORY
from telenano.settings.scenario import Scenario
from telenano.wire.nodes import (
    HAND,
    LAUNCHER,
    LINK,
    NODES,
    OPTIONAL_NODES,
    PAGE,
    PLAYER,
    RECORDER,
    RERUN_NODES,
    SERVICES,
    START_ORDER,
    STOP_ORDER,
    TIP,
    NodeRow,
    endpoints_of,
    is_console,
    is_visitor,
    module_of,
    name_of,
    no_rerun_reason,
    site_of,
    sites_of,
)
from telenano.wire.topics import OWN_TOPICS as TOPICS

ROOT = Path(__file__).resolve().parents[3]
COMPOSE = [ROOT / name for name in ("compose.yaml", "deploy/compose.master.yml", "deploy/compose.slave.yml")]
KEYS = {row.key for row in NODES}
# services of the compose files and images that are no node of the rig
NO_NODES = {"session", "study", "keys"}


def folders() -> set[str]:
    """Return the folders of services/ that run as a process of the bus: those whose __main__ declares a NodeKind."""
    found = set()
    for path in ROOT.glob("services/*/__main__.py"):
        module = importlib.import_module(f"services.{path.parent.name}.__main__")
        if any(isinstance(value, NodeKind) for value in vars(module).values()):
            found.add(path.parent.name)
    return found


def without_a_folder(rows: Iterable[NodeRow]) -> set[str]:
    """Return the names of rig nodes that no folder of services/ can run."""
    return {name_of(row.key) for row in rows if row.part in ("rig", "endpoint")} - folders()


def declared(path: Path) -> dict[str, dict[str, Any]]:
    """Return the services of a compose file that stand for nodes of the rig."""
    services: dict[str, dict[str, Any]] = yaml.safe_load(path.read_text())["services"]
    return {name: service for name, service in services.items() if name not in NO_NODES}


def nodes_of(path: Path) -> dict[str, str]:
    """Return the node of each service of a compose file, its own or that of the service that it extends."""
    found = {}
    for name, service in declared(path).items():
        extended = service.get("extends")
        inherited = nodes_of(path.parent / extended["file"])[extended["service"]] if extended else ""
        found[name] = service["environment"].get("TELENANO_NODE", inherited)
    return found


def test_every_row_has_a_name_and_a_site_of_its_own() -> None:
    assert len(KEYS) == len(NODES)
    assert [row.key for row in NODES if not re.fullmatch(r"[a-z_]+@(master|slave)", row.key)] == []


def test_every_rig_node_has_a_folder_and_every_folder_a_row() -> None:
    assert without_a_folder(NODES) == set()
    assert folders() == set(SERVICES)


def test_a_row_without_a_folder_is_found() -> None:
    assert without_a_folder([*NODES, NodeRow("thermometer@slave", "rig", stop=8)]) == {"thermometer"}


@pytest.mark.parametrize("name", sorted(SERVICES))
def test_a_folder_declares_one_kind_under_its_own_name(name: str) -> None:
    module = importlib.import_module(f"services.{name}.__main__")
    kinds = [value for value in vars(module).values() if isinstance(value, NodeKind)]
    assert kinds == [node_kind(name)]
    assert kinds[0].name == name
    assert kinds[0].sites == sites_of(name) != ()


def test_launcher_and_player_have_a_folder_without_a_process_of_their_own() -> None:
    for key, room in ((LAUNCHER, "telenano"), (PLAYER, "services")):
        assert (ROOT / room / name_of(key) / "__init__.py").is_file()
        assert name_of(key) not in folders()


def test_every_process_that_a_rig_starts_has_a_row_and_can_be_run() -> None:
    started = {name_of(row.key) for row in NODES if row.part in ("rig", "beside", "carrier", "joint")}
    for name in started:
        assert importlib.util.find_spec(f"{module_of(name)}.__main__") is not None, name
    with_main = {path.parent.name for path in ROOT.glob("services/*/__main__.py")}
    assert with_main == started


@pytest.mark.parametrize("name", ["thermometer", "services.relay", "os", ""])
def test_a_process_without_a_row_cannot_be_started(name: str, tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="table of nodes"):
        module_of(name)
    with pytest.raises(ValueError, match="table of nodes"):
        node_command(f"{name}@master", tmp_path, tmp_path)


def test_the_names_that_code_uses_are_rows() -> None:
    assert {HAND, TIP, LAUNCHER, PLAYER, RECORDER} <= KEYS
    assert {f"{LINK}@{site}" for site in ("master", "slave")} <= KEYS


def test_start_and_stop_have_the_same_nodes() -> None:
    processes = [row for row in NODES if row.part in ("rig", "beside")]
    assert sorted(row.stop for row in processes) == list(range(1, len(processes) + 1))
    assert [row.key for row in NODES if row not in processes and row.stop] == []
    assert sorted(STOP_ORDER) == sorted([*START_ORDER, *OPTIONAL_NODES, PAGE])


def test_the_page_is_beside_the_rig() -> None:
    assert [row.key for row in NODES if row.part == "beside"] == [PAGE]
    assert PAGE not in {*START_ORDER, *OPTIONAL_NODES, *RERUN_NODES}
    assert node_kind(name_of(PAGE)).sites == (site_of(PAGE),)


def test_an_endpoint_belongs_to_a_node_of_the_rig() -> None:
    assert {name_of(row.key) for row in NODES if row.part == "endpoint"} <= set(SERVICES)


def test_visitors_are_known_by_name() -> None:
    parts = {row.key: row.part for row in NODES}
    assert {key for key in parts if is_visitor(key)} == {key for key in parts if parts[key] in ("beside", "visitor")}
    assert is_console("console_desk@master")
    assert not is_console(LAUNCHER)


def test_publishers_of_topics_are_rows() -> None:
    named = {publisher for topic in TOPICS.values() for publisher in topic.publishers if "*" not in publisher}
    assert {name for name in named if name not in KEYS | {name_of(key) for key in KEYS}} == set()


def test_a_node_keeps_a_journal_or_its_row_says_why_it_is_not_run_again() -> None:
    publishers = TOPICS["node/journal"].publishers
    for row in NODES:
        assert (row.key in publishers or name_of(row.key) in publishers) == (not row.no_rerun), row.key
        assert no_rerun_reason(row.key) == row.no_rerun
    # the halves of the controller and the node of the link are imported where their processes build them
    names = {name: "__main__" if name in ("controller", "delay_node") else "node" for name in folders()}
    modules = {name: vars(importlib.import_module(f"services.{name}.{module}")) for name, module in names.items()}
    classes = {name: [value for value in found.values() if isinstance(value, type)] for name, found in modules.items()}
    journalled = {name for name, found in classes.items() if any(getattr(kind, "journalled", False) for kind in found)}
    assert journalled == {name_of(key) for key in RERUN_NODES}
    assert set(RERUN_NODES) <= set(START_ORDER)


def test_the_endpoints_of_the_link_are_at_both_sites() -> None:
    assert endpoints_of(f"{LINK}@master") == (f"{LINK}@master", f"{LINK}@slave")
    assert endpoints_of(TIP) == (TIP,)


def test_the_scenario_has_a_section_for_each_node() -> None:
    assert set(Scenario.model_fields) == {"name", "description", "duration_s", "realtime", "instrument", *SERVICES}


def test_the_local_site_has_every_node_that_is_not_optional() -> None:
    assert {row.key for row in NODES if row.required} <= set(AddressBook.load(DEFAULT_SITE_FILE).nodes)


def test_two_sites_have_every_node_of_the_rig() -> None:
    rig = {row.key for row in NODES if row.part not in ("carrier", "joint", "visitor")}
    assert rig <= set(AddressBook.load(TWO_SITES_FILE).nodes)


@pytest.mark.parametrize("path", sorted(SITE_DIRECTORY.glob("*.yaml")), ids=lambda path: path.stem)
def test_site_files_name_only_nodes_that_there_are(path: Path) -> None:
    assert {node for node in AddressBook.load(path).nodes if node not in KEYS and not is_console(node)} == set()


def test_containers_are_the_nodes_of_the_rig() -> None:
    whole, master, slave = (nodes_of(path) for path in COMPOSE)
    assert sorted(whole.values()) == sorted([*START_ORDER, PAGE])
    assert sorted([*master.values(), *slave.values()]) == sorted(STOP_ORDER)
    assert {site_of(node) for node in master.values()} == {"master"}
    assert {site_of(node) for node in slave.values()} == {"slave"}


def test_the_containers_of_all_nodes_run_the_image_of_the_rig() -> None:
    images = {image.partition(":")[0] for image in makefile_words("IMAGES")}
    assert images == {"rig", "study"}
    assert {service["image"] for service in declared(COMPOSE[0]).values()} == {"telenano-rig"}


def test_the_benchmark_of_containers_starts_every_node() -> None:
    tree = ast.parse((ROOT / "benchmarks" / "compose.py").read_text())
    lists = [
        ast.literal_eval(statement.value)
        for statement in tree.body
        if isinstance(statement, ast.Assign) and ast.unparse(statement.targets[0]) == "NODES"
    ]
    rig = sorted(name for name, node in nodes_of(COMPOSE[0]).items() if node != PAGE)
    assert [sorted(names) for names in lists] == [rig]
