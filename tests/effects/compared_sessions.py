"""What a person sees of a session in virtual time, and the first difference between two sessions.

    seen = Seen(SESSION)
    changed = seen.difference({**SESSION.scenario, ...})

Messages are compared without what only repeats a setting: the settings in force of `link/status`, the nominal period in
`node/health`, the sentences of events that are no warning. The journal of a node is not compared.
"""

from collections.abc import Callable, Iterator, Mapping
from contextlib import closing
from dataclasses import dataclass, field
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple

import msgspec
import yaml
from mcap.reader import make_reader

from telenano.settings.config import merge
from telenano.virtual import ARMED_S, STARTED_S, VirtualRig
from telenano.virtual.request import SimulateRequest, plan_of, run_plan
from telenano.wire import Message

PRESSES: Mapping[str, Any] = {
    "name": "effects",
    "description": "A hand presses the tip onto mica and lets go",
    "duration_s": 1.0,
    "haptic_node": {
        "operator": {
            "kind": "force_profile",
            "points": [
                {"time_s": 0.05, "force_n": 0.0},
                {"time_s": 0.1, "force_n": 2.0},
                {"time_s": 0.5, "force_n": 2.0},
                {"time_s": 0.55, "force_n": 0.0},
            ],
        }
    },
    "afm_node": {"rest_distance_m": 1e-8},
}
SEED = 11
# The journal repeats what a node received, and a command comes from the test.
# Metadata that repeats the settings, or says how long the recorder took.
_REPEATS = ("provenance", "recording", "end")
_NOT_SEEN = ("node/journal", "session/control")


class Timed(NamedTuple):
    """Something that happens in a session at a time since its begin [s]."""

    time_s: float
    happens: Callable[[VirtualRig], None]


@dataclass(frozen=True)
class Session:
    """A session that is compared with another one of other settings.

    Attributes:
        settings: What differs from a hand that presses the tip onto mica.
        end_s: When it ends [s].
        happens: What happens beside the arming and the start of the hand.
        is_started: Whether the hand is started.
        rate_hz: The rate of the loop [Hz], a quarter of the usual one, which takes a quarter of the time; None leaves
            it out.
        are_files: Whether the recording is compared instead of the messages.
        is_conducted: Whether a launcher conducts the recorded session, as `telenano simulate` does.
    """

    settings: Mapping[str, Any] = field(default_factory=dict)
    end_s: float = 1.3
    happens: tuple[Timed, ...] = ()
    is_started: bool = True
    rate_hz: float | None = 250.0
    are_files: bool = False
    is_conducted: bool = False

    def course(self) -> Iterator[Timed]:
        """Yield what happens, in the order of time."""
        own = [Timed(ARMED_S, lambda rig: rig.command("arm", "*", place="hand"))]
        if self.is_started:
            own.append(Timed(STARTED_S, lambda rig: rig.command("start", "haptic_node")))
        yield from sorted([*own, *self.happens], key=lambda timed: timed.time_s)


def command(time_s: float, name: str, target: str, **parameters: Any) -> Timed:
    """Return a command that is given at a time."""
    return Timed(time_s, lambda rig: rig.command(name, target, **parameters))


def seen_of(topic: str, message: Message, payload: bytes) -> Any:
    """Return what is compared of a message, None where nothing is."""
    if topic in _NOT_SEEN:
        return None
    if topic == "link/status":
        whole = msgspec.to_builtins(message)
        for way in ("forward", "backward"):
            del whole[way]["settings"], whole[way]["profile"]
        return whole
    if topic == "node/health":
        return msgspec.structs.replace(message, period_s=0.0, calibration=None)  # type: ignore[call-arg]
    if topic == "session/event":
        is_news = message.level != "info"  # type: ignore[attr-defined]
        return msgspec.structs.replace(message, data={}, **({} if is_news else {"text": ""}))  # type: ignore[call-arg]
    if topic == "law/status":
        return msgspec.structs.replace(message, law="")  # type: ignore[call-arg]
    return payload


class _ComparedRig(VirtualRig):
    """A rig that is over as soon as a node sends something other than in another session."""

    def __init__(self, scenario: Mapping[str, Any], expected: list[tuple[str, Any]] | None) -> None:
        self.seen: list[tuple[str, Any]] = []
        self.difference = ""
        self._expected = expected
        super().__init__(None, SEED, scenario=scenario)

    def carry(self, topic: str, message: Message, payload: bytes, sent_ns: int) -> None:
        seen = seen_of(topic, message, payload)
        if seen is not None and not self.difference:
            number = len(self.seen)
            self.seen.append((topic, seen))
            expected = self._expected
            if expected is not None and (number >= len(expected) or expected[number] != (topic, seen)):
                self.difference = f"{topic} of {message.src}"
                self.is_over = True
        super().carry(topic, message, payload, sent_ns)


