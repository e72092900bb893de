"""The participants of an experiment: pseudonyms and what the analysis may know of them. Names are kept nowhere.

`people.json` has handedness, consent and exclusion of each pseudonym; which person it is, only the laboratory's own
list says. `erase` removes everything of one participant and leaves a proof without the pseudonym.
"""

import hashlib
import json
import re
import shutil
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, Literal

from pydantic import Field

from proto.errors import ConfigError, RigError
from recording.whole_files import whole_file
from services.runtime.settings.config import Settings, validate
from telenano_experiments.journal import Journal, Record, now_utc

NAME = "people.json"
ERASURES = "erased"
# The folders of which each participant has one of his own, and those that are made anew from the journal.
OF_PARTICIPANTS = ("recordings", "rig")
DERIVED = ("table", "analysis")
_SHAPE = re.compile(r"[A-Za-z]{1,4}[-_]?\d{1,6}")
_CHUNK = 1 << 20


class Person(Settings):
    """What is known of a participant."""

    handedness: Literal["left", "right", "both", "unknown"] = Field(default="unknown", description="The hand used")
    consent: bool = Field(default=False, description="Whether consent was given in writing, or at the page")
    simulated: bool = Field(default=False, description="Whether this is a simulated operator")
    excluded: str = Field(default="", max_length=200, description="Why the data do not count; empty if they do")


class _File(Settings):
    people: dict[str, Person] = Field(default={}, description="Participants by pseudonym")


def checked_pseudonym(text: str) -> str:
    """Return a pseudonym.

    Raises:
        ConfigError: It could be a name: a pseudonym is up to four letters and a number.
    """
    if not _SHAPE.fullmatch(text):
        raise ConfigError(f"{text!r} is no pseudonym: it has to be up to four letters and a number, such as P03")
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
        try:
            document = json.loads(self.path.read_text(encoding="utf-8")) if self.path.exists() else {}
        except (OSError, ValueError) as error:
            raise ConfigError(f"{self.path}: cannot be read: {error}") from error
        self.known: dict[str, Person] = dict(validate(_File, {"people": document}, str(self.path)).people)

    def change(self, pseudonym: str, **fields: Any) -> Person:
        """Note something of a participant, who is added where there is none of that pseudonym."""
        before = self.known.get(checked_pseudonym(pseudonym), Person())
        self.known[pseudonym] = validate(Person, {**before.model_dump(), **fields}, str(self.path), pseudonym)
        self._write()
        return self.known[pseudonym]

    def forget(self, pseudonym: str) -> None:
        """Remove a participant."""
        if self.known.pop(pseudonym, None) is not None:
            self._write()

    def _write(self) -> None:
        rows = {name: person.model_dump() for name, person in sorted(self.known.items())}
        self.path.parent.mkdir(parents=True, exist_ok=True)
        with whole_file(self.path) as part:
            part.write_text(json.dumps(rows, indent=2) + "\n", encoding="utf-8")


def digest_of(path: Path) -> str:
    """Return the SHA-256 of a file."""
    digest = hashlib.sha256()
    with path.open("rb") as file:
        while chunk := file.read(_CHUNK):
            digest.update(chunk)
    return digest.hexdigest()


