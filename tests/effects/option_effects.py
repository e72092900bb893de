"""The options of commands, other values of them, and what a person sees of a command: exit code, output and files.

A command is run twice as it is; what differs between the two runs, such as a time of the day, is not compared.
"""

import json
import re
import shutil
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import command_lines
from compared_sessions import facts_of
from typer.testing import CliRunner

from telenano.cli.root import app
from telenano.settings import DEMO_RECORDING

# A command and a folder to work in stand for `{demo}` and `{out}`.
SHORT = "--duration 0.6 --set realtime.rate_hz=250"
COMMANDS: Mapping[str, str] = {
    "simulate": f"simulate fig12 {SHORT} --out {{out}}",
    "report": "report {demo} --out {out}",
    "bag info": "bag info {demo}",
    "bag cat": "bag cat {demo} --topics link/status",
    "bag filter": "bag filter {demo} --out {out}/made.mcap",
    "bag split": "bag split {demo} --out {out} --interval 1",
    "bag verify": "bag verify {demo}",
    "bag recover": "bag recover {demo} --out {out}/made.mcap",
    "bag export": "bag export {demo} --out {out}/made.mcap --to mcap-json",
    "bag rerun": "bag rerun {demo} --node controller@master",
    "bag diff": "bag diff {demo} {demo}",
    "link report": "link report {demo}",
    "link picture": "link picture lte --out {out}",
    "scenario show": "scenario show fig12",
    "scenario check": "scenario check fig12",
    "scenario new": "scenario new mine --out {out}/mine.yaml",
    "scenario schema": "scenario schema",
    "param list": "param list",
    "param get": "param get haptic_node.operator.kind",
    "topic info": "topic info afm/state",
    "law list": "law list",
    "law show": "law show wave",
    "new": "new law my_law --out {out}/made",
    "curve": "curve --out {out} --points 40",
    "bag merge": "bag merge {parts} --out {out}/made.mcap",
    "link fit": "link fit {log} --out {out} --anyway",
    "scan": "scan --pixels 4 --lines 4 --size 40 --out {out}",
    "compare": "compare {sessions} --out {out}",
    "study stability": "study stability --environment spring --law virtual_impedance --delay 0,20 --stiffness 20"
    " --duration 1 --workers 1 --out {out}",
    "study transparency": "study transparency --law wave --delay 10 --stiffness 20 --frequency 1,10 --out {out}",
    "study gallery": "study gallery --out {out}",
    "study promises": "study promises --law wave --seeds 1 --burst 5 --workers 1 --out {out}",
    "study push": "study push --quick --law wave --delay 10 --seeds 1 --workers 1 --out {out}",
    "study advise": "study advise --delay 20 --seeds 1 --workers 1 --out {out}",
}
# Values of options that take what no type says, by command and option, or by option alone.
VALUES: Mapping[str, Sequence[str]] = {
    "--instrument": ["real"],
    "--round-trip-ms": ["30"],
    "--duration": ["1.5", "0.7"],
    "--set": [
        "controller.law=wave",
        "afm_node.tip_sample.tip_radius_m=2e-8",
        "rate_hz=500",
        "controller.force_scale=2e8",
    ],
    "--seed": ["5"],
    "--at": ["'0.1 mark * text=here'", "'0.1 estop *'"],
    "--sweep": ["controller.law=wave,passivity"],
    "--seeds": ["2"],
    "--topics": ["afm/state"],
    "--exclude": ["afm/state", "link/*"],
    "--nodes": ["afm_node@slave"],
    "--start": ["1.0"],
    "--end": ["1.0"],
    "--count": ["3"],
    "--interval": ["0.7"],
    "--size": ["200000"],
    "--to": ["csv", "mcap-protobuf", "parquet"],
    "--node": ["afm_node@slave", "python", "c"],
    "--topic": ["afm/state"],
    "--from": ["touch"],
    "--scenario": ["touch"],
    "--points": ["60"],
    "--format": ["svg", "pdf"],
    "--style": ["paper"],
    "--table": ["parquet"],
    "curve --model": ["dynamic"],
    "curve --afm": ["cantilever.stiffness_n_per_m=10"],
    "param get --set": ["haptic_node.operator.kind=interactive"],
}
# Options without an effect in these circumstances, each with the reason.
WITHOUT: Mapping[str, str] = {
    "--out": "is where the files are",
    "--overwrite": "acts in a folder that has a session; tests/unit/cli/test_simulate_command.py",
    "--allow-code": "acts on a scenario that names code; tests/unit/cli",
    "bag info --full": "the recording is complete, so that its index says the same",
    "bag diff --topics": "the two recordings are the same",
    "bag diff --exclude": "the two recordings are the same",
    "bag diff --tolerance": "the two recordings are the same",
    "bag diff --ignore": "the two recordings are the same",
    "bag rerun --tolerance": "the re-run gives the same bits; tests/replay/test_rerun.py",
}


