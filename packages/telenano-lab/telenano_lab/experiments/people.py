"""The participants of an experiment: their pseudonyms and the facts that the analysis may use. No names are stored.

`people.json` has handedness, consent and exclusion of each pseudonym; only the laboratory's own list identifies the
person. `erase` removes everything of one participant.
"""

import hashlib
import json
import re
import shutil
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any, Literal, NamedTuple

from pydantic import Field

from telenano.files import changed
from telenano.settings import Settings, validate
from telenano.wire import ConfigError, RigError
from telenano_lab.experiments.journal import Journal, now_utc

NAME = "people.json"
# Folders with a subfolder per participant, and folders that are derived from the journal.
OF_PARTICIPANTS = ("recordings", "rig")
DERIVED = ("table", "analysis")
_SHAPE = re.compile(r"[A-Za-z]{1,4}[-_]?\d{1,6}")
_CHUNK = 1 << 20


class Person(Settings):
    """Facts about a participant."""

    handedness: Literal["left", "right", "both", "unknown"] = Field(default="unknown", description="The hand used")
    consent: bool = Field(default=False, description="Whether consent was given in writing, or at the page")
    simulated: bool = Field(default=False, description="Whether this is a simulated operator")
    excluded: str = Field(default="", max_length=200, description="Reason why the data do not count; empty if they do")


class _File(Settings):
    people: dict[str, Person] = Field(default={}, description="Participants by pseudonym")


def checked_pseudonym(text: str) -> str:
    """Return the pseudonym itself.

    Raises:
        ConfigError: It could be a name: a pseudonym is up to four letters and a number.
    """
    if not _SHAPE.fullmatch(text):
        raise ConfigError(f"{text!r} is not a pseudonym: it must be up to four letters and a number, such as P03")
    return text


class People:
    """The participants of the experiment in a folder.

    Args:
        folder: The folder of the experiment.

    Raises:
        ConfigError: The file is damaged; the message names the key.
    """

    def __init__(self, folder: Path) -> None:
        self.path = folder / NAME
        if folder.exists() and not folder.is_dir():
            raise ConfigError(f"{folder}: is a file, and the participants belong to the folder of an experiment")
        try:
            self.known = self._parsed(self.path.read_bytes() if self.path.exists() else None)
        except OSError as error:
            raise ConfigError(f"{self.path}: cannot be read: {error.strerror}") from error

    def change(self, pseudonym: str, **fields: Any) -> Person:
        """Change facts of a participant, who is added if the pseudonym is new.

        Raises:
            ConfigError: The pseudonym or a field is invalid, or the file is damaged.
            RigError: The file cannot be changed; it is as it was.
        """
        checked_pseudonym(pseudonym)

        def with_person(people: dict[str, Person]) -> dict[str, Person]:
            before = people.get(pseudonym, Person())
            changed_person = validate(Person, {**before.model_dump(), **fields}, str(self.path), pseudonym)
            return people | {pseudonym: changed_person}

        self._change(with_person)
        return self.known[pseudonym]

    def forget(self, pseudonym: str) -> None:
        """Remove a participant; RigError if the file cannot be changed."""
        if self.path.exists():
            self._change(lambda known: {name: person for name, person in known.items() if name != pseudonym})

    def _change(self, step: Callable[[dict[str, Person]], dict[str, Person]]) -> None:
        """Change the newest content of the file by `step`: another process may have changed it meanwhile."""

        def changed_bytes(before: bytes | None) -> bytes:
            self.known = step(self._parsed(before))
            rows = {name: person.model_dump() for name, person in sorted(self.known.items())}
            return (json.dumps(rows, indent=2) + "\n").encode()

        self.path.parent.mkdir(parents=True, exist_ok=True)
        changed(self.path, changed_bytes, mode=0o666)

    def _parsed(self, content: bytes | None) -> dict[str, Person]:
        try:
            document = {} if content is None else json.loads(content)
        except ValueError as error:
            raise ConfigError(f"{self.path}: cannot be read: {error}") from error
        return dict(validate(_File, {"people": document}, str(self.path)).people)


def digest_of(path: Path) -> str:
    """Return the SHA-256 of a file."""
    digest = hashlib.sha256()
    with path.open("rb") as file:
        while chunk := file.read(_CHUNK):
            digest.update(chunk)
    return digest.hexdigest()


class ErasureResult(NamedTuple):
    """The result of an erasure: numbers of removed files and records, and of earlier published copies."""

    files: int
    records: int
    published_before: int


def erase(folder: Path, pseudonym: str) -> ErasureResult:
    """Remove all data of a participant.

    An interrupted erasure is completed by repeating it. The journal keeps a record that the pseudonym was erased.

    Args:
        folder: The folder of the experiment.
        pseudonym: The participant.

    Raises:
        ConfigError: There are no data of the participant.
        RigError: The experiment is running, or a file still names the participant.
    """
    checked_pseudonym(pseudonym)
    with Journal(folder / "journal.jsonl") as journal:
        people = People(folder)
        mine = [record for record in journal.records if record.get("participant") == pseudonym]
        folders = [path for kind in OF_PARTICIPANTS for path in _folders(folder / kind, pseudonym)]
        if all(record["record"] == "erased" for record in mine) and not folders and pseudonym not in people.known:
            raise ConfigError(f"{folder}: has no data of {pseudonym}")
        gone = (*folders, *(folder / kind for kind in DERIVED))
        files = sum(path.is_file() for parent in gone for path in parent.rglob("*"))
        for path in gone:
            shutil.rmtree(path, ignore_errors=True)
        people.forget(pseudonym)
        kept = [record for record in journal.records if record.get("participant") != pseudonym]
        note = {"record": "erased", "utc": now_utc(), "participant": pseudonym}
        published = sum(1 for _ in journal.of("published"))
        journal.replace([*kept, note])
        left = _left(folder, pseudonym)
    if left:
        raise RigError(f"{folder}: {pseudonym} is still named in {', '.join(left)}; remove it there")
    return ErasureResult(files, len(mine), published)


def _folders(parent: Path, pseudonym: str) -> Iterator[Path]:
    """Yield the folder of a participant, and those of the participant's rigs."""
    for path in sorted(parent.glob(f"{pseudonym}*")):
        if path.name == pseudonym or path.name.startswith(f"{pseudonym}-"):
            yield path


def _left(folder: Path, pseudonym: str) -> list[str]:
    """Return the text files, other than plan and journal, that still name a participant."""
    files = []
    for path in sorted(folder.rglob("*")):
        is_text = path.suffix in (".json", ".jsonl", ".csv", ".md", ".txt", ".log", ".yaml")
        if not path.is_file() or not is_text or path.name in ("journal.jsonl", "experiment.yaml"):
            continue
        if re.search(rf"\b{re.escape(pseudonym)}\b", path.read_text(encoding="utf-8", errors="replace")):
            files.append(str(path.relative_to(folder)))
    return files


def shown(people: Mapping[str, Person]) -> list[dict[str, Any]]:
    """Return a row for each participant."""
    return [{"participant": name, **person.model_dump()} for name, person in people.items()]
