"""Identity of the session of a recording, by which every command that joins files decides whether they belong together.

A recorder writes the metadata record `session` at the start of each file: the rig, its start time, the digest of the
scenario, and the names that distinguish sessions (docs/recording.md has the rule as a table).
"""

import hashlib
import json
import secrets
from collections.abc import Iterator, Mapping, Sequence
from datetime import UTC, datetime
from itertools import combinations, islice
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple, Self, TypeVar

import yaml

from telenano.wire.errors import RecordingError

if TYPE_CHECKING:
    from telenano.recording.messages import RecordedMessage
    from telenano.recording.reader import Recording

# The metadata record; a merged recording has one for each part, the further ones as STEM/session.
SESSION_NAME = "session"
# Environment variable that the launcher sets for its recorders: session|run RIG BEGAN_NS TOKEN.
SESSION_VARIABLE = "TELENANO_RECORDED_SESSION"
# Most messages that are compared of the time that two files share.
_COMPARED = 2000
_BLOCK_BYTES = 1 << 20

_FileT = TypeVar("_FileT", bound="Recording")


class SessionIdentity(NamedTuple):
    """Identity of a recording's session, from its metadata; sets are empty if nothing is recorded.

    `sessions` are the names given by the launcher that conducted the session. `starts` are the ids of the commands that
    started the operator's force profile during the recording; they reach both sites. `runs` are the names of the rig at
    one site, or of a recorder started without a launcher; a run may have recorded several sessions.
    """

    sessions: frozenset[str] = frozenset()
    starts: frozenset[str] = frozenset()
    runs: frozenset[str] = frozenset()
    text: str = ""

    @classmethod
    def of(cls, metadata: Mapping[str, Mapping[str, str]]) -> Self:
        """Read the identity from the metadata of a recording."""
        found = [
            entries for name, entries in metadata.items() if name == SESSION_NAME or name.endswith(f"/{SESSION_NAME}")
        ]
        sessions, starts, runs = (
            frozenset(word for entries in found for word in entries.get(key, "").split()) for key in _KEYS
        )
        return cls(sessions, starts, runs, _described(found[0]) if found else "")

    @property
    def known(self) -> bool:
        """Whether the recording states its session in any way."""
        return bool(self.sessions or self.starts or self.runs)

    def is_that_of(self, other: "SessionIdentity") -> bool | None:
        """Return whether both are of one session; None if the identities do not tell."""
        for own, others in ((self.sessions, other.sessions), (self.starts, other.starts)):
            if own and others:
                return bool(own & others)
        return True if self.runs & other.runs else None


_KEYS = ("session", "starts", "run")


def given_identity(rig: str, began_ns: int, *, conducts: bool) -> str:
    """Return the value of `SESSION_VARIABLE` that a launcher sets for its recorders.

    Args:
        rig: The name of the rig.
        began_ns: Start of the launcher [ns].
        conducts: Whether the launcher conducts the session, so that its run is exactly one session. The launcher of
            the slave's site does not, and may serve several.
    """
    name = "".join(rig.split()) or "1"
    return f"{'session' if conducts else 'run'} {name} {began_ns} {secrets.token_hex(8)}"


def identity_entries(
    given: str, node: str, now_ns: int, scenario: bytes | None, simulated: Mapping[str, str]
) -> dict[str, str]:
    """Return the metadata record `session` of a recorder's files.

    Args:
        given: The value of `SESSION_VARIABLE`; empty for a recorder without a launcher.
        node: The key of the recorder, `node@site`.
        now_ns: Start of the recorder [ns].
        scenario: The content of the scenario file; None if there is none.
        simulated: The description of a simulation; empty for a real rig. A simulation is reproducible, so its identity
            is a digest of this and the scenario. It is one session if its `commands` are known in advance, else a run.
    """
    digest = "" if scenario is None else _digest(scenario)
    entries = {"rig": "", "began_ns": str(now_ns), "scenario": digest}
    if simulated:
        name = hashlib.sha256(repr((sorted(simulated.items()), digest)).encode()).hexdigest()[:32]
        key = "session" if "commands" in simulated else "run"
        return {**entries, "rig": "simulated", key: f"simulated-{name}"}
    words = given.split()
    if len(words) == 4 and words[0] in ("session", "run") and words[2].isdecimal():
        kind, rig, began_ns, token = words
        return {**entries, "rig": rig, "began_ns": began_ns, kind: f"{rig}-{began_ns}-{token}"}
    return {**entries, "run": f"{node}-{now_ns}-{secrets.token_hex(8)}"}


def _digest(scenario: bytes) -> str:
    """Return the SHA-256 of a scenario's settings without `recorder`: another folder is not another experiment."""
    try:
        document = yaml.safe_load(scenario)
    except (yaml.YAMLError, UnicodeDecodeError):
        return hashlib.sha256(scenario).hexdigest()
    if isinstance(document, dict):
        document = {key: value for key, value in document.items() if key != "recorder"}
    return hashlib.sha256(json.dumps(document, sort_keys=True, default=str).encode()).hexdigest()