@dataclass
class Seen:
    """What a command leaves: exit code, lines of its output, and its files."""

    code: int
    lines: list[str] = field(default_factory=list)
    files: dict[str, Any] = field(default_factory=dict)

    def items(self) -> Iterator[tuple[str, Any]]:
        """Yield what is compared, by its name."""
        yield "exit code", self.code
        yield "number of lines", len(self.lines)
        yield from ((f"line {number}", line) for number, line in enumerate(self.lines))
        yield "files", sorted(self.files)
        yield from ((f"content of {name}", content) for name, content in self.files.items())


def run(words: Sequence[str], folder: Path) -> Seen:
    """Run a command in an empty folder."""
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir()
    result = CliRunner().invoke(app, list(words))
    text = re.sub(r"[0-9.]+ (s|ms|kB|MB)\b", "", result.output)
    paths = [path for path in sorted(folder.rglob("*")) if path.is_file() and ".tmp" not in path.name]
    return Seen(
        result.exit_code, text.splitlines(), {str(path.relative_to(folder)): content_of(path) for path in paths}
    )


def content_of(path: Path) -> Any:
    """Return what is compared of a file."""
    if path.suffix == ".mcap":
        try:
            return facts_of(path)
        except Exception:  # noqa: BLE001  A file that is not complete is compared by its bytes.
            return path.read_bytes()
    if path.suffix == ".json":
        return flat(json.loads(path.read_text("utf-8")))
    return path.read_bytes()


def flat(value: Any, stem: str = "") -> dict[str, Any]:
    """Return the leaves of a document without what only repeats how it was made."""
    if isinstance(value, Mapping):
        parts = [flat(inner, f"{stem}.{key}") for key, inner in value.items() if key not in ("provenance", "settings")]
        return {name: leaf for part in parts for name, leaf in part.items()}
    return {stem: value}


def commands() -> Iterator[tuple[str, Any]]:
    """Yield the name of each command and the command."""
    return ((" ".join(words), command) for words, command in command_lines.commands())


def values_of(command: str, option: Any) -> list[list[str]]:
    """Return the words of an option with other values."""
    flag = option.opts[0]
    if option.is_flag:
        return [[flag]]
    known = VALUES.get(f"{command} {flag}", VALUES.get(flag))
    choices = list(getattr(getattr(option, "type", None), "choices", ()))
    return [[flag, str(value).strip("'")] for value in (choices or known or ["2", "0.5", "1"])]


def effect_of(command: str, option: Any, folder: Path) -> str:
    """Return what an option of a command changes, empty if that is nothing."""
    out = folder / "out"
    words = [word.format(demo=DEMO_RECORDING, out=out) for word in COMMANDS[command].split()]
    first, second = dict(run(words, out).items()), dict(run(words, out).items())
    stable = {name for name in first if first[name] == second.get(name)}
    assert first["exit code"] == 0, f"{command}: {first}"
    refused = ""
    for more in values_of(command, option):
        given = [*words, *more]
        if more[0] in words and more[0] not in ("--set",):
            place = words.index(more[0])
            given = [*words[:place], *more, *words[place + 2 :]]
        found = run(given, out)
        if found.code == 2:
            refused = f"refused: {' '.join(found.lines)[-200:]}"
            continue
        now = dict(found.items())
        changed = [name for name in stable if now.get(name) != first[name]]
        if changed:
            return sorted(changed)[0]
    return refused