def seen(session: Session) -> "Seen | FilesSeen":
    """Return what is seen of a session, its messages or its files."""
    return FilesSeen(session) if session.are_files else Seen(session)


class Seen:
    """What is seen of a session, with which others are compared.

    Raises:
        ConfigError: The settings of the session cannot be used.
    """

    def __init__(self, session: Session) -> None:
        self.session = session
        rig = self._run(session.settings, None)
        self._expected, self._lines = rig.seen, lines_of(rig)
        self.refusals = [seen.text for topic, seen in rig.seen if topic == "session/event" and seen.kind == "refused"]

    def difference(self, settings: Mapping[str, Any]) -> str:
        """Return what is seen to be different under other settings, empty if nothing is.

        Raises:
            ConfigError: These settings cannot be used.
        """
        rig = self._run(merge(dict(self.session.settings), dict(settings)), self._expected)
        if rig.difference:
            return rig.difference
        if len(rig.seen) < len(self._expected):
            return f"no more {self._expected[len(rig.seen)][0]}"
        return "log" if lines_of(rig) != self._lines else ""

    def _run(self, settings: Mapping[str, Any], expected: list[tuple[str, Any]] | None) -> _ComparedRig:
        rate = {} if self.session.rate_hz is None else {"realtime": {"rate_hz": self.session.rate_hz}}
        with closing(_ComparedRig(merge(dict(PRESSES), rate, dict(settings)), expected)) as rig:
            for timed in self.session.course():
                rig.run_until(timed.time_s)
                if rig.is_over:
                    return rig
                timed.happens(rig)
            rig.run_until(self.session.end_s)
            return rig


def lines_of(rig: VirtualRig) -> dict[str, list[str]]:
    """Return the last lines of the log of each node, without those that only say what it does."""
    return {key: [line for line in log.lines if not line.startswith("info")] for key, log in rig.logs.items()}


class FilesSeen:
    """What is seen of the files of a session, with which those of others are compared."""

    def __init__(self, session: Session) -> None:
        self.session = session
        self._expected = self._files(session.settings)

    def difference(self, settings: Mapping[str, Any]) -> str:
        """Return what is seen to be different in the files under other settings, empty if nothing is."""
        found = self._files(merge(dict(self.session.settings), dict(settings)))
        if found.keys() != self._expected.keys():
            return f"files {', '.join(sorted(found))}"
        return next((f"content of {name}" for name, facts in found.items() if facts != self._expected[name]), "")

    def _files(self, settings: Mapping[str, Any]) -> dict[str, Any]:
        with TemporaryDirectory() as name:
            folder = Path(name)
            if self.session.is_conducted:
                _conduct(folder, settings)
            else:
                _record(folder, self.session, settings)
            return {str(path.relative_to(folder)): facts_of(path) for path in sorted(folder.rglob("*.mcap"))}


def _record(folder: Path, session: Session, settings: Mapping[str, Any]) -> None:
    rig = VirtualRig(folder, SEED, scenario=merge(dict(PRESSES), dict(settings)))
    with closing(rig):
        for timed in session.course():
            rig.run_until(timed.time_s)
            timed.happens(rig)
        rig.run_until(session.end_s)
        rig.finish()


def _conduct(folder: Path, settings: Mapping[str, Any]) -> None:
    scenario = folder / "scenario_given.yaml"
    scenario.write_text(yaml.safe_dump(merge(dict(PRESSES), dict(settings))), encoding="utf-8")
    request = SimulateRequest(scenario=str(scenario), out=folder / "session")
    run_plan(plan_of(request, folder / "session"), request)


def facts_of(path: Path) -> tuple[Any, ...]:
    """Return what a reader of MCAP sees of a file: its channels, how much each one has, and its chunks."""
    with path.open("rb") as stream:
        reader = make_reader(stream)
        summary = reader.get_summary()
        records = [(record.name, record.metadata) for record in reader.iter_metadata() if record.name not in _REPEATS]
    assert summary is not None and summary.statistics is not None
    counts = summary.statistics.channel_message_counts
    return (
        sorted((channel.topic, counts.get(number, 0)) for number, channel in summary.channels.items()),
        records,
        [(chunk.compression, chunk.message_start_time, chunk.message_end_time) for chunk in summary.chunk_indexes],
    )