def erase(folder: Path, pseudonym: str, signed_by: str = "") -> tuple[Path, dict[str, Any]]:
    """Remove all data of a participant, and write a proof of what is gone.

    The proof has kinds, sizes and SHA-256 of the files and records, but neither the pseudonym nor a name of a file; the
    proof before it is in its digest, so that none can be taken away unnoticed. An erasure that was interrupted is done
    by doing it again. The journal keeps that there is nothing more to be done for the pseudonym.

    Args:
        folder: The folder of the experiment.
        pseudonym: The participant.
        signed_by: Who did it, such as the role of a person.

    Returns:
        The path of the proof, and its content.

    Raises:
        ConfigError: Nothing is known of the participant.
        RigError: The experiment runs, or something of the participant is still there.
    """
    checked_pseudonym(pseudonym)
    with Journal(folder / "journal.jsonl") as journal:
        people = People(folder)
        mine = [record for record in journal.records if record.get("participant") == pseudonym]
        folders = [path for kind in OF_PARTICIPANTS for path in _folders(folder / kind, pseudonym)]
        if all(record["record"] == "erased" for record in mine) and not folders and pseudonym not in people.known:
            raise ConfigError(f"{folder}: has no data of {pseudonym}")
        copies = [record["path"] for record in journal.of("published")]
        gone = [*_files_gone(folder, folders), *_records_gone(mine)]
        for path in (*folders, *(folder / kind for kind in DERIVED)):
            shutil.rmtree(path, ignore_errors=True)
        people.forget(pseudonym)
        kept = [record for record in journal.records if record.get("participant") != pseudonym]
        note = {"record": "erased", "utc": now_utc(), "participant": pseudonym}
        journal.replace([*kept, note])
        left = _left(folder, pseudonym)
        proof = _proof(folder, gone, copies, left, signed_by)
    if left:
        raise RigError(f"{folder}: {pseudonym} is still named in {', '.join(left)}; remove it there; proof: {proof[0]}")
    return proof


def _folders(parent: Path, pseudonym: str) -> Iterator[Path]:
    """Yield the folder of a participant, and those of the rigs that ran for it."""
    for path in sorted(parent.glob(f"{pseudonym}*")):
        if path.name == pseudonym or path.name.startswith(f"{pseudonym}-"):
            yield path


def _files_gone(folder: Path, folders: list[Path]) -> Iterator[dict[str, Any]]:
    derived = [folder / kind for kind in DERIVED]
    for parent in (*folders, *derived):
        for path in sorted(parent.rglob("*")):
            if path.is_file():
                kind = "derived" if parent in derived else "recording" if path.suffix == ".mcap" else "file"
                yield {"kind": kind, "bytes": path.stat().st_size, "sha256": digest_of(path)}


def _records_gone(records: list[Record]) -> Iterator[dict[str, Any]]:
    for record in records:
        line = json.dumps(record).encode()
        yield {"kind": f"record {record['record']}", "bytes": len(line), "sha256": hashlib.sha256(line).hexdigest()}


def _left(folder: Path, pseudonym: str) -> list[str]:
    """Return the text files beside plan and journal that still name a participant."""
    found = []
    for path in sorted(folder.rglob("*")):
        is_text = path.suffix in (".json", ".jsonl", ".csv", ".md", ".txt", ".log", ".yaml")
        if not path.is_file() or not is_text or path.name in ("journal.jsonl", "experiment.yaml"):
            continue
        if re.search(rf"\b{re.escape(pseudonym)}\b", path.read_text(encoding="utf-8", errors="replace")):
            found.append(str(path.relative_to(folder)))
    return found


def _proof(
    folder: Path, gone: list[dict[str, Any]], copies: list[str], left: list[str], signed_by: str
) -> tuple[Path, dict[str, Any]]:
    parent = folder / ERASURES
    parent.mkdir(exist_ok=True)
    before = sorted(parent.glob("*.json"))
    counts: dict[str, int] = {}
    for entry in gone:
        counts[entry["kind"]] = counts.get(entry["kind"], 0) + 1
    content: dict[str, Any] = {
        "statement": "Everything below was deleted from this folder; it cannot be made again from what is left.",
        "utc": now_utc(),
        "signed_by": signed_by,
        "counts": dict(sorted(counts.items())),
        # The order of the files would tell of the participant's trials.
        "gone": sorted(gone, key=lambda entry: str(entry["sha256"])),
        "published_before": len(copies),
        "nothing_left": not left,
        "proof_before_sha256": digest_of(before[-1]) if before else "",
    }
    text = json.dumps(content, indent=2) + "\n"
    path = parent / f"{len(before) + 1:04d}.json"
    with whole_file(path) as part:
        part.write_text(text, encoding="utf-8")
    return path, content


def shown(people: Mapping[str, Person]) -> list[dict[str, Any]]:
    """Return a row for each participant."""
    return [{"participant": name, **person.model_dump()} for name, person in people.items()]
