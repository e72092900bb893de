"""A rig of real processes on this machine: `telenano up` in the background, and commands of a person to it."""

import json
import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from telenano.recording import Recording

# Far longer than expected: it only keeps a broken rig from blocking the suite [s].
PATIENCE_S = 150.0
# Length of the end of a log that a failure shows [characters].
_LOG_END = 1500


class LiveRig:
    """A rig in a separate folder, with runtime files that no other rig uses.

    Args:
        folder: The folder; the session writes to `out` in it.
    """

    # Arguments of every start, before those of the test.
    usual: Sequence[str] = ()
    # Called in each process of `telenano up` before it begins.
    before_start: Callable[[], None] | None = None
    # Folder in which its commands run; None for the folder of the tests.
    working_folder: Path | None = None

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.out = folder / "out"
        # The length of a socket's path is limited, and folders of tests are longer.
        self.sockets = Path(f"/tmp/tn-{os.getpid()}-{time.monotonic_ns() % 10**9}")
        self.environment = {**os.environ, "TELENANO_RUNTIME_DIR": str(self.sockets)}
        self.process: subprocess.Popen[str] | None = None

    def start(self, *arguments: str, scenario: str = "fig12") -> None:
        """Start a session.

        Args:
            arguments: Further words of `telenano up`.
            scenario: The scenario.
        """
        command = ["up", "--scenario", scenario, "--out", str(self.out), "--overwrite", "--json"]
        self.process = subprocess.Popen(
            self.command(*command, *self.usual, *arguments),
            env=self.environment,
            cwd=self.working_folder,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            preexec_fn=self.before_start,
        )

    def finish(self) -> tuple[int, dict[str, Any], str]:
        """Wait for the end of the session; return exit code, summary and standard error."""
        assert self.process is not None, "no session was started"
        out, err = self.process.communicate(timeout=PATIENCE_S)
        return self.process.returncode, json.loads(out) if out.strip() else {}, err

    def stop(self) -> tuple[int, dict[str, Any], str]:
        """End the session like Ctrl-C, wait for its end, and return the result of `finish`."""
        assert self.process is not None, "no session was started"
        self.process.send_signal(signal.SIGINT)
        return self.finish()

    def command(self, *arguments: str) -> list[str]:
        """Return the command line of a command of telenano."""
        return [sys.executable, "-m", "telenano", *arguments]

    def telenano(self, *arguments: str, patience_s: float = 60.0) -> "subprocess.CompletedProcess[str]":
        """Run another command beside the rig; return the finished process."""
        return subprocess.run(
            self.command(*arguments), env=self.environment, cwd=self.working_folder, stdin=subprocess.DEVNULL,
            capture_output=True, text=True, timeout=patience_s, check=False,
        )  # fmt: skip

    def process_of(self, node: str) -> int | None:
        """Return the process id of a node of this rig, such as controller@slave; None if it does not run."""
        name, _, site = node.partition("@")
        for process_id, words in _processes():
            # Nodes that share a process are named in its command line.
            is_meant = (f"services.{name}" in words and site in words) or ("services.site" in words and node in words)
            if is_meant and str(self.out / "scenario.yaml") in words:
                return process_id
        return None

    def process_ids(self) -> list[int]:
        """Return the ids of all processes that run for this rig, its launcher included."""
        # The command line of the fan-out has only the endpoints of the nodes, not the folder.
        own = (str(self.out), f"ipc://{self.sockets}")
        return [process_id for process_id, words in _processes() if any(word.startswith(own) for word in words)]

    def kill(self, node: str) -> int:
        """Kill the process of a node with SIGKILL and return its id."""
        process_id = self.process_of(node)
        assert process_id is not None, f"{node} does not run"
        os.kill(process_id, signal.SIGKILL)
        return process_id

    def session(self) -> "Recording":
        """Return the recording of the session so far."""
        from telenano.recording import Recording

        return Recording(max(self.out.glob("*.mcap"), key=lambda path: path.stat().st_mtime))

    def logs(self) -> str:
        """Return the ends of the logs of all nodes."""
        paths = sorted((self.out / "logs").glob("*.log"))
        return "\n".join(f"== {path.name}\n" + path.read_text()[-_LOG_END:] for path in paths)

    def log_has(self, node: str, text: str, times: int = 1) -> bool:
        """Return whether the log of a node contains a text at least `times` times."""
        path = self.out / "logs" / f"{node}.log"
        if not path.exists():
            # Nodes that share a process share its log.
            path = path.with_name(f"site@{node.partition('@')[2]}.log")
        return path.exists() and path.read_text().count(text) >= times

    def running(self) -> bool:
        """Return whether the programme of the hand has been started."""
        return self.log_has("launcher@master", "the session is running")

    def wait_until(self, condition: Callable[[], bool], what: str, patience_s: float = PATIENCE_S) -> None:
        """Wait until a condition is true; fail if the rig ends, or after a time.

        Args:
            condition: Returns whether the condition is true.
            what: Description of the condition for the failure.
            patience_s: The time after which to fail [s].
        """
        end = time.monotonic() + patience_s
        while time.monotonic() < end:
            if condition():
                return
            assert self.process is None or self.process.poll() is None, f"the rig ended: {self.finish()}{self.logs()}"
            time.sleep(0.1)
        raise AssertionError(f"waited in vain for: {what}\n{self.logs()}")

    def close(self) -> None:
        """End all processes of the rig, and remove its sockets."""
        if self.process is not None:
            if self.process.poll() is None:
                self.process.terminate()
            try:
                self.process.communicate(timeout=30)
            except subprocess.TimeoutExpired:
                self.process.kill()
                self.process.communicate()
            except ValueError:
                # `finish` has read the pipes to their end and closed them.
                self.process.wait()
        shutil.rmtree(self.sockets, ignore_errors=True)


def _processes() -> list[tuple[int, list[str]]]:
    """Return the ids of all processes with the words of their command lines."""
    found = []
    for entry in Path("/proc").iterdir():
        try:
            words = (entry / "cmdline").read_bytes().decode().split("\0") if entry.name.isdigit() else []
        except OSError:
            continue
        if words:
            found.append((int(entry.name), words))
    return found
