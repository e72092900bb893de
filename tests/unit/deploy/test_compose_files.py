"""What can be known of image and compose files without an engine: that they agree with the project and each other."""

import importlib.util
import os
import re
import socket
import tomllib
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any

import pytest
import yaml
from makefile import makefile_words

from telenano.launcher.processes import LINGER_GRACE_S, RECORDER_GRACE_S
from telenano.runtime.bus.address_book import AddressBook
from telenano.runtime.wiring.main import node_kind
from telenano.settings import TWO_SITES_FILE
from telenano.settings.config import environment_overrides, layered, validate
from telenano.settings.scenario import LoadedScenario, RealtimeConfig, Scenario
from telenano.wire.errors import ConfigError
from telenano.wire.nodes import PAGE, START_ORDER, site_of

ROOT = Path(__file__).resolve().parents[3]
DEPLOY = ROOT / "deploy"
WHOLE = ROOT / "compose.yaml"
MASTER, SLAVE, RELAY = (DEPLOY / f"compose.{name}.yml" for name in ("master", "slave", "relay"))
DEVICES = DEPLOY / "compose.devices.yml"
# of a node of the rig: the page has none of its rights, see its own test
VIEW = "viz_node"
NOT_NODES = {"session", "study", "keys", "relay", VIEW}
# What installs, and what is not to be had everywhere, is no part of any environment.
TOOLS = {"gwyddion": "gwyddionpy-converter", "uv": "uv"}
# The locks of the images, and the variables of the Makefile that have their extras.
EXTRAS = {"node": "NODE", "rig": "RIG", "study": "STUDY"}
_PIN = re.compile(r"^([A-Za-z0-9._-]+)==([^ ;\\]+)")


def pins(lock: Path) -> dict[tuple[str, str], frozenset[str]]:
    """Give the hashes of each (name, version) of a lock."""
    found: dict[tuple[str, str], set[str]] = {}
    here: set[str] = set()
    for line in lock.read_text().splitlines():
        if match := _PIN.match(line):
            here = found.setdefault((match.group(1), match.group(2)), set())
        here.update(re.findall(r"--hash=(sha256:[0-9a-f]{64})", line))
    return {pin: frozenset(hashes) for pin, hashes in found.items()}


def makefile_images() -> dict[str, tuple[list[str], list[str]]]:
    """Give the locks and the packages of each image as `make image-locks` has them."""
    rows = [[*word.split(":"), ""][:3] for word in makefile_words("IMAGES")]
    return {image: (locks.split(","), [*filter(None, packages.split(","))]) for image, locks, packages in rows}


def compose(path: Path) -> dict[str, Any]:
    document: dict[str, Any] = yaml.safe_load(path.read_text())
    return document


def effective(path: Path) -> dict[str, dict[str, Any]]:
    """Give the services of a file with what they extend; of lists and mappings what both have."""
    services = {}
    for name, service in compose(path)["services"].items():
        base = (
            effective(path.parent / service["extends"]["file"])[service["extends"]["service"]]
            if "extends" in service
            else {}
        )
        merged = {**base, **service}
        for key in ("environment", "volumes"):
            if isinstance(base.get(key), dict):
                merged[key] = {**base[key], **service.get(key, {})}
            elif isinstance(base.get(key), list):
                merged[key] = [*base[key], *service.get(key, [])]
        services[name] = merged
    return services


def nodes(path: Path) -> dict[str, dict[str, Any]]:
    return {service["environment"]["TELENANO_NODE"]: service for name, service in effective(path).items()
            if name not in NOT_NODES}  # fmt: skip


def test_every_image_has_a_lock_and_its_extras_exist() -> None:
    extras = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["optional-dependencies"]
    images = makefile_images()
    locks = {*EXTRAS, *TOOLS, "build", "release"}
    assert {path.stem for path in (DEPLOY / "locks").glob("*.lock")} == locks
    assert {lock for locks, _ in images.values() for lock in locks} == set(EXTRAS)
    assert {name for variable in EXTRAS.values() for name in makefile_words(variable)} <= set(extras)
    built = [service["build"]["args"] for service in effective(WHOLE).values()]
    found = {(given["LOCK"], given["PACKAGES"]) for given in built}
    assert found == {(" ".join(locks), " ".join(packages)) for locks, packages in images.values()}
    # Services of one image build the same, so that it is built once.
    assert {service["image"] for service in effective(WHOLE).values()} == {f"telenano-{name}" for name in images}


