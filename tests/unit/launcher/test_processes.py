import contextlib
import signal
import subprocess
import sys
from collections.abc import Collection, Sequence
from pathlib import Path
from typing import ClassVar

import psutil
import pytest

from telenano.launcher.processes import NodeProcesses, StopObserver, child_environment

STUBBORN = "import signal, time; signal.signal(signal.SIGTERM, signal.SIG_IGN); print('up', flush=True); time.sleep(60)"
# ends at SIGTERM, by the default action
OBEDIENT = "import signal; print('up', flush=True); signal.pause()"


def processes(folder: Path, code: dict[str, str], order: list[str], stopping: list[str]) -> NodeProcesses:
    commands = {node: [sys.executable, "-c", text] for node, text in code.items()}
    return NodeProcesses(commands, order, folder, 42, stopping.append)


# publishes its last message, which here is a line, and then lingers until the file `taken` is there
LINGERING = """
import pathlib, signal, sys, time
signal.signal(signal.SIGTERM, lambda *given: print("ended", flush=True))
print("up", flush=True)
signal.pause()
while not pathlib.Path("{folder}/taken").exists():
    time.sleep(0.01)
"""


class Reader(StopObserver):
    """Knows from its log that a node has ended, and takes the last messages once all have."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.waited: list[tuple[str, ...]] = []

    def has_ended(self, node: str) -> bool:
        path = self.folder / f"{node}.log"
        return path.exists() and b"ended" in path.read_bytes()

    def wait(self, nodes: Sequence[str], waited_s: float, limit_s: float) -> None:
        self.waited.append(tuple(nodes))
        # While one node alone is waited for, the other one is not asked for its last messages yet.
        if set(nodes) == {"a@b", "c@d"} and all(map(self.has_ended, nodes)):
            (self.folder / "taken").touch()


def wait_for_line(path: Path) -> None:
    while not path.read_bytes():
        pass


def test_nodes_are_stopped_in_order_and_the_log_is_kept(tmp_path: Path) -> None:
    stopping: list[str] = []
    children = processes(tmp_path, {"a@b": OBEDIENT, "c@d": OBEDIENT}, ["c@d", "a@b"], stopping)
    for node in ("a@b", "c@d"):
        children.start(node)
        wait_for_line(children.log_path(node))
    assert children.reap() == {}
    children.stop()
    assert stopping == ["c@d", "a@b"]
    assert children.log_tail("a@b") == "up"
    children.stop()
    assert stopping == ["c@d", "a@b"]


def test_the_next_node_is_stopped_while_the_last_messages_of_one_are_delivered_and_the_recorder_after_all(
    tmp_path: Path,
) -> None:
    stopping: list[str] = []
    lingering = LINGERING.format(folder=tmp_path)
    nodes = {"a@b": lingering, "c@d": lingering, "recorder@d": OBEDIENT}
    children = processes(tmp_path, nodes, ["a@b", "c@d", "recorder@d"], stopping)
    for node in nodes:
        children.start(node)
        wait_for_line(children.log_path(node))
    reader = Reader(tmp_path)
    # `a@b` cannot end before `c@d` has been stopped as well
    children.stop(reader)
    assert stopping == ["a@b", "c@d", "recorder@d"]
    assert ("a@b", "c@d") in reader.waited
    assert children.reap() == {}


@pytest.mark.check("waits for the end of processes")
@pytest.mark.parametrize(("delivered_after_s", "patience_s"), [(0.0, 0.1), (0.3, 0.4), (1e9, 0.8)])
def test_a_process_that_hangs_is_killed_soon_after_its_readers_have_all_and_else_at_the_limit(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, delivered_after_s: float, patience_s: float
) -> None:
    class Readers(Reader):
        def has_delivered(self, node: str, gone: Collection[str]) -> bool:
            assert node not in gone and "recorder@b" in gone
            return self.has_ended(node) and bool(self.waits) and self.waits[-1] >= delivered_after_s

        def wait(self, nodes: Sequence[str], waited_s: float, limit_s: float) -> None:
            self.waits.append(waited_s)

        waits: ClassVar[list[float]] = []

    monkeypatch.setattr("telenano.launcher.processes.EXIT_GRACE_S", 0.1)
    monkeypatch.setattr("telenano.launcher.processes.LINGER_GRACE_S", 0.8)
    lingering = LINGERING.format(folder=tmp_path)
    children = processes(tmp_path, {"a@b": lingering, "recorder@b": OBEDIENT}, ["a@b"], [])
    process_id = children.start("a@b")
    wait_for_line(children.log_path("a@b"))
    readers = Readers(tmp_path)
    readers.waits.clear()
    children.stop(readers)
    assert not Path(f"/proc/{process_id}").exists()
    # the waits begin again once the node has published its last message
    assert readers.waits[-1] >= patience_s - 0.1
    assert (readers.waits[-1] < 0.75) == (delivered_after_s < 1.0)


def test_a_failing_observer_leaves_the_process_to_be_stopped_again(tmp_path: Path) -> None:
    class Failing(StopObserver):
        def wait(self, nodes: Sequence[str], waited_s: float, limit_s: float) -> None:
            raise OSError("the terminal is gone")

    children = processes(tmp_path, {"a@b": "import time; time.sleep(60)"}, ["a@b"], [])
    # ends by the signal at once, and is looked at all the same
    process_id = children.start("a@b")
    with contextlib.suppress(OSError):
        children.stop(Failing())
    children.stop()
    assert not Path(f"/proc/{process_id}").exists()


def test_an_exit_is_reported_once_with_its_signal(tmp_path: Path) -> None:
    children = processes(tmp_path, {"a@b": "import os, signal; os.kill(os.getpid(), signal.SIGKILL)"}, [], [])
    children.start("a@b")
    ended: dict[str, int] = {}
    while not ended:
        ended = children.reap()
    assert ended == {"a@b": -signal.SIGKILL}
    assert children.reap() == {}


def test_who_ignores_sigterm_is_killed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("telenano.launcher.processes.GRACE_S", 0.5)
    children = processes(tmp_path, {"a@b": STUBBORN}, ["a@b"], [])
    process_id = children.start("a@b")
    wait_for_line(children.log_path("a@b"))
    children.stop()
    assert not Path(f"/proc/{process_id}").exists()


def test_the_log_tail_is_for_a_person(tmp_path: Path) -> None:
    lines = [
        '{"level": "info", "text": "ready", "node": "a@b"}',
        '{"level": "error", "text": "broken", "exception": "Traceback ..."}',
        "ImportError: plain",
    ]
    children = processes(tmp_path, {"a@b": f"print({chr(10).join(lines)!r})"}, [], [])
    children.start("a@b")
    while not children.reap():
        pass
    assert children.log_tail("a@b") == "info: ready\nerror: broken\nTraceback ...\nImportError: plain"


def test_children_share_one_epoch_and_read_settings_from_the_scenario_only() -> None:
    environment = child_environment({"PATH": "/bin", "TELENANO__CONTROLLER__LAW": "x", "OMP_NUM_THREADS": "3"}, 42)
    assert environment["TELENANO_EPOCH_OFFSET_NS"] == "42"
    assert environment["OMP_NUM_THREADS"] == "3"
    assert environment["OPENBLAS_NUM_THREADS"] == "1"
    assert "TELENANO__CONTROLLER__LAW" not in environment


def test_a_node_does_not_outlive_a_supervisor_that_is_killed_however_early(tmp_path: Path) -> None:
    # the supervisor dies as soon as it has started the node, which has not even begun to run Python
    supervisor = (
        "import os, signal, sys\n"
        "from pathlib import Path\n"
        "from telenano.launcher.processes import NodeProcesses\n"
        "commands = {'a@b': [sys.executable, '-c', 'import signal; signal.pause()']}\n"
        "print(NodeProcesses(commands, [], Path(sys.argv[1]), 0).start('a@b'), flush=True)\n"
        "os.kill(os.getpid(), signal.SIGKILL)\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", supervisor, str(tmp_path)], capture_output=True, text=True, check=False, timeout=60
    )
    assert done.returncode == -signal.SIGKILL
    # where nobody reaps orphans, an ended one stays as a zombie
    with contextlib.suppress(psutil.NoSuchProcess):
        while psutil.Process(int(done.stdout)).status() != psutil.STATUS_ZOMBIE:
            pass
