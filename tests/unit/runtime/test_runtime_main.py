"""From a command line to a running node, or to one clear line that says why not."""

import ast
import os
import signal
import socket
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any, ClassVar, cast

import pytest
from pydantic import BaseModel, ConfigDict, Field

import services
from telenano.runtime.bus.address_book import AddressBook
from telenano.runtime.loop.node import Node, NodeContext
from telenano.runtime.security.keyring import Keyring
from telenano.runtime.wiring.main import EXIT_BAD_START, NodeKind, node_kind, ordinary, parse_arguments, run_node
from telenano.wire.errors import ConfigError
from telenano.wire.received import Received

SCENARIO = """
name: test
description: a node that stops itself
duration_s: 1.0
realtime: {scheduler: normal, memory_lock: off}
controller: {gain: 2.0}
"""


class Config(BaseModel):
    model_config = ConfigDict(frozen=True, strict=True, extra="forbid", allow_inf_nan=False)

    gain: Annotated[float, Field(gt=0.0, le=10.0)]


class Mortal(Node):
    """A node that asks to be stopped as soon as it runs."""

    inputs: ClassVar[tuple[str, ...]] = ("haptic/state",)
    ended: ClassVar[list[str]] = []

    def __init__(self, context: NodeContext, config: Config) -> None:
        super().__init__(context)
        self.config = config

    def on_message(self, received: Received) -> None:
        raise AssertionError(f"nobody sends {received.topic}")

    def deadline_ns(self) -> int:
        return 0

    def on_deadline(self, now_ns: int) -> None:
        signal.raise_signal(signal.SIGTERM)

    def make_safe(self) -> None:
        self.ended.append(f"{self.context.key} gain {self.config.gain}")


KIND = NodeKind("controller", Config, ordinary(Mortal, Mortal.inputs))


