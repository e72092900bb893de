"""`telenano experiment`: trials of people or simulated operators over conditions, from plan to publication."""

import contextlib
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer
import yaml

from telenano.cli import (
    EXIT_FAILED,
    JsonOption,
    Void,
    command_group,
    print_answer,
    print_document,
    print_json,
    print_rows,
    report_errors,
    rules,
)
from telenano.files import atomic_file
from telenano.settings import read_yaml
from telenano.wire import ConfigError, one_line, quoted
from telenano_lab.experiments.analyse_command import analyse
from telenano_lab.experiments.plan_command import plan as plan_for_power
from telenano_lab.experiments.plans import find_experiment

if TYPE_CHECKING:
    from telenano_lab.experiments.apparatus.base import Apparatus
    from telenano_lab.experiments.apparatus.marks import Marks
    from telenano_lab.experiments.desk import Desk
    from telenano_lab.experiments.plan import Plan

app = command_group()
people = command_group()
app.command()(analyse)
app.command("plan")(plan_for_power)
app.add_typer(people, name="people", help="Record facts about participants: consent, handedness, exclusion.")

_FILE = "experiment.yaml"
ApparatusName = Literal["live", "lockstep"]
Handedness = Literal["left", "right", "both", "unknown"]
FileArgument = Annotated[str, typer.Argument(metavar="NAME|FILE", help="The experiment: a known name or a YAML file.")]
FolderArgument = Annotated[Path, typer.Argument(metavar="DIR", help="The folder of the experiment.")]
PseudonymArgument = Annotated[str, typer.Argument(metavar="ID", help="The pseudonym, such as P03; never a name.")]
ParticipantOption = Annotated[
    list[str] | None,
    typer.Option("--participant", metavar="ID", help="Only this participant (repeatable); default: all, in turn."),
]

MarksOption = Annotated[
    Path | None,
    typer.Option("--marks", metavar="PORT", help="Mark both ends of a trial on this serial or parallel port."),
]
BaudOption = Annotated[int, typer.Option("--baud", min=50, metavar="N", help="Rate of a serial port of --marks [1/s].")]
_MARK_RULES = (Void("--baud", "the port whose rate it is", unless="--marks"),)


def _again(folder: Path) -> str:
    """Return the command that continues an experiment."""
    return f"telenano experiment resume {quoted(folder)}"


@app.command()
def new(
    name: Annotated[str, typer.Argument(metavar="NAME", help="Name of the experiment: lower case, digits, _ and -.")],
    out: Annotated[
        Path | None, typer.Option("--out", "-o", metavar="FILE", help="File to write; default: NAME.yaml.")
    ] = None,
    base: Annotated[str, typer.Option("--from", metavar="NAME|FILE", help="Experiment to begin with.")] = "template",
    as_json: JsonOption = False,
) -> None:
    """Write the file of an experiment of your own, with the meaning of each key."""
    with report_errors(as_json):
        path = out or Path(f"{name}.yaml")
        if path.exists():
            raise ConfigError(f"{path}: exists already; give another name or --out")
        source = find_experiment(base)
        first = f"name: {read_yaml(source).get('name', '')}"
        text = source.read_text(encoding="utf-8").replace(f"\n{first}\n", f"\nname: {name}\n", 1)
        with atomic_file(path, replace=False) as part:
            part.write_text(text, encoding="utf-8")
            _load(part)
    print_answer(
        {"file": str(path)},
        f"{path}; next: telenano experiment check {quoted(path)}",
        as_json=as_json,
    )


@app.command()
def check(file: FileArgument, as_json: JsonOption = False) -> None:
    """Check an experiment: number of trials, duration, where each factor varies, and whether the order is balanced."""
    with report_errors(as_json):
        from telenano_lab.experiments.summary import summary_of

        plan = _load_to_run(find_experiment(file))
        summary = summary_of(plan)
        balance = plan.balance()
    if as_json:
        print_json({**summary, "places": balance.places, "followed": balance.followed})
        return
    blocks = summary.pop("blocks")
    doubts = summary.pop("doubts")
    for key, value in summary.items():
        shown = ", ".join(map(str, value)) or "none" if isinstance(value, list) else value
        typer.echo(f"{key.replace('_', ' ')}: {shown}")
    if len(blocks) > 1:
        typer.echo("\nblocks of a session")
        print_rows(blocks)
    typer.echo("\nhow often each condition comes at each place of a sequence, and right after each other one")
    print_rows(_balance_rows(plan))
    for doubt in doubts:
        typer.echo(f"note: {doubt}", err=True)


