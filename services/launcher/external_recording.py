"""The recording of a recorder that is somebody else's: it is asked to give the session a file of its own."""

from pathlib import Path

from proto.errors import RecordingError
from proto.messages import NodeHealth, SessionControl, SessionEvent
from recording.reader import Recording
from services.launcher.command_sequence import Step
from services.runtime.clock import Clock

# what the recorder may take to be heard once everything else is: it reports twice a second
_PATIENCE_NS = 3_000_000_000
_ANSWER_NS = 5_000_000_000


class ExternalRecording:
    """Which file a session goes to: learned from what the recorder says around the order to begin a new one."""

    def __init__(self, clock: Clock, recorder: str) -> None:
        """Take the recorder's name, node@site."""
        self.recorder = recorder
        self.order = Step("set", recorder, (recorder,), {"record.split": True}, required=False, deadline_ns=_ANSWER_NS)
        self.files: list[str] = []
        self.fault = "no recorder was heard"
        self._clock = clock
        self._newest = ""
        self._heard = False
        self._recording = False
        self._patient_until_ns: int | None = None

    @property
    def path(self) -> str:
        """File of the session where the recorder is; empty when there is none."""
        return self.files[0] if self.files else ""

    def enter_health(self, health: NodeHealth) -> None:
        """Take a sign of life."""
        if health.src == self.recorder:
            self._heard = True

    def enter_event(self, event: SessionEvent) -> None:
        """Take what is said of a recording."""
        path = event.data.get("path")
        if event.src == self.recorder and event.kind == "recording" and isinstance(path, str):
            if event.data.get("state") == "started":
                self._newest = path
                if self._recording:
                    self.files.append(path)
            elif event.data.get("state") == "failed":
                self.fault = event.text

    def settled(self) -> bool:
        """Say whether it is known that there is a recorder, or time to go on without."""
        now = self._clock.monotonic_ns()
        if self._patient_until_ns is None:
            self._patient_until_ns = now + _PATIENCE_NS
        return self._heard or now >= self._patient_until_ns

    def steps(self) -> tuple[Step, ...]:
        """Give the order to begin a new file, where there is somebody to give it to."""
        return (self.order,) if self._heard else ()

    def begun(self, complaint: str | None) -> None:
        """Enter that the first order was answered: the newest file is that of the session, unless it was refused."""
        if self._heard and complaint is None and self._newest:
            # the recorder tells of the file before it answers, on the same socket
            self.files, self._recording, self.fault = [self._newest], True, ""
        elif self._heard:
            self.fault = complaint or f"{self.recorder} did not say which file it began"

    def ending(self) -> tuple[Step, ...]:
        """Give the order that completes the session's file, where there is one."""
        steps = self.steps() if self._recording else ()
        self._recording = False
        return steps


def holds_command(path: Path, command_id: str) -> bool:
    """Say whether a recording is the one in which a command was given; RecordingError when it cannot be read."""
    for message in Recording(path).select(lambda channel: channel.topic == "session/control"):
        record = message.decode()
        if isinstance(record, SessionControl) and record.id == command_id:
            return True
    return False


def readable_here(path: str, command_id: str) -> bool:
    """Say whether the file that a recorder named is here, and is that of the session and not a namesake."""
    found = Path(path)
    try:
        return found.is_file() and holds_command(found, command_id)
    except (OSError, RecordingError):
        return False
