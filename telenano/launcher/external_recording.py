"""The recording of a recorder that this process does not run: it is commanded to begin a file for the session."""

from pathlib import Path

from telenano.recording.reader import Recording
from telenano.runtime.loop.commands import Command
from telenano.timing.clock import Clock
from telenano.wire.errors import RecordingError
from telenano.wire.messages import NodeHealth, SessionControl, SessionEvent

# The recorder's first report may take this long once everything else is ready; it reports twice a second.
_RECORDER_WAIT_NS = 3_000_000_000


class ExternalRecording:
    """Which file a session goes to, learned from the recorder's events around the command to begin a new one.

    `files` are those of the session, where the recorder is; `fault`: why there are none, empty while it records.
    """

    def __init__(self, clock: Clock, recorder: str) -> None:
        """Prepare the command for `recorder` (node@site)."""
        self.recorder = recorder
        self._split = Command("set", recorder, (recorder,), {"record.split": True}, required=False)
        self.files: list[str] = []
        self.fault = "no recorder reported"
        self._clock = clock
        self._newest = ""
        self._recorder_alive = False
        self._recording = False
        self._wait_until_ns: int | None = None

    @property
    def path(self) -> str:
        """File of the session where the recorder is; empty when there is none."""
        return self.files[0] if self.files else ""

    def on_health(self, health: NodeHealth) -> None:
        if health.src == self.recorder:
            self._recorder_alive = True

    def on_event(self, event: SessionEvent) -> None:
        """Record which file the recorder began, or why it failed."""
        path = event.data.get("path")
        if event.src == self.recorder and event.kind == "recording" and isinstance(path, str):
            if event.data.get("state") == "started":
                self._newest = path
                if self._recording:
                    self.files.append(path)
            elif event.data.get("state") == "failed":
                self.fault = event.text

    def settled(self) -> bool:
        """Return whether the recorder is alive, or the time to wait for it, from the first call on, is over."""
        now = self._clock.monotonic_ns()
        if self._wait_until_ns is None:
            self._wait_until_ns = now + _RECORDER_WAIT_NS
        return self._recorder_alive or now >= self._wait_until_ns

    def begin_steps(self) -> tuple[Command, ...]:
        """Return the command to begin a new file; none without a recorder."""
        return (self._split,) if self._recorder_alive else ()

    def confirm_start(self, failure: str | None) -> None:
        """Record the outcome of the first command: the newest file is the session's, unless the command failed."""
        if self._recorder_alive and failure is None and self._newest:
            # the recorder reports the file before it answers, on the same socket
            self.files, self._recording, self.fault = [self._newest], True, ""
        elif self._recorder_alive:
            self.fault = failure or f"{self.recorder} did not report which file it began"

    def end_steps(self) -> tuple[Command, ...]:
        """Return the command that completes the session's file; none where there is no such file."""
        steps = self.begin_steps() if self._recording else ()
        self._recording = False
        return steps


def holds_command(path: Path, command_id: str) -> bool:
    """Return whether a recording contains a command; RecordingError when it cannot be read."""
    for message in Recording(path).select(lambda channel: channel.topic == "session/control"):
        record = message.decode()
        if isinstance(record, SessionControl) and record.id == command_id:
            return True
    return False


def readable_here(path: str, command_id: str) -> bool:
    """Return whether the file that a recorder named is here and is the session's, not another one of the same name."""
    file = Path(path)
    try:
        return file.is_file() and holds_command(file, command_id)
    except (OSError, RecordingError):
        return False