@app.command()
@rules(*_MARK_RULES)
def run(
    file: FileArgument,
    out: Annotated[
        Path | None, typer.Option("--out", metavar="DIR", help="Folder of the experiment; default: experiments/NAME.")
    ] = None,
    participant: ParticipantOption = None,
    apparatus: Annotated[
        ApparatusName | None, typer.Option("--apparatus", help="Apparatus to run on, instead of that of the file.")
    ] = None,
    marks: MarksOption = None,
    baud: BaudOption = 115200,
    as_json: JsonOption = False,
) -> None:
    """Run an experiment: all simulated participants, or a session of a person at the page of the rig."""
    with report_errors(as_json, _INTERRUPTED):
        source = find_experiment(file)
        plan = _load_to_run(source)
        folder = out or Path("experiments") / plan.experiment.name
        if (folder / "journal.jsonl").exists():
            raise ConfigError(f"{folder}: has an experiment already; `{_again(folder)}` continues")
        with _marks(marks, baud, apparatus or plan.experiment.apparatus, plan) as port:
            _copy(plan, source, folder, apparatus)
            _run(folder, participant, port, as_json=as_json)


@app.command()
@rules(*_MARK_RULES)
def resume(
    folder: FolderArgument,
    participant: ParticipantOption = None,
    marks: MarksOption = None,
    baud: BaudOption = 115200,
    as_json: JsonOption = False,
) -> None:
    """Continue with an experiment after a break or a crash: no trial is lost, and none is done twice."""
    with report_errors(as_json, _INTERRUPTED):
        from telenano_lab.experiments.runner import folder_plan

        plan = _load_to_run(folder_plan(folder))
        with _marks(marks, baud, plan.experiment.apparatus, plan) as port:
            _run(folder, participant, port, as_json=as_json)


@app.command()
def status(folder: FolderArgument, as_json: JsonOption = False) -> None:
    """Show the progress of an experiment: trials done, left and disturbed of each participant."""
    with report_errors(as_json):
        from telenano_lab.experiments import journal
        from telenano_lab.experiments.runner import folder_plan
        from telenano_lab.experiments.summary import state_of

        path = folder / journal.NAME
        plan = _load(folder_plan(folder))
        state = state_of(plan, journal.read(path) if path.exists() else [])
    if as_json:
        print_json(state)
        return
    rows = state.pop("participants")
    for key, value in state.items():
        typer.echo(f"{key.replace('_', ' ')}: {value}")
    print_rows(rows)


@app.command()
def publish(
    folder: FolderArgument,
    out: Annotated[Path, typer.Option("--out", metavar="DIR|FILE.zip", help="Folder or archive to make.")],
    recordings: Annotated[
        bool, typer.Option("--recordings", help="Copy the recordings too, and not only their checksums.")
    ] = False,
    as_json: JsonOption = False,
) -> None:
    """Make a folder or archive for others: plan, tables, dictionary, checksums and versions, nothing personal."""
    with report_errors(as_json):
        from telenano_lab.experiments.publish import publish as made
        from telenano_lab.experiments.runner import folder_plan

        publication = made(_load(folder_plan(folder)), folder, out, with_recordings=recordings)
    print_document(publication, str(out), as_json=as_json)


@app.command()
def erase(
    folder: FolderArgument,
    pseudonym: PseudonymArgument,
    yes: Annotated[bool, typer.Option("--yes", help="Do not ask for confirmation.")] = False,
    as_json: JsonOption = False,
) -> None:
    """Erase all data of a participant; it cannot be undone."""
    with report_errors(as_json):
        from telenano_lab.experiments.people import erase as erased

        if not yes and not typer.confirm(one_line(f"Erase everything of {pseudonym} in {folder}?")):
            raise ConfigError("nothing was erased")
        gone = erased(folder, pseudonym)
    text = f"erased: {gone.files} files and {gone.records} records"
    if gone.published_before:
        text += f"; copies that were published before: {gone.published_before}: recall them"
    print_answer(gone._asdict(), text, as_json=as_json)