def one_session(recordings: Sequence[_FileT], *, same_session: bool = False) -> list[_FileT]:
    """Check that files belong to one session; return them without copies of the same content.

    Args:
        recordings: The files that are to be read as one.
        same_session: Whether to join files that do not state whether they belong to one session.

    Raises:
        RecordingError: The files are of two sessions, do not state that they are of one, or two of them have the same
            messages. The message names two files, their identities, and a remedy.
    """
    files = each_once(recordings)
    said = [SessionIdentity.of(file.metadata) for file in files]
    groups = [{number} for number in range(len(files))]
    for one, other in combinations(range(len(files)), 2):
        answer = said[one].is_that_of(said[other])
        if answer is False:
            raise RecordingError(_two_sessions(files[one].path, said[one], files[other].path, said[other]))
        if answer:
            joined = [group for group in groups if one in group or other in group]
            groups = [group for group in groups if group not in joined] + [set[int]().union(*joined)]
    if len(groups) > 1 and not same_session:
        one, other = min(groups[0]), min(groups[1])
        raise RecordingError(_not_said(files[one].path, said[one], files[other].path, said[other]))
    for earlier, later in combinations(files, 2):
        _refuse_doubled(earlier, later)
    return files


def each_once(recordings: Sequence[_FileT]) -> list[_FileT]:
    """Return the recordings without repetitions of the same content, whatever their names."""
    kept: list[_FileT] = []
    for recording in recordings:
        if not any(_same_content(recording, earlier) for earlier in kept):
            kept.append(recording)
    return kept


def demand_several(sessions: Sequence[Sequence["Recording"]]) -> list[bool]:
    """Return, for each session, whether it counts: False if its files repeat those of an earlier one.

    Args:
        sessions: The files of each session.

    Raises:
        RecordingError: Two entries are different files of one session, which would count twice.
    """
    counted: list[bool] = []
    for number, files in enumerate(sessions):
        earlier = [each for each, wanted in zip(sessions[:number], counted, strict=True) if wanted]
        counted.append(not any(len(each_once([*each, *files])) == len(each) for each in earlier))
        for one in files if counted[-1] else ():
            for other in (file for each in earlier for file in each):
                _demand_other(other, one)
    return counted


def _demand_other(one: "Recording", other: "Recording") -> None:
    said, others = SessionIdentity.of(one.metadata), SessionIdentity.of(other.metadata)
    if said.sessions & others.sessions or (said.starts & others.starts and said.is_that_of(others)):
        raise RecordingError(
            f"{one.path} and {other.path} are of one session ({said.text}), which would count twice; give one of "
            f"them, or make them one by `telenano bag merge {one.path} {other.path} --out WHOLE.mcap`"
        )


def _same_content(one: "Recording", other: "Recording") -> bool:
    try:
        if one.path.samefile(other.path):
            return True
        if one.path.stat().st_size != other.path.stat().st_size:
            return False
        with one.path.open("rb") as left, other.path.open("rb") as right:
            while block := left.read(_BLOCK_BYTES):
                if block != right.read(_BLOCK_BYTES):
                    return False
            return not right.read(1)
    except OSError as error:
        raise RecordingError(f"{error.filename}: cannot be read: {error.strerror}") from error


def _refuse_doubled(one: "Recording", other: "Recording") -> None:
    """Raise RecordingError if two files of one recorder share messages, such as a recording and its extract."""
    start_ns = max(one.span_ns[0], other.span_ns[0])
    end_ns = min(one.span_ns[1], other.span_ns[1])
    nodes = {file.metadata.get("recording", {}).get("node", "") for file in (one, other)}
    if start_ns > end_ns or not end_ns or len(nodes) > 1:
        return
    shared = set(one.channels) & set(other.channels)

    def within(recording: "Recording") -> Iterator["RecordedMessage"]:
        messages = recording.select(lambda channel: channel in shared, start_ns, end_ns + 1)
        return islice(messages, _COMPARED)

    if not shared:
        return
    known = {(message.channel, message.log_ns, message.seq, message.payload) for message in within(one)}
    for message in within(other):
        if (message.channel, message.log_ns, message.seq, message.payload) in known:
            raise RecordingError(
                f"{one.path} and {other.path} have the same messages, such as {message.channel_topic} seq "
                f"{message.seq} of {message.src}, which would count twice; give one of them, as an "
                "extract of a recording is in the whole already"
            )


def _two_sessions(one: Path, said: SessionIdentity, other: Path, others: SessionIdentity) -> str:
    return (
        f"{one} and {other} are of two sessions: the first is of {said.text}, the second of {others.text}. Only files "
        f"of one session are put together; `telenano compare {one} {other}` shows two side by side, and `telenano "
        "report` and `telenano bag verify` take them one by one"
    )


def _not_said(one: Path, said: SessionIdentity, other: Path, others: SessionIdentity) -> str:
    facts = (
        f"{path} {f'is of {identity.text}' if identity.known else 'does not say whose session it is'}"
        for path, identity in ((one, said), (other, others))
    )
    said_of_both = " and ".join(facts)
    if not (said.known or others.known):
        said_of_both = f"{one} and {other} do not say whose session they are"
    return (
        f"{said_of_both}: it is not recorded that they are of one session. If they are, say so by "
        f"--same-session (same_session=True in Python); two sessions are shown by `telenano compare {one} {other}`"
    )


def _described(entries: Mapping[str, str]) -> str:
    rig = entries.get("rig", "")
    kind = f"the rig {rig}" if entries.get("session") else f"a site of the rig {rig}" if rig else "a recorder"
    try:
        began = datetime.fromtimestamp(int(entries.get("began_ns", "")) * 1e-9, UTC)
        when = f"begun {began.isoformat(sep=' ', timespec='milliseconds').removesuffix('+00:00')} UTC"
    except (ValueError, OverflowError, OSError):
        when = "begun at an unknown time"
    parts = [kind, when]
    if scenario := entries.get("scenario"):
        parts.append(f"scenario {scenario[:8]}")
    if starts := entries.get("starts"):
        parts.append(f"start {starts.split()[0]}")
    return ", ".join(parts)