@pytest.fixture(autouse=True)
def _without_settings(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in [name for name in os.environ if name.startswith("TELENANO__")]:
        monkeypatch.delenv(name)
    Mortal.ended.clear()


@pytest.fixture
def arguments(tmp_path: Path) -> list[str]:
    site, scenario = tmp_path / "site.yaml", tmp_path / "scenario.yaml"
    site.write_text(f"nodes: {{controller@master: 'ipc://{tmp_path}/controller'}}\n")
    scenario.write_text(SCENARIO)
    return ["--site-file", str(site), "--scenario", str(scenario)]


def test_no_node_looks_for_garbage_during_its_imports() -> None:
    for name in ("afm_node", "controller", "delay_node", "haptic_node", "recorder"):
        text = Path(services.__path__[0], name, "__main__.py").read_text()
        first, second, *_ = ast.parse(text).body[1:]
        assert ast.unparse(first) == "import gc"
        assert ast.unparse(second) == "if __name__ == '__main__':\n    gc.disable()"
    # It ends with its help after the imports, in which there would be more than a hundred collections.
    script = (
        "import atexit, gc, runpy, sys; sys.argv = ['node', '--help']; found = []; gc.collect(); "
        "gc.callbacks.append(lambda phase, info: found.append(info)); "
        "atexit.register(lambda: print(len(found))); "
        "runpy.run_module('services.delay_node', run_name='__main__')"
    )
    ended = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    assert int(ended.stdout.splitlines()[-1]) < 10


@pytest.mark.check("takes 1.7 s")
def test_a_node_runs_until_it_is_stopped(arguments: list[str], capfd: pytest.CaptureFixture[str]) -> None:
    assert run_node(KIND, [*arguments, "--set", "controller.gain=3.0"]) == 0
    assert Mortal.ended == ["controller@master gain 3.0"]
    log = capfd.readouterr().err
    assert '"text": "ready"' in log
    assert log.rstrip().endswith('"text": "stopped"}')


@pytest.mark.parametrize(
    ("more", "message"),
    [
        (
            ["--set", "controller.gain=11.0"],
            "controller.gain: Input should be less than or equal to 10 (allowed is from above 0 to 10), got 11.0",
        ),
        (["--set", "controller.gian=1.0"], "controller.gian: unknown key, did you mean gain? Known are gain"),
        (["--set", "gain"], "--set gain: is not of the form section.key=value"),
        (["--scenario", "/nowhere/fig12.yaml"], "/nowhere/fig12.yaml: cannot be read: No such file or directory"),
        (["--site-file", "/nowhere/site.yaml"], "/nowhere/site.yaml: cannot be read: No such file or directory"),
        (["--site", "slave"], "controller@slave is not in the site file, which has controller@master"),
        (["--set", "realtime.cpus.controller=100000"], "realtime.cpus: 100000 cannot be used"),
    ],
)
def test_a_bad_start_is_one_clear_line_and_an_exit_code(
    arguments: list[str], more: list[str], message: str, capfd: pytest.CaptureFixture[str]
) -> None:
    assert run_node(KIND, [*arguments, *more]) == EXIT_BAD_START
    (line,) = capfd.readouterr().err.splitlines()
    assert message in line
    assert '"level": "error"' in line
    assert Mortal.ended == []


@pytest.fixture
def locked(arguments: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> int:
    """Have the node bind a port for other machines; gives the port."""
    monkeypatch.setenv("TELENANO_KEYS_DIR", str(tmp_path / "keys"))
    with socket.socket() as found:
        found.bind(("127.0.0.1", 0))
        port = int(found.getsockname()[1])
    local = f"ipc://{tmp_path}/controller"
    (tmp_path / "site.yaml").write_text(
        f"nodes: {{controller@master: {{local: '{local}', network: 'tcp://127.0.0.1:{port}'}}}}\n"
    )
    return port


@pytest.mark.check("takes 0.8 s")
def test_a_node_of_a_rig_on_several_machines_needs_a_key(
    arguments: list[str], locked: int, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    assert run_node(KIND, arguments) == EXIT_BAD_START
    (line,) = capfd.readouterr().err.splitlines()
    assert f"{tmp_path}/keys/master.key_secret: there is no key for the machine master: `telenano keys new" in line
    Keyring().create("master")
    assert run_node(KIND, arguments) == 0
    assert Mortal.ended == ["controller@master gain 2.0"]


@pytest.mark.check("takes 1.1 s")
def test_a_port_that_is_taken_is_a_bad_start_that_leaves_nothing_open(
    arguments: list[str], locked: int, capfd: pytest.CaptureFixture[str]
) -> None:
    Keyring().create("master")
    with socket.create_server(("127.0.0.1", locked)):
        assert run_node(KIND, arguments) == EXIT_BAD_START
        (line,) = capfd.readouterr().err.splitlines()
        assert f"controller@master cannot bind tcp://127.0.0.1:{locked}: another process has it" in line
    assert run_node(KIND, arguments) == 0


def test_arguments_and_their_help(capsys: pytest.CaptureFixture[str]) -> None:
    given = parse_arguments("afm_node", ("slave",), ["--site-file", "s", "--scenario", "x", "--with-parent"])
    assert (given.site, given.set, given.with_parent) == ("slave", [], True)
    with pytest.raises(SystemExit) as caught:
        parse_arguments("afm_node", ("slave",), ["--help"])
    assert caught.value.code == 0
    assert "telenano node afm_node" in capsys.readouterr().out
    with pytest.raises(SystemExit):
        parse_arguments("afm_node", ("slave",), ["--site-file", "s", "--scenario", "x", "--site", "master"])


def test_a_wrong_site_file_names_its_key(tmp_path: Path) -> None:
    path = tmp_path / "site.yaml"
    path.write_text("nodes: {afm_node@slave: 'tcp://{slave}:5501'}\n")
    with pytest.raises(ConfigError, match=r"site\.yaml: nodes\.afm_node@slave: .* is not in `machines`"):
        AddressBook.load(path)


class _AskedError(Exception):
    """The bus that a node asks for."""


class _Asks:
    """Wiring that only notes which bus a node is built with."""

    def __init__(self, key: str) -> None:
        self.key = key

    def bus(self, topics: Sequence[str], *, newest_only: bool = False) -> Any:
        raise _AskedError(newest_only, *topics)


@pytest.mark.parametrize("key", ["haptic_node@master", "controller@master", "controller@slave", "afm_node@slave"])
def test_a_node_of_the_loop_takes_the_newest_of_what_waits(key: str) -> None:
    with pytest.raises(_AskedError) as asked:
        node_kind(key.partition("@")[0]).build(cast(Any, _Asks(key)), cast(Any, None))
    newest_only, *topics = asked.value.args
    assert newest_only
    # without it every sample behind a link with delay would be stale
    assert "link/delay" in topics