@people.command("add")
def add(
    folder: FolderArgument,
    pseudonym: PseudonymArgument,
    handedness: Annotated[Handedness, typer.Option("--handedness", help="The hand used.")] = "unknown",
    consent: Annotated[bool, typer.Option("--consent", help="The participant has consented in writing.")] = False,
    as_json: JsonOption = False,
) -> None:
    """Add a participant, or note handedness and consent of one."""
    with report_errors(as_json):
        from telenano_lab.experiments.people import People

        fields: dict[str, Any] = {"handedness": handedness} if handedness != "unknown" else {}
        person = People(folder).change(pseudonym, **fields, **({"consent": True} if consent else {}))
    print_document({"participant": pseudonym, **person.model_dump()}, str(folder), as_json=as_json)


@people.command("exclude")
def exclude(
    folder: FolderArgument,
    pseudonym: PseudonymArgument,
    reason: Annotated[str, typer.Option("--reason", metavar="TEXT", help="Reason; empty takes the participant back.")],
    as_json: JsonOption = False,
) -> None:
    """Exclude a participant's data with a reason, or take them back with an empty one; nothing is deleted."""
    with report_errors(as_json):
        from telenano_lab.experiments.journal import NAME, Journal
        from telenano_lab.experiments.people import People

        with Journal(folder / NAME) as journal:
            person = People(folder).change(pseudonym, excluded=reason)
            journal.write("excluded" if reason else "included", participant=pseudonym, reason=reason)
    print_document({"participant": pseudonym, **person.model_dump()}, str(folder), as_json=as_json)


@people.command("list")
def list_people(folder: FolderArgument, as_json: JsonOption = False) -> None:
    """List the participants."""
    with report_errors(as_json):
        from telenano_lab.experiments.people import People, shown

        if not folder.exists():
            raise ConfigError(f"{folder}: there is no such folder of an experiment")
        rows = shown(People(folder).known)
    nobody = "nobody is known yet: `telenano experiment people add` adds a participant"
    print_answer({"participants": rows}, rows or nobody, as_json=as_json)


def _balance_rows(plan: "Plan") -> list[dict[str, Any]]:
    """Return a row per condition with its counts, or with their range if there are many conditions."""
    balance, rows = plan.balance(), []
    for number, row in enumerate(plan.within_block):
        name = ", ".join(f"{key} = {level}" for key, level in row.items()) or "all"
        after = [counts[number] for other, counts in enumerate(balance.followed) if other != number]
        places = balance.places[number]
        if len(plan.within_block) > _MOST_COLUMNS:
            counts = {"at a place": _range(places), "after another": _range(after)}
        else:
            at = {f"at {place + 1}": str(count) for place, count in enumerate(places)}
            counts = at | {
                f"after {other}": str(counts_after[number]) for other, counts_after in enumerate(balance.followed)
            }
        rows.append({"condition": f"{number}: {name}", **counts})
    return rows


def _range(counts: Sequence[int]) -> str:
    least, most = min(counts, default=0), max(counts, default=0)
    return str(least) if least == most else f"{least} to {most}"


_MOST_COLUMNS = 6
_INTERRUPTED = "interrupted; `telenano experiment resume` continues with the trial that was interrupted"


def _load(path: Path) -> "Plan":
    from telenano_lab.experiments.plan import load_plan

    return load_plan(path)


def _load_to_run(path: Path) -> "Plan":
    """Return a plan whose trials can be run here: the files that they read are there."""
    from telenano_lab.experiments.plan import check_files_of

    plan = _load(path)
    check_files_of(plan)
    return plan


