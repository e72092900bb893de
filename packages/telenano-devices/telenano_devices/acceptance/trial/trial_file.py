"""Writes and reads the one file of a trial: a zip with the verdicts, the recording, versions and errors.

The reader unpacks no more bytes than a trial can have, and accepts no other members.
"""

import io
import json
import platform
import zipfile
from importlib.metadata import distributions, version
from pathlib import Path
from typing import Any, NamedTuple

import msgspec

from telenano.files import atomic_file, open_regular
from telenano.wire import ConfigError
from telenano_devices.acceptance.handle.checks import HANDLE
from telenano_devices.acceptance.haptic_device.checks import HAPTIC_DEVICE
from telenano_devices.acceptance.instrument.checks import INSTRUMENT
from telenano_devices.acceptance.take import Kind, Take, Verdict, take_of
from telenano_devices.acceptance.trial.scrub import Scrubber

KINDS: tuple[Kind[Any], ...] = (HAPTIC_DEVICE, INSTRUMENT, HANDLE)
# The members of the zip.
ACCEPTANCE = "acceptance.json"
RECORDING = "take.npz"
VERSIONS = "versions.json"
ERRORS = "errors.json"
_SCHEMA = 1
# The largest sizes of members that are read.
_MOST_TEXT_BYTES = 2**20
_MOST_TAKE_BYTES = 32 * 2**20
_MOST = {ACCEPTANCE: _MOST_TEXT_BYTES, RECORDING: _MOST_TAKE_BYTES, VERSIONS: 2**16, ERRORS: _MOST_TEXT_BYTES}
# A fixed time makes the same content give the same bytes, and keeps the time of day out of the file.
_TIME = (1980, 1, 1, 0, 0, 0)


class Line(msgspec.Struct, frozen=True):
    """A line of the page: a check, the load during it, its result, the finding and the requirement."""

    check: str
    load: str
    result: str
    found: str
    wanted: str


class Acceptance(msgspec.Struct, frozen=True):
    """The result of a trial: the driver, the identity of the device, and the lines of its page in order."""

    schema: int
    driver: str
    device: str
    result: str
    seconds: float
    lines: list[Line]


class Problem(msgspec.Struct, frozen=True):
    """An error: the phase in which it happened, its message, and the places in the code, the innermost last."""

    where: str
    text: str
    places: list[str] = []


class Trial(NamedTuple):
    """The content of a file; `take` is None if nothing was recorded."""

    acceptance: Acceptance
    versions: dict[str, str]
    errors: list[Problem]
    take: Take[Any] | None = None


def versions() -> dict[str, str]:
    """Return the versions of telenano, of its packages, of Python and of the system."""
    packages = {one.name: one.version for one in distributions() if one.name.startswith("telenano")}
    return {
        "telenano": version("telenano"),
        **dict(sorted(packages.items())),
        "numpy": version("numpy"),
        "python": platform.python_version(),
        "system": f"{platform.system()} {platform.machine()}",
    }


def lines_of(kind: Kind[Any], take: Take[Any]) -> list[Line]:
    """Judge a recording and return its lines, sorted by load: checks that only read first, those with load last."""
    from telenano_devices.acceptance.take import LOADS

    judged = [(kind.load_of(take, verdict.check), verdict) for verdict in kind.judge(take)]
    judged.sort(key=lambda pair: LOADS.index(pair[0]))
    return [line_of(load, verdict) for load, verdict in judged]


def line_of(load: str, verdict: Verdict) -> Line:
    """Return a line of the page."""
    return Line(verdict.check, load, verdict.result, verdict.found, verdict.wanted)


def scrubbed(trial: Trial, scrubber: Scrubber) -> Trial:
    """Return a trial without names, paths, hosts and addresses in any text."""
    acceptance = trial.acceptance
    lines = [msgspec.structs.replace(line, found=scrubber.text(line.found)) for line in acceptance.lines]
    acceptance = msgspec.structs.replace(acceptance, lines=lines, device=scrubber.text(acceptance.device))
    errors = [Problem(each.where, scrubber.text(each.text), each.places) for each in trial.errors]
    take = trial.take and trial.take._replace(facts=scrubber.all(trial.take.facts))
    return Trial(acceptance, trial.versions, errors, take)


