"""Every option and argument that takes a path, of every command, with what may stand there and with odd names.

A command ends by itself, in one sentence of its own; nothing of a name is obeyed by a terminal or begins a line. What
no path can be is refused by the name of the option, before anything else that the command may find wrong.
"""

import random
import re
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

import pytest
from command_lines import WORDS, commands, needed
from ended_commands import ended
from odd_places import NAMES, PLACES

from telenano.files import regular_files
from telenano.settings import DEMO_RECORDING

SEED = 95
SHARE = 45
# A command that is refused is done in a fraction of this time of the processor [s].
MOST_S = 4.0
# Texts that may be the path of a file or the name of something.
NAMES_OR_FILES = ("--scenario", "--sample", "--map", "--pattern", "--certificate", "--key", "--profile", "--from")
ARGUMENTS = ("scenario", "file")
OBEYED = "[\x00-\x08\x0b-\x1f\x7f-\x9f\u202a-\u202e\ufffd]"
GONE = "a file that is gone before it is opened"
# These can be no path, so that no command may find another fault first.
NO_PATHS = ("empty", "too long", "below a file", "link to itself")
# What a command cannot make a folder or a file of, so that none begins its work.
NO_FOLDERS = ("pipe", "socket", "device", "file too large", "link to what has no end")
NO_FILES = ("pipe", "socket", "folder")
# These make what they are for in a moment, under any name, and print where it is.
QUICK = ("scenario new", "new", "bag filter", "bag recover", "keys new", "keys show")
MAY_WORK = ("--out", "--dir", "folder")
MOST_REFUSED_BEFORE = 0.35


class Case(NamedTuple):
    words: tuple[str, ...]
    command: Any
    parameter: Any
    kind: str

    @property
    def flag(self) -> str:
        return str(self.parameter.opts[0])

    @property
    def name(self) -> str:
        return NAMES.get(self.kind, "odd.mcap" if self.parameter.metavar == "FILE" else "odd.yaml")

    def line(self) -> list[str]:
        """Return the words of the command with the path in its place, and what it needs besides."""
        if self.parameter.param_type_name == "option":
            needs = needed(self.words, self.command, [self.parameter.name])
            return [*self.words, *needs, f"{self.flag}={self.name}"]
        arguments = [each for each in self.command.params if each.param_type_name == "argument"]
        options = [] if " ".join(self.words) in WORDS else needed(self.words, self.command, [a.name for a in arguments])
        place = [each.name for each in arguments].index(self.parameter.name)
        others = [str(DEMO_RECORDING)] * sum(each.required for each in arguments)
        return [*self.words, *options, "--", *others[:place], self.name, *others[place + 1 :]]


def kinds_of(words: tuple[str, ...], parameter: Any) -> tuple[str, ...]:
    """Return what is tried of a path; what a command is to make has to be what cannot be made."""
    if " ".join(words) in QUICK:
        return (*NAMES, *PLACES)
    is_made = parameter.opts[0] == "--out" or (words, parameter.opts[0]) == (("link", "udp"), "--record")
    if is_made or (words[:2] == ("device", "simulate") and parameter.name != "scenario"):
        # What stands at the path of a recording is kept, and that of a port replaced.
        no_files = () if "record" in (*words, parameter.name) or parameter.name == "link" else NO_FILES
        return (*NO_PATHS, *(NO_FOLDERS if parameter.metavar == "DIR" else no_files))
    # A study of processes hands the file on to them.
    return (*NAMES, *PLACES, *([] if words == ("study", "validate") else [GONE]))


def cases() -> Iterator[Case]:
    for words, command in commands():
        for parameter in command.params:
            annotation = parameter.type_descriptor.annotation
            is_file = annotation is str and (parameter.opts[0] in NAMES_OR_FILES or parameter.name in ARGUMENTS)
            if annotation in (Path, list[Path]) or is_file:
                yield from (Case(words, command, parameter, kind) for kind in kinds_of(words, parameter))


CASES = list(cases())


def fault_of(case: Case, folder: Path, monkeypatch: pytest.MonkeyPatch) -> str:
    """Return what is wrong with how a command ends; `before` where it found another fault first."""
    folder.mkdir()
    monkeypatch.chdir(folder)
    (folder / "file").write_text("x")
    path = folder / case.name
    make: Callable[[Path], Any] | None = PLACES.get(case.kind)
    if make is not None:
        make(path)
    with monkeypatch.context() as patch:
        if case.kind == GONE:
            path.write_text("x")
            patch.setattr(regular_files, "_require_regular", lambda found, mode: path.unlink(missing_ok=True))
        end = ended(case.line(), MOST_S)
    if isinstance(end, str):
        return f"goes on: {end[:600]}"
    if end.raised:
        return f"a traceback: {end.raised[-1500:]}"
    # Where a command has made something, its path can be pasted as it is.
    orders = OBEYED if end.code == 0 else f"{OBEYED}|^b` c"
    if re.search(orders, end.output, re.MULTILINE):
        return f"a terminal obeys a name: {end.output!r}"
    if end.code == 0:
        may_work = case.flag in MAY_WORK and case.kind not in NO_PATHS
        return "" if may_work else f"does what it is for: {end.output[-500:]!r}"
    *_, last = end.output.splitlines()
    # A question that nobody answers stands before the sentence.
    if last.count("telenano: ") != 1 or end.code not in (1, 2):
        return f"{end.code}, {end.output[-500:]!r}"
    shown = case.name.encode("unicode_escape").decode().replace("\\udcff", "")[:20]
    is_named = any(word in last for word in (shown, case.flag, case.parameter.metavar or case.flag) if word)
    if is_named:
        return ""
    is_path = case.parameter.type_descriptor.annotation is not str
    return f"does not name the option: {last}" if is_path and case.kind in NO_PATHS else "before"


@pytest.mark.timeout(1200)
@pytest.mark.parametrize(
    "count",
    [
        pytest.param(SHARE, marks=pytest.mark.check("tries a part of the paths, ten seconds")),
        pytest.param(None, marks=pytest.mark.endurance("tries every path of every command, minutes")),
    ],
)
def test_a_path_that_cannot_be_is_a_sentence(
    count: int | None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("TELENANO_RUNTIME_DIR", str(tmp_path / "run"))
    monkeypatch.setenv("HOME", str(tmp_path))
    assert len({case.words for case in CASES}) > 80 and len(CASES) > 2000
    tried = CASES if count is None else random.Random(SEED).sample(CASES, count)
    found = {
        f"{' '.join(case.line())}, {case.kind}": fault_of(case, tmp_path / str(number), monkeypatch)
        for number, case in enumerate(tried)
    }
    wrong = {line: fault for line, fault in found.items() if fault not in ("", "before")}
    assert not wrong, "\n".join(f"{line}: {fault}" for line, fault in wrong.items())
    assert sum(fault == "before" for fault in found.values()) < MOST_REFUSED_BEFORE * len(tried)