def _copy(plan: "Plan", source: Path, folder: Path, apparatus: ApparatusName | None) -> None:
    """Copy an experiment's file, and a scenario of its own, to its folder; later changes do not affect the run."""
    document = read_yaml(source)
    changed: dict[str, Any] = {} if apparatus is None else {"apparatus": apparatus}
    folder.mkdir(parents=True, exist_ok=True)
    if plan.scenario_file == source.parent / plan.experiment.scenario or plan.experiment.scenario.endswith(
        (".yaml", ".yml")
    ):
        changed["scenario"] = "scenario.yaml"
        with atomic_file(folder / "scenario.yaml") as part:
            part.write_text(yaml.safe_dump(plan.scenario, sort_keys=False), encoding="utf-8")
    text = yaml.safe_dump({**document, **changed}, sort_keys=False) if changed else source.read_text(encoding="utf-8")
    with atomic_file(folder / _FILE) as part:
        part.write_text(text, encoding="utf-8")


@contextlib.contextmanager
def _marks(port: Path | None, baud: int, apparatus: ApparatusName, plan: "Plan") -> Iterator["Marks | None"]:
    """Open the port of the marks before the rig starts, and close it after the block."""
    if port is None:
        yield None
        return
    from telenano_lab.experiments.apparatus.marks import PRACTICE, Marks

    if apparatus != "live":
        raise ConfigError(f"--marks {port}: simulated time has nothing to mark; take apparatus live")
    if (count := len(plan.block_conditions) * len(plan.within_block)) >= PRACTICE:
        raise ConfigError(f"--marks {port}: {count} conditions are more than the {PRACTICE - 1} numbers of a byte")
    with contextlib.closing(Marks(port, baud)) as marks:
        yield marks


def _run(folder: Path, participants: list[str] | None, marks: "Marks | None", *, as_json: bool) -> None:
    """Run the remaining trials of the experiment in a folder, and print its progress."""
    from telenano_lab.experiments.journal import NAME, Journal
    from telenano_lab.experiments.people import People
    from telenano_lab.experiments.runner import Runner, remaining
    from telenano_lab.experiments.summary import state_of

    def show(text: str) -> None:
        typer.echo(text, err=as_json)

    plan = _load(folder / _FILE)
    with Journal(folder / NAME) as journal:
        if journal.torn:
            show(f"note: {journal.path}: the last record was not whole and is dropped: {journal.torn}")
        wanted = _participants(plan, participants, list(remaining(plan, journal.records)))
        with _apparatus(plan, folder, show, marks) as (apparatus, desk):
            runner = Runner(plan, journal, People(folder), apparatus, desk, show)
            runner.begin()
            stopped = runner.run(wanted)
        state = state_of(plan, journal.records)
    text = f"{state['trials_done']} trials done, {state['trials_left']} left: {folder}"
    print_answer(state, text, as_json=as_json)
    if stopped.reason:
        typer.echo(
            f"telenano: stopped: {stopped.reason}; `{_again(folder)}` continues",
            err=True,
        )
        raise typer.Exit(EXIT_FAILED)


def _participants(plan: "Plan", names: list[str] | None, left: list[str]) -> list[str]:
    """Return the participants of a run: those given, else all with trials left; of persons only the first."""
    for name in names or ():
        if name not in plan.experiment.pseudonyms:
            pseudonyms = ", ".join(plan.experiment.pseudonyms)
            raise ConfigError(f"--participant {name}: is not a participant of {plan.path}; there are {pseudonyms}")
    return names or (left[:1] if plan.experiment.operator.kind == "person" else left)


@contextlib.contextmanager
def _apparatus(plan: "Plan", folder: Path, show: Any, marks: "Marks | None") -> Iterator[tuple["Apparatus", "Desk"]]:
    """Yield the apparatus of the trials and the desk for communication; a rig ends with the block."""
    from telenano_lab.experiments.apparatus.lockstep import Lockstep
    from telenano_lab.experiments.desk import BusDesk, Desk, PersonDesk

    is_person = plan.experiment.operator.kind == "person"
    if plan.experiment.apparatus == "lockstep":
        if is_person:
            raise ConfigError(f"{plan.path}: apparatus: a person cannot take part in simulated time; take live")
        desk = Desk(plan)
        yield Lockstep(plan, desk), desk
        return
    from telenano_lab.experiments.apparatus.live import Live

    desk = PersonDesk(plan) if is_person else BusDesk(plan)
    with contextlib.closing(Live(plan, folder, desk, show, marks)) as apparatus:
        yield apparatus, desk
