"""A rig that an experiment starts: `telenano up` as a child process, which ends with the experiment in every case."""

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import yaml

from telenano.launcher import running_rigs
from telenano.signals import start
from telenano.wire import RigError

# Environment variable that names the rig of commands, like --rig.
RIG_VARIABLE = "TELENANO_RIG"
# A rig is ready within half a minute, even if its models have to be compiled first.
_READY_S = 120.0
_END_S = 60.0
_LOOK_S = 0.1
_LAST_LINES = 12
# The longest session that a scenario may have [s]; the experiment ends it before.
_LONGEST_S = 86_400.0


class RigProcess:
    """A rig with the scenario of the first trial.

    Args:
        folder: The folder of the rig, which is created.
        document: The scenario.
        further: Further options of `telenano up`.
        show: Called with messages for a person, such as the address of the page.

    Raises:
        RigError: The rig did not come up; the message has its last lines.
    """

    def __init__(
        self, folder: Path, document: Mapping[str, Any], further: Sequence[str], show: Callable[[str], None]
    ) -> None:
        self.folder = folder
        self._show, self._lines_shown = show, 0
        folder.mkdir(parents=True)
        scenario = folder / "trial.yaml"
        scenario.write_text(yaml.safe_dump({**document, "duration_s": _LONGEST_S}, sort_keys=False), encoding="utf-8")
        command = [
            sys.executable,
            "-m",
            "telenano",
            "up",
            "--scenario",
            str(scenario),
            "--out",
            str(folder / "session"),
        ]
        self._before = os.environ.get(RIG_VARIABLE)
        # A pipe would break if this process is killed, while the rig shuts down in order.
        self._log = folder / "up.log"
        with self._log.open("wb") as log:
            self._process = start(
                [*command, *further],
                stdin=subprocess.DEVNULL,
                stdout=log,
                stderr=log,
                dies_with_parent=True,
                ends_with_command=True,
            )
        try:
            os.environ[RIG_VARIABLE] = self._named()
        except BaseException:
            self.end()
            raise

    @property
    def recordings(self) -> list[Path]:
        """The existing files of the recording, the newest last."""
        paths = (self.folder / "session").glob("session*.mcap")
        return sorted(paths, key=lambda path: int(path.stem.partition("_")[2] or 0))

    def check(self) -> None:
        """Show the rig's messages on its page; RigError if it has ended by itself."""
        lines = self._lines()
        for line in lines[self._lines_shown :]:
            if "http" in line or line.startswith("telenano:"):
                self._show(line)
        self._lines_shown = len(lines)
        if self._process.poll() is not None:
            raise RigError("the rig has ended:", *lines[-_LAST_LINES:])

    def end(self) -> None:
        """End the rig in order: its devices are made safe first."""
        if self._process.poll() is None:
            self._process.send_signal(signal.SIGTERM)
            try:
                self._process.wait(_END_S)
            except subprocess.TimeoutExpired:
                self._process.kill()
                self._process.wait()
        os.environ.pop(RIG_VARIABLE, None)
        if self._before is not None:
            os.environ[RIG_VARIABLE] = self._before

    def _named(self) -> str:
        """Wait until the rig has a name, and return it."""
        deadline_s = time.monotonic() + _READY_S
        while time.monotonic() < deadline_s:
            self.check()
            for rig in running_rigs():
                if rig.about.get("process") == self._process.pid:
                    return rig.name
            time.sleep(_LOOK_S)
        raise RigError("the rig did not come up:", *self._lines()[-_LAST_LINES:])

    def _lines(self) -> list[str]:
        return self._log.read_text(encoding="utf-8", errors="replace").splitlines()


def wait_for_others(folder: Path, show: Callable[[str], None]) -> None:
    """Wait until rigs of an earlier, killed run of this experiment have ended by themselves."""
    deadline_s, is_reported = time.monotonic() + _END_S, False
    while time.monotonic() < deadline_s:
        mine = [
            rig for rig in running_rigs() if str(rig.about.get("out", "")).startswith(f"{folder.resolve()}{os.sep}")
        ]
        if not mine:
            return
        if not is_reported:
            show(f"waiting for rig {mine[0].name} of a run before this one, which is ending")
            is_reported = True
        time.sleep(_LOOK_S)
    raise RigError(f"rig {mine[0].name} of a run before this one does not end: stop it (`telenano status --all`)")