@pytest.mark.parametrize("driver", ["haply", "gwyscope", "nanonis"])
def test_the_image_of_the_rig_has_the_package_of_each_driver(driver: str) -> None:
    packages = makefile_images()["rig"][1]
    projects = [tomllib.loads((ROOT / "packages" / name / "pyproject.toml").read_text()) for name in packages]
    entries = [project["project"]["entry-points"].get("telenano.devices", {}) for project in projects]
    assert driver in {name for devices in entries for name in devices}


@pytest.mark.parametrize("lock", sorted((DEPLOY / "locks").glob("*.lock")), ids=lambda path: path.stem)
def test_locks_are_parts_of_the_one_lock(lock: Path) -> None:
    whole, part = pins(ROOT / "requirements.lock"), pins(lock)
    assert part
    assert [pin for pin, hashes in part.items() if not hashes] == []
    if lock.stem in TOOLS:
        assert [name for name, _ in part] == [TOOLS[lock.stem]]
        return
    # A release is made in the environment of `make setup`, in which nothing may change; Node.js builds the page only.
    names = {name for name, _ in whole}
    shared = {pin: hashes for pin, hashes in part.items() if lock.stem not in ("build", "release") or pin[0] in names}
    assert {pin: hashes for pin, hashes in shared.items() if whole.get(pin) != hashes} == {}


@pytest.mark.parametrize("image", sorted(makefile_images()))
def test_the_locks_of_an_image_have_what_their_extras_and_its_packages_ask_for(image: str) -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    extras = project["optional-dependencies"]

    def names(requirements: list[str]) -> set[str]:
        found: set[str] = set()
        for requirement in requirements:
            own = re.fullmatch(r"telenano\[(.*)\]", requirement)
            if own:
                found |= {name for extra in own.group(1).split(",") for name in names(extras[extra])}
            else:
                found.add(re.split(r"[\[<>=~! ]", requirement)[0].lower().replace("_", "-"))
        return found

    locks, packages = makefile_images()[image]
    chosen = [name for lock in locks for name in makefile_words(EXTRAS[lock])]
    wanted = names(project["dependencies"] + [requirement for extra in chosen for requirement in extras[extra]])
    for package in packages:
        own = tomllib.loads((ROOT / "packages" / package / "pyproject.toml").read_text())["project"]
        wanted |= names(own["dependencies"]) - {"telenano"}
    locked = {name for lock in locks for name, _ in pins(DEPLOY / "locks" / f"{lock}.lock")}
    # what a package needs of the project is in the image beside it, and in no lock
    wanted -= set(packages)
    assert wanted <= locked
    # the project goes in as wheels, and the lock of an image has packages of an index alone
    assert not {name for name in locked if name.startswith("telenano")}


def test_one_service_for_each_node() -> None:
    assert sorted(nodes(WHOLE)) == sorted(START_ORDER)
    assert sorted(nodes(MASTER)) == sorted(node for node in START_ORDER if site_of(node) == "master")
    assert sorted(nodes(SLAVE)) == sorted([*(n for n in START_ORDER if site_of(n) == "slave"), "recorder@slave"])


