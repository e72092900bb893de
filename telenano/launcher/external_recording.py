"""Recording of a session by a recorder of another launcher, which is commanded to begin a new file for the session."""

from pathlib import Path

from telenano.recording.reader import Recording
from telenano.runtime.loop.commands import Command
from telenano.timing.clock import Clock
from telenano.wire.errors import RecordingError
from telenano.wire.messages import NodeHealth, SessionControl, SessionEvent

# The recorder's first report may take this long once everything else is ready; it reports twice a second.
_RECORDER_WAIT_NS = 3_000_000_000


class ExternalRecording:
    """Tracks the files of a session from the events with which the recorder answers the command to begin a new file.

    `files`: paths of the session's files, on the recorder's machine; `fault`: the reason why there are none, empty
    while it records.
    """

    def __init__(self, clock: Clock, recorder: str) -> None:
        """Prepare the command to `recorder` (node@site) to begin a new file."""
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
        """Path of the session's first file, on the recorder's machine; empty if there is none."""
        return self.files[0] if self.files else ""

    def on_health(self, health: NodeHealth) -> None:
        if health.src == self.recorder:
            self._recorder_alive = True

    def on_event(self, event: SessionEvent) -> None:
        """Record the file that the recorder has begun, or the reason of its failure."""
        path = event.data.get("path")
        if event.src == self.recorder and event.kind == "recording" and isinstance(path, str):
            if event.data.get("state") == "started":
                self._newest = path
                if self._recording:
                    self.files.append(path)
            elif event.data.get("state") == "failed":
                self.fault = event.text

    def settled(self) -> bool:
        """Return whether the recorder has reported, or 3 s have passed since the first call."""
        now = self._clock.monotonic_ns()
        if self._wait_until_ns is None:
            self._wait_until_ns = now + _RECORDER_WAIT_NS
        return self._recorder_alive or now >= self._wait_until_ns

    def begin_steps(self) -> tuple[Command, ...]:
        """Return the command to begin a new file; an empty tuple if the recorder has never reported."""
        return (self._split,) if self._recorder_alive else ()

    def confirm_start(self, failure: str | None) -> None:
        """Take the newest file as that of the session, unless the command to begin it failed.

        `failure` is the reason of the failure; None if the recorder acknowledged the command.
        """
        if self._recorder_alive and failure is None and self._newest:
            # The recorder reports the file before it answers, on the same socket, so the newest file is the right one.
            self.files, self._recording, self.fault = [self._newest], True, ""
        elif self._recorder_alive:
            self.fault = failure or f"{self.recorder} did not report which file it began"

    def end_steps(self) -> tuple[Command, ...]:
        """Return the command that completes the session's file by beginning another; empty if no such file is open."""
        steps = self.begin_steps() if self._recording else ()
        self._recording = False
        return steps


def holds_command(path: Path, command_id: str) -> bool:
    """Return whether a recording contains the command with this id; RecordingError if it cannot be read."""
    for message in Recording(path).select(lambda channel: channel.topic == "session/control"):
        record = message.decode()
        if isinstance(record, SessionControl) and record.id == command_id:
            return True
    return False


def readable_here(path: str, command_id: str) -> bool:
    """Return whether the recorder's file exists on this machine and contains the command with this id.

    The command distinguishes it from another file with the same path.
    """
    file = Path(path)
    try:
        return file.is_file() and holds_command(file, command_id)
    except (OSError, RecordingError):
        return False
