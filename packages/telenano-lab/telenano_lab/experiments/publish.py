"""Export an experiment for others: plan, tables, checksums and versions, without personal data.

Pseudonyms stay, because tables and recordings need them; only the laboratory's own list tells who they are. Handedness
and consent of individual participants, reasons of exclusions, remarks of the experimenter and answers in free text are
dropped; times of day are replaced by the time since the participant's first trial.
"""

import json
import shutil
from collections import Counter
from collections.abc import Iterable, Mapping
from datetime import datetime
from pathlib import Path
from typing import Any

from telenano.files import atomic_file, whole_folder
from telenano.wire import ConfigError
from telenano_lab.experiments.folder_tables import describe
from telenano_lab.experiments.journal import NAME, Journal, Record, now_utc
from telenano_lab.experiments.people import People, digest_of
from telenano_lab.experiments.plan import Plan
from telenano_lab.experiments.runner import versions
from telenano_lab.experiments.table import Tables, tidy, write_tables

# Longest answer of a choice or a rating; a longer text may be a sentence about a person.
_LONGEST_ANSWER = 40
_WITHHELD = "withheld"
_KEPT = ("trial", "asked", "excluded", "included")
_README = """# {title}

Experiment `{name}`, made with telenano {version}. {trials} attempts at trials of {people} participants.

- `experiment.yaml`: the plan; `telenano experiment run experiment.yaml` runs it again.
- `trials.csv`, `trials.parquet`: a row for each attempt at a trial; `questionnaires.*`, an answer a row, where asked.
- `dictionary.md`, `dictionary.json`: every column with its unit and what it means.
- `participants.json`: how many, how many of each handedness, how many excluded.
- `versions.json`: versions of what computed the results, of each run; the seed is in the plan.
- `checksums.txt`: SHA-256 of the recordings{where}.

Times of day are left out: `started_utc` is the time since the participant's first trial, in hours, minutes and seconds.
"""


def publish(plan: Plan, folder: Path, out: Path, *, with_recordings: bool = False) -> dict[str, Any]:
    """Write a folder, or an archive if the name ends in .zip, for publication.

    Args:
        plan: The experiment.
        folder: Its folder.
        out: The folder or archive to write.
        with_recordings: Whether to copy the recordings too.

    Returns:
        The path, and the numbers of trials, participants and recordings.

    Raises:
        ConfigError: `out` exists, or there are no trials yet.
        RigError: The experiment is running.
    """
    if out.exists():
        raise ConfigError(f"{out}: exists already; give another name")
    with Journal(folder / NAME) as journal:
        records = public(journal.records)
        if not any(record["record"] == "trial" for record in records):
            raise ConfigError(f"{folder}: has no trials to publish")
        target = out.with_suffix("") if out.suffix == ".zip" else out
        files = sorted(path for path in (folder / "recordings").rglob("*.mcap"))
        if out.suffix == ".zip":
            with atomic_file(out) as part:
                inner = part.with_name(f"{part.name}.d")
                try:
                    _fill(plan, folder, inner, journal.records, records, files, with_recordings)
                    shutil.make_archive(str(inner), "zip", inner)
                    Path(f"{inner}.zip").replace(part)
                finally:
                    shutil.rmtree(inner, ignore_errors=True)
        else:
            target.parent.mkdir(parents=True, exist_ok=True)
            with whole_folder(target) as inner:
                _fill(plan, folder, inner, journal.records, records, files, with_recordings)
        journal.write("published", path=str(out), recordings=with_recordings)
    people = {record["participant"] for record in records if record["record"] == "trial"}
    trials = sum(record["record"] == "trial" for record in records)
    return {"out": str(out), "trials": trials, "participants": len(people), "recordings": len(files)}


def public(records: Iterable[Record]) -> list[Record]:
    """Return the records that tables are made from, without personal data."""
    kept = [dict(record) for record in records if record["record"] in _KEPT]
    first: dict[str, str] = {}
    for record in kept:
        record.pop("utc", None)
        if record["record"] == "excluded":
            record["reason"] = "excluded"
        if record["record"] == "asked":
            record["items"] = {name: _answer(value) for name, value in record["items"].items()}
        if record["record"] == "trial":
            begun = first.setdefault(record["participant"], record["started_utc"])
            record["started_utc"] = _since(begun, record["started_utc"])
            record["answers"] = [{**answer, "value": _answer(answer["value"])} for answer in record["answers"]]
            if record["status"] == "aborted" or record["disturbance"].startswith("experimenter"):
                record["disturbance"] = "ended by the experimenter"
    return kept


def _answer(value: Any) -> Any:
    return _WITHHELD if isinstance(value, str) and len(value) > _LONGEST_ANSWER else value


def _since(begun: str, at: str) -> str:
    seconds = (datetime.fromisoformat(at) - datetime.fromisoformat(begun)).total_seconds()
    hours, rest = divmod(seconds, 3600.0)
    return f"{int(hours):02d}:{int(rest // 60.0):02d}:{rest % 60.0:06.3f}"


def _fill(
    plan: Plan,
    folder: Path,
    out: Path,
    records: list[Record],
    kept: list[Record],
    files: list[Path],
    with_recordings: bool,
) -> None:
    """Write the published files into a folder."""
    out.mkdir(parents=True, exist_ok=True)
    for name in ("experiment.yaml", "scenario.yaml"):
        if (folder / name).is_file():
            shutil.copyfile(folder / name, out / name)
    tables = tidy(kept, describe)
    write_tables(tables, out)
    _write(out / "participants.json", _people(People(folder), tables))
    runs = [{"utc": record["utc"][:10], **record["versions"]} for record in records if "versions" in record]
    _write(out / "versions.json", {"published": {"utc": now_utc()[:10], **versions()}, "runs": runs})
    sums = [f"{digest_of(path)}  {path.relative_to(folder)}" for path in files]
    (out / "checksums.txt").write_text("\n".join([*sums, ""]), encoding="utf-8")
    if with_recordings:
        for path in files:
            (out / path.relative_to(folder)).parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(path, out / path.relative_to(folder))
    title = plan.experiment.title or plan.experiment.name
    facts = {"title": title, "name": plan.experiment.name, "version": versions()["telenano"]}
    where = ", which are in `recordings`" if with_recordings else ", which are not part of this"
    counts = {"trials": len(tables.trials), "people": len({row["participant"] for row in tables.trials})}
    (out / "README.md").write_text(_README.format(**facts, **counts, where=where), encoding="utf-8")


def _people(people: People, tables: Tables) -> Mapping[str, Any]:
    """Return counts only: the handedness or exclusion of a single participant might identify them."""
    present = {row["participant"] for row in tables.trials}
    mine = [person for name, person in people.known.items() if name in present]
    return {
        "participants": len(present),
        "simulated": sum(person.simulated for person in mine),
        "handedness": dict(Counter(person.handedness for person in mine)) if len(mine) > 1 else {},
        "excluded": sum(bool(person.excluded) for person in mine),
    }


def _write(path: Path, document: Mapping[str, Any]) -> None:
    path.write_text(json.dumps(document, indent=2) + "\n", encoding="utf-8")