@pytest.mark.parametrize("path", [WHOLE, MASTER, SLAVE, RELAY], ids=lambda path: path.name)
def test_containers_have_no_more_than_they_need(path: Path) -> None:
    for name, service in effective(path).items():
        assert service["read_only"] is True, name
        assert service["cap_drop"] == ["ALL"], name
        # What hands the files of a session over becomes the user of the others before anything of the project runs.
        hands_over = name == "session"
        assert (service.get("user") == "0:0") is hands_over, name
        assert (service.get("entrypoint") == ["python", "-P", "/opt/handover.py"]) is hands_over, name
        granted = (
            ["CHOWN", "KILL", "SETGID", "SETUID"]
            if hands_over
            else ["SYS_NICE"]
            if "TELENANO_NODE" in service["environment"] and name != VIEW
            else []
        )
        assert service.get("cap_add", []) == granted, name
        assert ("./out:/out" in service["volumes"]) is hands_over, name
        assert service["security_opt"] == ["no-new-privileges:true"], name
        assert service["init"] is True, name
        assert not set(service) & {"privileged", "pid", "ipc", "devices"}, name
        assert "docker.sock" not in str(service["volumes"]), name
        # the recorder of two machines listens to the far nodes too
        networked = "ports" in service or (path == MASTER and name == "recorder")
        network = "host" if name in (VIEW, "relay") else "bridge" if networked else "none"
        assert service["network_mode"] == network, name


def test_real_devices_give_the_handle_a_port_and_the_instrument_a_network_and_no_more() -> None:
    services = compose(DEVICES)["services"]
    calibrations = "${CALIBRATIONS:?in .env, the folder with handle.yaml and stage.yaml}:/calibrations:ro"
    assert services["haptic_node"] == {
        "devices": ["${HANDLE_PORT:?in .env, the serial port of the handle}:/dev/telenano-handle"],
        "group_add": ["${DIALOUT_GID:-20}"],
        "volumes": [calibrations],
    }
    assert services["afm_node"] == {"network_mode": "bridge", "volumes": [calibrations]}
    assert set(services) == {"haptic_node", "afm_node"} <= set(compose(WHOLE)["services"])


@pytest.mark.parametrize("path", [WHOLE, MASTER, SLAVE], ids=lambda path: path.name)
def test_nodes_come_back_after_a_crash_but_not_for_ever(path: Path) -> None:
    for service in nodes(path).values():
        assert re.fullmatch(r"on-failure:[1-9]", service["restart"])
        assert service["cap_add"] == ["SYS_NICE"]
        assert set(service["ulimits"]) == {"rtprio", "memlock"}
    for name in (NOT_NODES - {VIEW}) & set(effective(path)):
        assert "restart" not in effective(path)[name], name


@pytest.mark.parametrize("path", [WHOLE, MASTER, SLAVE], ids=lambda path: path.name)
def test_engine_waits_for_as_long_as_a_node_may_send(path: Path) -> None:
    for name, service in nodes(path).items():
        grace_s = float(service["stop_grace_period"].removesuffix("s"))
        assert grace_s >= (RECORDER_GRACE_S if name.startswith("recorder") else LINGER_GRACE_S), name


@pytest.mark.parametrize("path", [WHOLE, MASTER], ids=lambda path: path.name)
def test_the_page_is_reached_from_this_machine_only_and_is_checked(path: Path) -> None:
    service = effective(path)[VIEW]
    # the node of its environment, which the entry point runs, and which is checked as the image checks any node
    assert service["environment"]["TELENANO_NODE"] == PAGE
    assert {"command", "healthcheck", "ports"} & set(service) == set()
    # a terminal, on which the page prints its addresses
    assert service["tty"] is True
    settings = {key for key in service["environment"] if key.startswith("TELENANO__VIZ_NODE__")}
    assert settings == {"TELENANO__VIZ_NODE__PORT"}, "with a host it would not bind 127.0.0.1"
    assert re.fullmatch(r"on-failure:[1-9]", service["restart"])
    # the sockets of the rig, and on two machines the keys
    assert service["volumes"][0] == "run:/run/telenano"


def bytes_of(text: str) -> float:
    """Give the bytes of a limit as compose writes it, or of its default."""
    found = re.fullmatch(r"(?:\$\{[A-Z_]+:-)?(\d+)([mg])\}?", text)
    assert found is not None, text
    return float(found[1]) * {"m": 2**20, "g": 2**30}[found[2]]


# what each took in a session of Fig. 12 in containers [bytes], files that the kernel could drop included; and processes
# and threads, with those of a health check: docs/deployment.md
MEASURED = {"haptic_node": 79e6, "controller_master": 64e6, "delay_node": 61e6, "controller_slave": 64e6,
            "afm_node": 64e6, "recorder": 90e6, "session": 102e6, "viz_node": 129e6}  # fmt: skip