def write_trial(path: Path, trial: Trial) -> None:
    """Write the file of a trial.

    Raises:
        OSError: The file cannot be written.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    with atomic_file(path) as part, zipfile.ZipFile(part, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in (
            (ACCEPTANCE, trial.acceptance),
            (VERSIONS, trial.versions),
            (ERRORS, trial.errors),
        ):
            archive.writestr(_member(name), json.dumps(msgspec.to_builtins(content), indent=2) + "\n")
        if trial.take is not None:
            take = io.BytesIO()
            trial.take.save(take)
            archive.writestr(_member(RECORDING), take.getvalue())


def read_trial(path: Path) -> Trial:
    """Return the content of the file of a trial.

    Raises:
        ConfigError: The file cannot be read, is damaged, has more content than a trial, or is no trial file.
    """
    try:
        opened = open_regular(path)
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read: {error.strerror}") from error
    try:
        with opened as file, zipfile.ZipFile(file) as archive:
            members = archive.infolist()
            _require_once(members)
            contents = {member.filename: _content(archive, member) for member in members}
        acceptance = msgspec.json.decode(contents[ACCEPTANCE], type=Acceptance)
        if acceptance.schema != _SCHEMA:
            raise ValueError(f"{ACCEPTANCE}: has schema {acceptance.schema}, and {_SCHEMA} is read here")
        take = take_of(io.BytesIO(contents[RECORDING]), *KINDS)[1] if RECORDING in contents else None
        return Trial(
            acceptance,
            msgspec.json.decode(contents[VERSIONS], type=dict[str, str]),
            msgspec.json.decode(contents[ERRORS], type=list[Problem]),
            take,
        )
    except KeyError as error:
        raise ConfigError(f"{path}: is not a file of `telenano device trial`: it has no member {error}") from error
    # A damaged file can make zipfile and zlib raise anything.
    except Exception as error:
        raise ConfigError(f"{path}: is not a complete file of `telenano device trial`: {error}") from error


def kind_of(take: Take[Any]) -> Kind[Any]:
    """Return the kind of a recording, by its columns."""
    return next(kind for kind in KINDS if kind.row == take.rows.dtype)


def _member(name: str) -> zipfile.ZipInfo:
    member = zipfile.ZipInfo(name, _TIME)
    member.compress_type = zipfile.ZIP_DEFLATED
    return member


def _require_once(members: list[zipfile.ZipInfo]) -> None:
    """Raise ValueError if a name comes twice, before anything is unpacked: each copy would be unpacked."""
    names = [member.filename for member in members]
    if len(names) > len(_MOST):
        raise ValueError(f"it has {len(names)} members, and a trial has {len(_MOST)} at most")
    if twice := next((name for name in names if names.count(name) > 1), None):
        raise ValueError(f"its member {twice[:80]!r} comes twice")


def _content(archive: zipfile.ZipFile, member: zipfile.ZipInfo) -> bytes:
    most = _MOST.get(member.filename)
    if most is None:
        raise ValueError(f"it has a member {member.filename[:80]!r}, and a trial has {', '.join(_MOST)}")
    if member.file_size > most:
        raise ValueError(f"{member.filename}: has {member.file_size} bytes, and a trial at most {most}")
    with archive.open(member) as file:
        return file.read(most + 1)


def places_of(error: BaseException) -> list[str]:
    """Return the trace of an error as module:line, without any path, the innermost last; at most 12 places."""
    places, trace = [], error.__traceback__
    while trace is not None:
        module = trace.tb_frame.f_globals.get("__name__", "?")
        places.append(f"{module}:{trace.tb_lineno}")
        trace = trace.tb_next
    return places[-12:]
