import builtins
import fcntl
import json
import os
import socket
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from telenano.cli.commands import doctor
from telenano.doctor import checks
from telenano.doctor.checks import Endpoint, KernelClock
from telenano.extend.checks import Finding
from telenano.runtime.bus.address_book import AddressBook, NodeEntry
from telenano.runtime.security.keyring import Keyring
from telenano.sections.controller_section import KNOWN_LAWS
from telenano.settings import DEFAULT_SITE_FILE
from telenano.testing import run

REQUIRES = [
    "msgpack>=1.1",
    "numba>=0.61; extra == 'afm'",
    "pymodbus<4,>=3.16.1; extra == 'afm'",
    "numba>=0.61; extra == 'controller'",
    "h5py>=3.12; extra == 'export'",
    "ruff>=0.9; extra == 'dev'",
    "h5py>=3.12; extra == 'rig'",
]
ALL = {"msgpack": "1.2.4", "numba": "0.68.1", "pymodbus": "3.16.1", "h5py": "3.16.0"}


@pytest.fixture(autouse=True)
def _private_runtime(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TELENANO_RUNTIME_DIR", str(tmp_path / "run"))


def tree(root: Path, files: dict[str, str]) -> Path:
    for name, text in files.items():
        path = root / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(f"{text}\n")
    return root


def packages(**changes: str | None) -> dict[str, Finding]:
    have: dict[str, str | None] = {**ALL, **changes}
    return {finding.name: finding for finding in checks.check_packages(REQUIRES, have.get)}


def judged(finding: Finding, level: str, *words: str) -> None:
    assert finding.level == level
    assert bool(finding.advice) == (level != "ok"), "advice is for what is not ok, and only for that"
    for word in words:
        assert word in f"{finding.found} {finding.advice}"


def test_python() -> None:
    judged(checks.check_python((3, 11, 0)), "ok", "3.11.0")
    judged(checks.check_python((4, 0, 0)), "ok")
    judged(checks.check_python((3, 10, 9)), "problem", "3.10.9", "3.11")


def test_packages_that_fit_are_listed() -> None:
    found = packages()
    assert set(found) == {"packages", "extras"}
    judged(found["packages"], "ok", "msgpack 1.2.4, numba 0.68.1, pymodbus 3.16.1")
    judged(found["extras"], "ok", "all are installed")


@pytest.mark.parametrize("version", ["3.16.0", "4.0.0", "3.9.1"])
def test_a_wrong_version_is_a_problem_also_in_an_extra(version: str) -> None:
    judged(packages(pymodbus=version)["pymodbus"], "problem", version, 'pip install "pymodbus<4,>=3.16.1"')


def test_a_development_version_counts() -> None:
    assert "msgpack" not in packages(msgpack="1.3.0rc1")


def test_a_package_that_every_process_needs_must_be_there() -> None:
    judged(packages(msgpack=None)["msgpack"], "problem", "not installed", "pip install msgpack")


def test_extras_that_are_not_installed_are_information() -> None:
    found = packages(numba=None, h5py=None)
    assert set(found) == {"packages", "extras"}
    listed = ("afm         lacks numba", "controller  lacks numba", "export      lacks h5py")
    assert found["extras"].found == "\n".join(("3 not installed:", *listed))
    assert "ruff" not in found["extras"].found


def test_without_packaging_versions_are_not_compared(monkeypatch: pytest.MonkeyPatch) -> None:
    real = builtins.__import__

    def without(name: str, *arguments: Any, **keywords: Any) -> Any:
        if name.startswith("packaging"):
            raise ImportError(name)
        return real(name, *arguments, **keywords)

    monkeypatch.setattr(builtins, "__import__", without)
    [finding] = checks.check_packages(REQUIRES, ALL.get)
    judged(finding, "warning", "pip install packaging")


@pytest.mark.parametrize(
    ("held", "level", "words"),
    [
        ((), "ok", "no rig holds processors; 4 free, enough for 2 more rigs"),
        ((2, 3), "ok", "running rigs use processors 2, 3; 2 free, enough for 1 more rig"),
        (
            (1, 2, 3),
            "warning",
            "running rigs use processors 1, 2, 3; 1 free, enough for 0 more rigs: a further rig",
        ),
    ],
)
def test_processors_that_rigs_hold(held: tuple[int, ...], level: str, words: str) -> None:
    finding = checks.check_rig_processors(4, held)
    assert finding.level == level
    assert finding.found.startswith(words)
    assert bool(finding.advice) == (level == "warning")


@pytest.mark.parametrize(
    ("permitted", "quota", "level"),
    [(2, None, "ok"), (1, None, "warning"), (8, 2.0, "ok"), (8, 1.5, "warning"), (8, 0.0, "warning")],
)
def test_processors(permitted: int, quota: float | None, level: str) -> None:
    judged(checks.check_processors(permitted, quota), level, str(permitted), "" if quota is None else f"{quota:g}")


@pytest.mark.parametrize(
    ("membership", "files", "quota"),
    [
        ("0::/", {"cpu.max": "150000 100000"}, 1.5),
        ("0::/", {"cpu.max": "max 100000"}, None),
        ("0::/a/b", {"a/cpu.max": "300000 100000", "a/b/cpu.max": "max 100000", "cpu.max": "max 100000"}, 3.0),
        ("0::/a/b", {"a/cpu.max": "300000 100000", "a/b/cpu.max": "200000 100000"}, 2.0),
        ("0::/docker/0123", {"cpu.max": "50000 100000"}, 0.5),
        ("4:memory:/x\n1:cpu,cpuacct:/", {"cpu/cpu.cfs_quota_us": "250000", "cpu/cpu.cfs_period_us": "100000"}, 2.5),
        ("1:cpu:/", {"cpu/cpu.cfs_quota_us": "-1", "cpu/cpu.cfs_period_us": "100000"}, None),
        ("4:memory:/", {"cpu.max": "1000 100000"}, None),
        ("0::/", {}, None),
    ],
)
def test_quota_of_the_control_group(
    tmp_path: Path, membership: str, files: dict[str, str], quota: float | None
) -> None:
    (tmp_path / "membership").write_text(membership + "\n")
    groups = tree(tmp_path / "groups", files)
    assert checks.cpu_quota(groups, tmp_path / "membership") == quota


def test_no_control_groups_are_no_quota(tmp_path: Path) -> None:
    assert checks.cpu_quota(tmp_path, tmp_path / "missing") is None


def test_fifo() -> None:
    judged(checks.check_fifo("", 0, "950000", container=False), "ok", "RLIMIT_RTPRIO 0", "950000")
    judged(checks.check_fifo("", -1, None, container=False), "ok", "unlimited", "unknown")
    host = checks.check_fifo("Operation not permitted", 0, "950000", container=False)
    judged(host, "warning", "Operation not permitted", "limits.d")
    judged(checks.check_fifo("no", 0, "950000", container=True), "warning", "SYS_NICE", "rtprio")
    judged(checks.check_fifo("no", 0, "0", container=True), "warning", "kernel.sched_rt_runtime_us")


def test_memory_lock() -> None:
    judged(checks.check_memory_lock("", -1, container=False), "ok", "unlimited")
    host = checks.check_memory_lock("Cannot allocate memory", 8 * 10**6, container=False)
    judged(host, "warning", "Cannot allocate memory", "8.0 MB", "memlock")
    judged(checks.check_memory_lock("no", 0, container=True), "warning", "memlock: -1", "IPC_LOCK")


@pytest.mark.parametrize("attempt", [checks.attempt_fifo, checks.attempt_memory_lock])
def test_attempts_leave_this_process_as_it_was(attempt: Any) -> None:
    before = os.sched_getscheduler(0)
    reason = attempt()
    assert reason == "" or "permitted" in reason or "memory" in reason
    assert os.sched_getscheduler(0) == before


def test_a_refused_attempt_gives_the_reason(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    refuses = tmp_path / "python"
    refuses.write_text("#!/bin/sh\necho 'PermissionError: [Errno 1] Operation not permitted' >&2\nexit 1\n")
    refuses.chmod(0o755)
    monkeypatch.setattr(sys, "executable", str(refuses))
    assert checks.attempt_fifo() == "Operation not permitted"
    refuses.write_text("#!/bin/sh\nexit 3\n")
    assert checks.attempt_memory_lock() == "exit code 3"


def test_synchronised_clock() -> None:
    judged(checks.check_synchronised(None), "ok", "does not report")
    judged(checks.check_synchronised(KernelClock(True, 0.0123)), "ok", "12.3 ms")
    judged(checks.check_synchronised(KernelClock(False, 16.0)), "warning", "not synchronised", "chrony")


@pytest.mark.parametrize(
    ("spans_machines", "synchronised", "warned"), [(True, False, True), (True, True, False), (False, False, False)]
)
def test_up_warns_of_a_clock_that_is_not_synchronised_where_there_are_two(
    monkeypatch: pytest.MonkeyPatch, spans_machines: bool, synchronised: bool, warned: bool
) -> None:
    import telenano.cli.commands.up as command

    monkeypatch.setattr(checks, "kernel_clock", lambda: KernelClock(synchronised, 0.01))
    plan: Any = SimpleNamespace(book=SimpleNamespace(spans_machines=spans_machines))
    text = command._clock_text(plan)
    assert (text != "") is warned
    if warned:
        assert text.startswith("the clock of this machine is not synchronised")
        assert "chrony" in text


@pytest.mark.parametrize(
    ("result", "status", "synchronised"), [(0, 0x2001, True), (5, 0x1, False), (0, 0x40, False), (1, 0x10, True)]
)
def test_what_the_kernel_says_of_its_clock(result: int, status: int, *, synchronised: bool) -> None:
    assert checks.kernel_clock_of(result, status, 2000) == KernelClock(synchronised, 2000 * 1e-6)


def test_the_kernel_is_asked() -> None:
    clock = checks.kernel_clock()
    # a container may not be allowed to ask; a bound of the error grows to 16 s at most
    assert clock is None or 0.0 <= clock.largest_error_s <= 20.0


def test_endpoints_in_one_finding_and_one_for_each_that_is_wrong() -> None:
    states = {
        "ipc:///a": Endpoint("free"),
        "ipc:///b": Endpoint("rig", "process 12"),
        "tcp://127.0.0.1:2": Endpoint("in use", "the port is in use"),
        "tcp://nowhere:3": Endpoint("unusable", "nowhere is not known"),
    }
    nodes = dict(zip(states, ("haptic_node@master", "b@master", "b@master", "e@master"), strict=True))
    summary, used, unusable = checks.check_endpoints(nodes, states.__getitem__)
    judged(summary, "ok", "1 of 4 free; a rig runs: b@master (process 12)")
    judged(used, "warning", "tcp://127.0.0.1:2", "in use", "ss -tlnp")
    judged(unusable, "problem", "tcp://nowhere:3", "not known", "TELENANO_BIND_ADDRESS", "TELENANO_MACHINE")
    assert used.name == "endpoint of b@master"


TWO_SITES = AddressBook(
    machines={"master": "127.0.0.1", "slave": "127.0.0.2"},
    nodes={
        "haptic_node@master": "ipc:///h",
        "delay_node@slave": NodeEntry(local="ipc:///d", network="tcp://{master}:5704"),
        "afm_node@slave": NodeEntry(local="ipc:///a", network="tcp://{slave}:5712"),
    },
)


def test_a_machine_binds_what_is_its_own() -> None:
    assert doctor.endpoints_of(TWO_SITES, "master") == {
        "ipc:///h": "haptic_node@master",
        "ipc:///d": "delay_node@slave",
        "tcp://127.0.0.1:5704": "delay_node@slave",
    }
    assert list(doctor.endpoints_of(TWO_SITES, "slave")) == ["ipc:///a", "tcp://127.0.0.2:5712"]
    alone = AddressBook(nodes={"haptic_node@master": "ipc:///h", "afm_node@slave": "ipc:///a"})
    assert list(doctor.endpoints_of(alone, "slave")) == ["ipc:///h", "ipc:///a"]


def test_keys(tmp_path: Path) -> None:
    here, there = Keyring(tmp_path / "here"), Keyring(tmp_path / "there")
    judged(checks.check_keys("master", {"slave"}, here)[0], "problem", "master", "telenano keys new master")
    here.create("master")
    judged(checks.check_keys("master", {"slave"}, here)[0], "warning", "slave", "telenano keys allow slave")
    here.allow("slave", there.create("slave").public.decode(), ["data"])
    judged(checks.check_keys("master", {"slave"}, here)[0], "ok", "this machine is master", "slave")
    here.revoke("slave")
    judged(checks.check_keys("master", {"slave"}, here)[0], "warning", "slave")


@pytest.mark.parametrize(
    ("insecure", "spans", "level"), [(True, True, "warning"), (False, True, "problem"), (False, False, None)]
)
def test_keys_are_for_a_rig_on_two_machines(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, level: str | None, *, insecure: bool, spans: bool
) -> None:
    monkeypatch.setenv("TELENANO_KEYS_DIR", str(tmp_path / "keys"))
    site_file = tmp_path / "site.yaml"
    # the address of another machine, the slave, whose doctor this is not
    other = "tcp://192.0.2.7:1" if spans else "ipc:///a"
    site_file.write_text(f"insecure: {str(insecure).lower()}\nnodes:\n  afm_node@slave: {other}\n")
    levels = {finding.name: finding.level for finding in doctor.rig(site_file)}
    assert levels.get("keys") == level
    assert levels["endpoints"] == "ok"


def test_a_local_endpoint_is_held_by_who_has_its_lock(tmp_path: Path) -> None:
    endpoint = f"ipc://{tmp_path}/node"
    assert checks.probe_endpoint(endpoint).state == "free"
    lock_file = tmp_path / "node.lock"
    lock_file.write_text("4711")
    assert checks.probe_endpoint(endpoint).state == "free"
    with lock_file.open() as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        assert checks.probe_endpoint(endpoint) == Endpoint("rig", "process 4711")
    with lock_file.open() as lock:
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)


def test_a_lock_that_cannot_be_opened(tmp_path: Path) -> None:
    (tmp_path / "node.lock").mkdir()
    state, detail = checks.probe_endpoint(f"ipc://{tmp_path}/node")
    assert (state, "cannot be opened" in detail) == ("unusable", True)


@pytest.fixture
def port() -> Iterator[int]:
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        yield taken.getsockname()[1]


def test_a_port_is_in_use_or_free(port: int) -> None:
    assert checks.probe_endpoint(f"tcp://127.0.0.1:{port}") == Endpoint("in use", "the port is in use")
    with socket.socket() as other:
        other.bind(("127.0.0.1", 0))
        free = other.getsockname()[1]
    assert checks.probe_endpoint(f"tcp://127.0.0.1:{free}") == Endpoint("free")


def test_an_address_of_another_machine() -> None:
    # from the range that is reserved for documentation: no machine has it
    assert checks.probe_endpoint("tcp://192.0.2.7:5555").state == "unusable"


def test_an_address_that_cannot_be_had(monkeypatch: pytest.MonkeyPatch) -> None:
    def unknown(*arguments: Any, **keywords: Any) -> Any:
        raise socket.gaierror(-2, "Name or service not known")

    with monkeypatch.context() as patch:
        patch.setattr(socket, "getaddrinfo", unknown)
        assert checks.probe_endpoint("tcp://rig:5555").detail == "rig cannot be resolved (Name or service not known)"

    class Forbidden(socket.socket):
        def bind(self, address: Any) -> None:
            raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(socket, "socket", Forbidden)
    state, detail = checks.probe_endpoint("tcp://127.0.0.1:80")
    assert (state, detail) == ("unusable", "the port cannot be bound (Permission denied)")


def test_disk(tmp_path: Path) -> None:
    judged(checks.check_disk(tmp_path, 10**9), "ok", "1.0 GB", str(tmp_path))
    judged(checks.check_disk(tmp_path, 10**9 - 1), "warning", "--out")


@pytest.mark.parametrize(("name", "inside"), [(".dockerenv", True), ("run/.containerenv", True), ("x", False)])
def test_containers_are_recognised(tmp_path: Path, name: str, *, inside: bool) -> None:
    assert checks.in_container(tree(tmp_path, {name: ""})) is inside


def given(monkeypatch: pytest.MonkeyPatch, *findings: Finding) -> None:
    monkeypatch.setattr(doctor, "examine", lambda site_file: list(findings))


@pytest.mark.check("takes 2.0 s")
def test_every_check_is_made_here() -> None:
    code, out, err = run("doctor", "--json")
    document = json.loads(out)
    names = {finding["name"] for finding in document["findings"]}
    assert names >= {
        "python", "packages", "extras", "processors", "SCHED_FIFO", "memory lock", "clock", "disk", "endpoints",
    }  # fmt: skip
    assert out.count("\n") == 1
    assert code == (0 if document["ok"] else 1)
    assert (err == "") == document["ok"]


def test_warnings_do_not_fail(monkeypatch: pytest.MonkeyPatch) -> None:
    given(monkeypatch, Finding("python", "ok", "3.11.7"), Finding("clock", "warning", "not right", "do [this]"))
    code, out, err = run("doctor")
    assert (code, err) == (0, "")
    assert "→ do [this]" in out
    assert "1 warning(s): clock" in out
    code, out, _ = run("doctor", "--json")
    assert code == 0
    assert json.loads(out)["findings"][1] == {
        "name": "clock", "level": "warning", "found": "not right", "advice": "do [this]",
    }  # fmt: skip


def test_a_problem_fails(monkeypatch: pytest.MonkeyPatch) -> None:
    given(monkeypatch, Finding("python", "problem", "3.10", "get another"))
    code, out, err = run("doctor")
    assert code == 1
    assert "3.10" in out
    assert err == "telenano: a rig cannot run here as it is: python\n"
    code, out, _ = run("doctor", "--json")
    document = json.loads(out)
    assert (code, document["ok"], document["error"]) == (1, False, err.strip().removeprefix("telenano: "))


def test_a_wrong_site_file_is_one_finding_among_others(tmp_path: Path) -> None:
    missing = tmp_path / "nowhere.yaml"
    [finding] = doctor.rig(missing)
    judged(finding, "problem", str(missing), "--site-file")


def test_a_runtime_folder_that_is_too_long_is_a_finding(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TELENANO_RUNTIME_DIR", str(tmp_path / ("x" * 110)))
    assert {finding.name: finding.level for finding in doctor.rig(DEFAULT_SITE_FILE)} == {"site file": "problem"}


@pytest.mark.check("takes 1.6 s")
def test_a_rig_that_cannot_be_read_for_want_of_a_package(monkeypatch: pytest.MonkeyPatch) -> None:
    def missing(site_file: Path) -> list[Finding]:
        raise ModuleNotFoundError("No module named 'zmq'")

    monkeypatch.setattr(doctor, "rig", missing)
    monkeypatch.setattr(doctor, "machine", lambda **given: [])
    judged(doctor.examine(Path("x"))[-1], "problem", "No module named 'zmq'")


def test_a_project_that_is_not_installed(monkeypatch: pytest.MonkeyPatch) -> None:
    def unknown(name: str) -> list[str]:
        raise doctor.PackageNotFoundError(name)

    monkeypatch.setattr(doctor, "requires", unknown)
    [finding] = doctor.packages()
    judged(finding, "problem", "pip install -e .")


def test_a_rig_that_is_none_is_an_error(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("TELENANO_RUNTIME_DIR", str(tmp_path))
    given(monkeypatch)
    # The option sets the variable for the rest of the process.
    monkeypatch.setenv("TELENANO_RIG", "nosuch")
    code, _, err = run("doctor", "--rig", "nosuch")
    assert code != 0
    assert "there is no rig nosuch" in err
    (tmp_path / "rig-nosuch").mkdir()
    assert run("doctor", "--rig", "nosuch")[0] == 0


def test_warming_simulates_each_law_once(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    from telenano.lockstep import simulation

    said: list[tuple[str, str]] = []
    monkeypatch.setattr(simulation, "compile_scenario", lambda name, law: said.append((name, law)))
    doctor.compile_models(as_json=True)
    assert said == [("fig12", law) for law in KNOWN_LAWS]
    assert list(json.loads(capsys.readouterr().out)["warmed_s"]) == list(KNOWN_LAWS)


@pytest.mark.endurance("compiles a law")
def test_a_session_after_warming_compiles_nothing_and_one_before_it_says_that_it_does(tmp_path: Path) -> None:
    warm = (
        "from telenano.lockstep import simulation; warm = simulation.compile_scenario\n"
        "simulation.compile_scenario = lambda name, law: law == 'virtual_impedance' and warm(name, law)\n"
        "from telenano.cli.commands.doctor import compile_models; compile_models(as_json=True)"
    )
    session = "import telenano; print(telenano.simulate('fig12', law='virtual_impedance').verdict)"
    said = []
    for program in (warm, session):
        environment = {name: value for name, value in os.environ.items() if name != "NUMBA_DISABLE_JIT"}
        environment["NUMBA_CACHE_DIR"] = str(tmp_path)
        done = subprocess.run(
            [sys.executable, "-c", program], env=environment, capture_output=True, text=True, check=True
        )
        said.append("compiling models" in done.stderr)
    assert said == [True, False] and done.stdout == "stable\n"