MOST_THREADS = 14


@pytest.mark.parametrize("path", [WHOLE, MASTER, SLAVE], ids=lambda path: path.name)
def test_every_service_has_limits_of_memory_and_processes_with_room_above_what_was_measured(path: Path) -> None:
    services = effective(path)
    for name, service in services.items():
        assert bytes_of(service["mem_limit"]) >= 4 * MEASURED.get(name, 0.0), name
        assert bytes_of(service["mem_limit"]) <= 8 * 2**30, name
        assert 4 * MOST_THREADS <= service["pids_limit"] <= 4096, name
    # those of one rig all fit into a machine at once, if each were at its limit
    nodes_of = [services[name]["mem_limit"] for name in services if name not in NOT_NODES]
    assert sum(map(bytes_of, nodes_of)) <= 8 * 2**30


@pytest.mark.parametrize(("path", "machine"), [(MASTER, "master"), (SLAVE, "slave")])
def test_published_ports_are_those_of_the_site_file(path: Path, machine: str) -> None:
    book = AddressBook.load(TWO_SITES_FILE)
    published = {}
    for node, service in nodes(path).items():
        faces = ["delay_node@slave"] if node == "delay_node@master" else [node]
        endpoint = book.network_endpoint(faces[0])
        assert book.machine_of(faces[0]) == machine
        assert bool(endpoint) == ("ports" in service), node
        if endpoint:
            published[node] = service["ports"]
            port = endpoint.rpartition(":")[2]
            # the link's datagrams come to the port of that number
            datagrams = [f"{port}:{port}/udp"] if faces == ["delay_node@slave"] else []
            assert [text.partition("}:")[2] for text in service["ports"]] == [f"{port}:{port}", *datagrams]
            # never on every address of the machine, which is what a port without one means
            assert all(text.startswith("${PUBLISH_ADDRESS:?") for text in service["ports"])
            assert service["network_mode"] == "bridge"
        assert service["environment"]["TELENANO_MACHINE"] == machine
    assert published


def variables(*paths: Path) -> set[str]:
    """Give the names that compose takes from .env: `${NAME…}`, and keys of the environment without a value."""
    text = "\n".join(path.read_text() for path in paths)
    bare = {key for path in paths for service in effective(path).values()
            for key, value in service.get("environment", {}).items() if value is None}  # fmt: skip
    return set(re.findall(r"(?<!\$)\$\{([A-Z_]+)", text)) | bare


def example_variables() -> set[str]:
    return set(re.findall(r"^#?([A-Z][A-Z0-9_]*)=", (DEPLOY / ".env.example").read_text(), re.M))


def test_env_example_has_every_variable_and_no_other() -> None:
    assert example_variables() == variables(WHOLE, MASTER, SLAVE, DEVICES)


def test_env_example_says_what_happens_without_it() -> None:
    defaults = dict(re.findall(r"\$\{([A-Z_]+):-([^}]*)\}", WHOLE.read_text()))
    given = dict(re.findall(r"^([A-Z][A-Z0-9_]*)=(.*)$", (DEPLOY / ".env.example").read_text(), re.M))
    assert given == {name: defaults[name] for name in given}


def test_settings_handed_on_are_keys_that_there_are(tmp_path: Path) -> None:
    values = dict(re.findall(r"^#?(TELENANO__\w+)=(.*)$", (DEPLOY / ".env.example").read_text(), re.M))
    values["TELENANO__RECORDER__QUOTA_BYTES"] = "20000000000"
    values["TELENANO__RECORDER__DIRECTORY"] = "/recordings"
    values["TELENANO__VIZ_NODE__PORT"] = "8650"
    handed_on = {key for service in effective(WHOLE).values() for key in service.get("environment", {})}
    assert {key for key in handed_on if key.startswith("TELENANO__")} == set(values)
    overrides = environment_overrides(values)
    assert RealtimeConfig.model_validate(overrides.pop("realtime")) == RealtimeConfig()
    assert overrides.pop("duration_s") == 8.0
    for section, keys in overrides.items():
        assert section in Scenario.model_fields
        validate(node_kind(section).config, keys, ".env.example", section)


