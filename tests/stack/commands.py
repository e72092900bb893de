"""The telenano command without the second that a new interpreter needs for its imports: forked from one that has them.

A rig leaves little of two processors, and a test gives dozens of commands beside it. Each runs in a process of its own,
with its own environment, files and, where asked for, network namespace; `telenano.cli.app.main` is what it runs.
"""

import ctypes
import json
import os
import select
import signal
import subprocess
import sys
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[2]
_CLONE_NEWNET = 0x40000000


class Commands:
    """Runs telenano commands, one at a time."""

    def __init__(self) -> None:
        self._process: subprocess.Popen[str] | None = None

    def run(
        self, arguments: tuple[str, ...], environment: Mapping[str, str], patience_s: float, namespace: str = ""
    ) -> "subprocess.CompletedProcess[str]":
        """Run a command to its end; TimeoutExpired when that takes longer than `patience_s` [s]."""
        if self._process is None:
            command = [sys.executable, str(Path(__file__)), "serve"]
            pipe = subprocess.PIPE
            self._process = subprocess.Popen(command, cwd=ROOT, stdin=pipe, stdout=pipe, text=True)
        process = self._process
        assert process.stdin is not None
        assert process.stdout is not None
        with tempfile.TemporaryDirectory() as folder:
            out, err = Path(folder) / "out", Path(folder) / "err"
            request = {
                "arguments": arguments,
                "environment": dict(environment),
                "namespace": namespace,
                "out": str(out),
                "err": str(err),
            }
            process.stdin.write(json.dumps(request) + "\n")
            process.stdin.flush()
            if not select.select([process.stdout], [], [], patience_s)[0]:
                self.close()
                # the command may not have begun
                said = [path.read_text() if path.exists() else "" for path in (out, err)]
                raise subprocess.TimeoutExpired(list(arguments), patience_s, *said)
            code = int(process.stdout.readline())
            return subprocess.CompletedProcess(list(arguments), code, out.read_text(), err.read_text())

    def close(self) -> None:
        """End the process that has the imports, and the command that it may be running."""
        if self._process is not None:
            self._process.terminate()
            self._process.communicate()
            self._process = None


COMMANDS = Commands()


def serve() -> None:
    """Fork a command for each line of standard input, and print its exit code."""
    running: list[int] = []

    def end(number: int, frame: object) -> None:
        for child in running:
            os.kill(child, signal.SIGKILL)
        os._exit(0)

    signal.signal(signal.SIGTERM, end)
    for line in sys.stdin:
        child = os.fork()
        if child == 0:
            become(json.loads(line))
        running.append(child)
        _, status = os.waitpid(child, 0)
        running.clear()
        sys.stdout.write(f"{os.waitstatus_to_exitcode(status)}\n")
        sys.stdout.flush()


def become(request: dict[str, Any]) -> None:
    """Be the command: it never returns."""
    from telenano.cli.app import main

    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    if request["namespace"]:
        with Path("/run/netns", request["namespace"]).open() as namespace:
            assert ctypes.CDLL(None, use_errno=True).setns(namespace.fileno(), _CLONE_NEWNET) == 0
    for target, name in ((1, "out"), (2, "err")):
        os.dup2(os.open(request[name], os.O_WRONLY | os.O_CREAT, 0o600), target)
    os.dup2(os.open(os.devnull, os.O_RDONLY), 0)
    os.environ.clear()
    os.environ.update(request["environment"])
    sys.argv = ["telenano", *request["arguments"]]
    code: object = 1
    try:
        code = main()
    except SystemExit as left:
        code = left.code
    except BaseException:  # noqa: BLE001 the process ends here, as an interpreter would
        sys.excepthook(*sys.exc_info())  # type: ignore[arg-type]
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(code if isinstance(code, int) else 0 if code is None else 1)


if __name__ == "__main__":
    # what most commands import when they run; no models, which a study has to compile first of all
    from telenano.cli.lazy_commands import load

    for command in ("keys", "link", "session", "status", "topic"):
        load(command)

    serve()
