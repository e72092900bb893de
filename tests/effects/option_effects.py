"""The options of commands, other values of them, and what a person sees of a command: exit code, output and files.

A command is run twice as it is; what differs between the two runs, such as a time of the day, is not compared. Another
value has to be a valid one: that a command refuses it is an effect only of the options of which refusing is the point.
"""

import functools
import json
import random
import re
import shlex
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

# A recording stands for `{demo}`, a folder to work in for `{out}`; `given` makes what `{folder}`, `{parts}` (in it) and
# `{log}` stand for.
SHORT = "--duration 0.6 --set realtime.rate_hz=250"
COMMANDS: Mapping[str, str] = {
    "simulate": f"simulate fig12 {SHORT} --out {{out}}",
    "report": "report {demo} --out {out}",
    "bag info": "bag info {demo}",
    "bag list": "bag list {folder}",
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
    "bag merge": "bag merge {parts} --out {out}/made.mcap",
    "link fit": "link fit {log} --out {out} --anyway",
    "scan": "scan --pixels 4 --lines 4 --out {out}",
    "bag plot": "bag plot {demo} afm/state.tip_force_n --out {out}/made.png",
    "compare": "compare {demo} {parts} --out {out}",
    "study stability": "study stability --environment spring --law virtual_impedance --delay 0,20 --stiffness 20"
    " --duration 3 --workers 1 --out {out}",
    "study transparency": "study transparency --law wave --delay 10 --stiffness 20 --frequency 1,10 --workers 1"
    " --out {out}",
    "study gallery": "study gallery --out {out}",
    "study promises": "study promises --law wave --seeds 1 --burst 5 --workers 1 --out {out}",
    "study push": "study push --law wave --delay 10 --seeds 1 --workers 1 --out {out}",
    "study advise": "study advise --delay 20 --seeds 1 --workers 1 --out {out}",
}
# Commands that are not tried, each with the reason.
OF_A_RIG: Mapping[str, str] = {
    "bag fetch": "reads from the recorder of another machine; tests/stack/test_fetched_recording.py",
    "study validate": "starts a rig for each cell; tests/stack and the tests of the package of studies",
    "study network": "reads what `link probe` has measured on a rig; the tests of the package of studies",
}
# Valid other values of options, by command and option, or by option alone; of a flag the words beside it that it needs.
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
    "--node": ["afm_node@slave"],
    "bag rerun --node": ["afm_node@slave"],
    "new --language": ["c"],
    "--topic": ["afm/state"],
    "--from": ["touch"],
    "--scenario": ["touch"],
    "--points": ["60"],
    "--format": ["svg", "pdf"],
    "--style": ["paper"],
    "--table": ["parquet", "csv"],
    "--law": ["passivity"],
    "--delay": ["10", "30"],
    "--loss": ["20%"],
    "--jitter": ["5"],
    "--stiffness": ["30"],
    "--frequency": ["2,20"],
    "param get --set": ["haptic_node.operator.kind=interactive"],
    "scan --mode": ["contact"],
    "scan --x": ["10"],
    "scan --y": ["10"],
    "scan --pixels": ["6"],
    "scan --lines": ["3"],
    "scan --dwell": ["8"],
    "scan --amplitude": ["30"],
    "scan --gain": ["200"],
    "scan --proportional": ["0.1"],
    "scan --approach": ["50"],
    "scan --settle": ["100"],
    "scan --sample": ["grating"],
    "scan --size": ["200"],
    "scan --set": ["dot_count=20"],
    "scan --setpoint": ["0.7"],
    "scan --temperature": ["300"],
    "scan --noise-seed": ["3 --temperature 300"],
    "scan --align-rows": ["median"],
    "scan --mask-above": ["1 --align-rows median"],
    "scan --mask-below": ["1 --align-rows median"],
    "scan --afm": ["cantilever.stiffness_n_per_m=10"],
    "link fit --about": ["'a line of a test'"],
    "link fit --cite": ["'nobody'"],
    "study push --seeds": ["2"],
    "study push --law": ["passivity"],
    "study push --delay": ["200"],
    "study promises --burst": ["20"],
    "study advise --network": ["lte"],
    "study advise --instrument": ["ideal"],
    "study advise --sample": ["soft"],
    "study stability --gain": ["12"],
    "study stability --hand": ["stiff"],
    "study transparency --hand": ["stiff"],
    "study stability --environment": ["wall"],
    "study stability --disturb": ["thermal.enabled=true", "drift.enabled=true", "readout.enabled=true"],
    "study stability --set": ["clamp.enabled=true"],
    "study stability --duration": ["4"],
    "study stability --seed": ["5 --jitter 5"],
    "study stability --seeds": ["2 --jitter 5"],
    "study transparency --draws": ["2"],
    "study transparency --set": ["clamp.enabled=true"],
}
# Options that a command refuses in these circumstances, because what is read there does not need them, and the reason.
REFUSES: Mapping[str, str] = {
    "scan --channel": "the sample is no file",
    "study transparency --hand": "an arm would travel further than a hand may at these frequencies",
    "study push --quick": "the words give a number of trials",
    "study stability --mass": "a spring has none",
    "study stability --body-damping": "a spring has none",
    "link fit --unit": "the headings of the log name their units",
    "link fit --direction": "the log is no recording",
    "link fit --period": "the log has times",
    "link fit --taken": "no source is cited",
    "link fit --histogram": "the log is no histogram; packages/telenano-lab has one",
}
# Options without an effect in these circumstances, each with the reason.
WITHOUT: Mapping[str, str] = {
    "--out": "is where the files are",
    "--same-session": "acts on several files; tests/unit/recording/test_session_identity.py",
    "--overwrite": "acts in a folder that has a session; tests/unit/cli/test_simulate_command.py",
    "--workers": "is how many processes compute; the result is the same",
    "--scheduler": "needs a cluster; the tests of the package of studies",
    "compare --published": "is a file of a published curve; packages/telenano-lab",
    "--live": "needs a running rig; tests/stack/test_live_programs.py",
    "--site-file": "is where a running rig is; tests/stack",
    "--rig": "is which running rig is meant; tests/stack",
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
    """What a command leaves: exit code, lines of its output and of its messages, and its files.

    They are told apart, because the messages of a bar of progress are as many as the machine is slow.
    """

    code: int
    lines: list[str] = field(default_factory=list)
    messages: list[str] = field(default_factory=list)
    files: dict[str, Any] = field(default_factory=dict)

    def items(self) -> Iterator[tuple[str, Any]]:
        """Yield what is compared, by its name."""
        yield "exit code", self.code
        yield "number of lines", len(self.lines)
        yield from ((f"line {number}", line) for number, line in enumerate(self.lines))
        yield "number of messages", len(self.messages)
        yield from ((f"message {number}", line) for number, line in enumerate(self.messages))
        yield "files", sorted(self.files)
        yield from ((f"content of {name}", content) for name, content in self.files.items())


def run(words: Sequence[str], folder: Path) -> Seen:
    """Run a command in an empty folder."""
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir()
    result = CliRunner().invoke(app, list(words))
    output, messages = (
        re.sub(r"[0-9.]+ (s|ms|kB|MB)\b", "", text).splitlines() for text in (result.stdout, result.stderr)
    )
    paths = [path for path in sorted(folder.rglob("*")) if path.is_file() and ".tmp" not in path.name]
    files = {str(path.relative_to(folder)): content_of(path) for path in paths}
    return Seen(result.exit_code, output, messages, files)


def content_of(path: Path) -> Any:
    """Return what is compared of a file."""
    if path.suffix == ".mcap":
        try:
            return facts_of(path)
        except Exception:  # noqa: BLE001  A file that is not complete is compared by its bytes.
            return path.read_bytes()
    if path.suffix == ".json":
        return flat(json.loads(path.read_text("utf-8")))
    if path.suffix in (".html", ".svg", ".yaml"):
        return re.sub(r"\d{4}-\d\d-\d\d([T ]\d\d:\d\d(:\d\d(\.\d+)?)?)?", "", path.read_text("utf-8"))
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
    known = VALUES.get(f"{command} {flag}", VALUES.get(flag))
    if option.is_flag:
        return [[flag, *shlex.split(value)] for value in known or [""]]
    choices = list(getattr(getattr(option, "type", None), "choices", ()))
    return [[flag, *shlex.split(str(value))] for value in (known or choices or ["2", "0.5", "1"])]


def given(folder: Path) -> dict[str, str]:
    """Make what commands read besides the recording: its parts, and a log of a line; return the words for them."""
    parts, log = folder / "parts", folder / "log.csv"
    if not log.exists():
        run(["bag", "split", str(DEMO_RECORDING), "--out", str(parts), "--interval", "2"], folder / "nothing")
        draw = random.Random(93)
        rows = [
            f"{10 * tick},{'' if draw.random() < 0.01 else 20.0 + draw.expovariate(0.3):.6}" for tick in range(6000)
        ]
        log.write_text("sent_ms,delay_ms\n" + "\n".join(rows) + "\n", encoding="utf-8")
    return {"folder": str(parts), "parts": " ".join(map(str, sorted(parts.glob("*.mcap")))), "log": str(log)}


def words_of(command: str, folder: Path) -> list[str]:
    """Return the words of a command as it is."""
    return COMMANDS[command].format(demo=DEMO_RECORDING, out=folder / "out", **given(folder)).split()


@functools.lru_cache(maxsize=1)
def as_it_is(command: str, folder: Path) -> tuple[dict[str, Any], frozenset[str]]:
    """Return what a command leaves as it is, and the names of what is the same in a second run."""
    words = words_of(command, folder)
    first, second = (dict(run(words, folder / "out").items()) for _ in range(2))
    # 3: the model of a line is not like its log.
    assert first["exit code"] in (0, 3), f"{command}: {first}"
    return first, frozenset(name for name in first if first[name] == second.get(name))


def effect_of(command: str, option: Any, folder: Path) -> str:
    """Return what a valid other value of an option changes, empty if that is nothing."""
    words = words_of(command, folder)
    first, stable = as_it_is(command, folder)
    for more in values_of(command, option):
        tried = [*words, *more]
        if option.is_flag and more[0] in words:
            tried = [word for word in words if word != more[0]]
        elif more[0] in words and more[0] not in ("--set", "--afm"):
            place = words.index(more[0])
            tried = [*words[:place], *words[place + 2 :], *more]
        found = run(tried, folder / "out")
        if found.code == 2 and f"{command} {more[0]}" not in REFUSES:
            continue
        now = dict(found.items())
        changed = [name for name in stable if now.get(name) != first[name]]
        if changed:
            return sorted(changed)[0]
    return ""