def test_env_files_and_keys_stay_out_of_repository_and_image() -> None:
    ignored = (DEPLOY / ".gitignore").read_text().split()
    assert {".env", "keys/"} <= set(ignored)
    rules = [line for line in (ROOT / ".dockerignore").read_text().splitlines() if line and not line.startswith("#")]
    assert rules[0] == "*"
    taken = [index for index, rule in enumerate(rules) if rule.startswith("!")]
    # the last rule that fits decides: those that keep secrets out come after all that take something in
    left_out = rules[max(taken) + 1 :]
    for secret in (
        "services/x/master.key_secret",
        "telenano/a.key",
        "services/keys",
        "deploy/locks/server.pem",
        "telenano/wire/.env",
    ):
        parts = [secret, Path(secret).name]
        assert any(fnmatchcase(part, rule.removeprefix("**/")) for part in parts for rule in left_out), secret
    for kept in (".git", ".venv", "out", "sessions", "tests", "deploy/keys", "deploy/.env"):
        assert not any(fnmatchcase(kept, rules[index][1:]) for index in taken), kept


def test_compose_files_keep_to_what_both_commands_know() -> None:
    for path in (WHOLE, MASTER, SLAVE):
        document = compose(path)
        assert {key for key in document if not key.startswith("x-")} <= {"services", "volumes"}
        for service in effective(path).values():
            assert service["build"]["network"] == "host"
            assert not set(service) & {"develop", "include", "provider", "models"}
            assert "start_interval" not in service.get("healthcheck", {})


@pytest.fixture(autouse=True)
def rate_of_no_other_test(monkeypatch: pytest.MonkeyPatch) -> None:
    # The entry point sets it in the environment of its own process.
    monkeypatch.setenv("TELENANO__REALTIME__RATE_HZ", "")
    monkeypatch.delenv("TELENANO__REALTIME__RATE_HZ")


@pytest.fixture(scope="module")
def entrypoint() -> Any:
    specification = importlib.util.spec_from_file_location("entrypoint", DEPLOY / "entrypoint.py")
    assert specification is not None
    assert specification.loader is not None
    module = importlib.util.module_from_spec(specification)
    specification.loader.exec_module(module)
    return module


def test_scenario_in_force_is_one_file_and_the_environment_is_spent(
    entrypoint: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    scenario = tmp_path / "mine.yaml"
    scenario.write_text("name: mine\ndescription: of a test\nduration_s: 1.0\ndelay_node: {trace: {file: t.csv}}\n")
    monkeypatch.setattr(entrypoint, "IN_FORCE", tmp_path / "in_force.yaml")
    monkeypatch.setenv("TELENANO__CONTROLLER__LAW", "wave")
    monkeypatch.setenv("TELENANO__DURATION_S", "2.5")
    monkeypatch.setenv("TELENANO_SCENARIO", str(scenario))
    command = entrypoint.node_command("controller@slave")
    assert command[1:3] == ["-m", "services.controller"]
    assert command[-2:] == ["--site", "slave"]
    assert [name for name in os.environ if name.startswith("TELENANO__")] == []
    loaded = LoadedScenario.load(Path(command[command.index("--scenario") + 1])).scenario
    assert loaded.controller == {"law": "wave"}
    assert loaded.duration_s == 2.5
    assert loaded.delay_node == {"trace": {"file": str(tmp_path / "t.csv")}}


def test_wrong_node_and_scenario_are_reported(
    entrypoint: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.delenv("TELENANO_NODE", raising=False)
    with pytest.raises(SystemExit) as left:
        entrypoint.main([])
    assert left.value.code == 2
    assert "give a command, or the node to run as node@site" in capsys.readouterr().err
    monkeypatch.setenv("TELENANO_SCENARIO", str(tmp_path / "none.yaml"))
    with pytest.raises(ConfigError, match=r"none\.yaml: cannot be read"):
        entrypoint.node_command("controller@slave")


def test_a_port_that_is_taken_names_the_variable_that_sets_it(entrypoint: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TELENANO_SCENARIO", str(ROOT / "none.yaml"))
    with socket.socket() as other:
        other.bind(("127.0.0.1", 0))
        other.listen()
        port = other.getsockname()[1]
        monkeypatch.setenv("TELENANO__VIZ_NODE__PORT", str(port))
        with pytest.raises(ConfigError, match=f"port {port} of 127.0.0.1: Address already in use: set VIEW_PORT"):
            entrypoint.node_command(PAGE)
        # no other node has a port of the machine
        with pytest.raises(ConfigError, match=r"none\.yaml"):
            entrypoint.node_command("afm_node@slave")
    for text in (str(port), "", "many", "70000"):
        entrypoint.check_port(text)


def test_containers_of_a_folder_share_one_epoch(entrypoint: Any, tmp_path: Path) -> None:
    first = entrypoint.shared_epoch_offset_ns(tmp_path)
    assert entrypoint.shared_epoch_offset_ns(tmp_path) == first
    assert [path.name for path in tmp_path.iterdir()] == ["epoch_offset_ns"]


def test_a_container_does_not_begin_in_a_folder_of_sockets_that_others_can_reach(
    entrypoint: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    tmp_path.chmod(0o755)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.setenv("TELENANO_RUNTIME_DIR", str(tmp_path))
    monkeypatch.setenv("TELENANO_NODE", "afm_node@slave")
    monkeypatch.delenv("TELENANO_EPOCH_OFFSET_NS", raising=False)
    with pytest.raises(SystemExit) as caught:
        entrypoint.main([])
    assert caught.value.code == 2
    assert capsys.readouterr().err == (
        f"{tmp_path}: other users can reach its content (mode 755): chmod 700 {tmp_path}\n"
    )
    assert list(tmp_path.iterdir()) == []


def test_command_takes_the_place_of_the_entrypoint(
    entrypoint: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    compiled, cache = tmp_path / "compiled", tmp_path / "cache"
    compiled.mkdir()
    (compiled / "steps").write_text("code")
    monkeypatch.setattr(entrypoint, "PREPARED", compiled)
    monkeypatch.setenv("XDG_CACHE_HOME", str(cache))
    monkeypatch.setenv("TELENANO_RUNTIME_DIR", str(tmp_path))
    monkeypatch.setenv("TELENANO_NODE", "launcher@master")
    monkeypatch.delenv("TELENANO_EPOCH_OFFSET_NS", raising=False)
    run: list[Any] = []
    monkeypatch.setattr(entrypoint.children, "become", run.append)
    for _ in range(2):
        entrypoint.main(["telenano", "--version"])
    assert run == [["telenano", "--version"]] * 2
    assert (cache / "steps").read_text() == "code"
    assert os.environ["TELENANO_EPOCH_OFFSET_NS"] == (tmp_path / "epoch_offset_ns").read_text()
    monkeypatch.delenv("TELENANO_EPOCH_OFFSET_NS")


@pytest.mark.parametrize(
    ("processors", "given", "environment", "expected_hz"),
    [
        (2, "", {}, 500.0),
        (3, "", {}, 500.0),
        (4, "", {}, 1000.0),
        # A person who gives a rate gets it, in the scenario or beside it, and so do two machines.
        (2, "realtime: {rate_hz: 2000}", {}, 2000.0),
        (2, "", {"TELENANO__REALTIME__RATE_HZ": "800"}, 800.0),
        (2, "", {"TELENANO_MACHINE": "slave"}, 1000.0),
    ],
)
def test_the_rig_of_few_processors_has_half_the_rate_unless_one_is_given(
    entrypoint: Any,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    processors: int,
    given: str,
    environment: dict[str, str],
    expected_hz: float,
) -> None:
    for name, value in environment.items():
        monkeypatch.setenv(name, value)
    scenario = tmp_path / "own.yaml"
    scenario.write_text(f"name: own\ndescription: Own\nduration_s: 5.0\n{given}\n")
    monkeypatch.setenv("TELENANO_SCENARIO", str(scenario))
    entrypoint.choose_rate(processors)
    assert LoadedScenario.of(*layered(scenario)).scenario.realtime.rate_hz == expected_hz
