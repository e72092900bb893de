"""`--sweep` of `up` and `simulate`: run sessions with other values, each in its own folder, and some at a time."""

import contextlib
import hashlib
import itertools
import json
import sys
import threading
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

from pydantic import BaseModel

from telenano.cli.child_session import run_session
from telenano.cli.lazy_commands import ALIASES
from telenano.cli.model_options import validated
from telenano.cli.option_rules import Keys, Void
from telenano.cli.output import say
from telenano.cli.progress_bar import progress
from telenano.launcher.plan import Plan
from telenano.settings.scenario import SEEDS
from telenano.signals import children, interrupts
from telenano.wire.errors import ConfigError, RigError, probably_meant

R = TypeVar("R", bound=BaseModel)

# The key of a sweep for the delay of the link, which has no single key in a scenario.
_DELAY = "round_trip_ms"
# The delay has an option of its own.
_DELAY_OPTION = "--round-trip-ms"
# The key of a sweep for the seed of the session, which is the seed of everything random in it.
SEED = "seed"
_SEED_OPTION = "--seed"
_MOST_SESSIONS = 100
# What the options of a session state, alone or in a sweep, and which of them are for a sweep alone.
SESSION_RULES = (
    Keys("--duration", "duration_s"),
    Keys("--instrument", "instrument"),
    Keys("--round-trip-ms", f"{_DELAY}, delay_node.forward.delay_s, delay_node.backward.delay_s"),
    Keys("--seeds", ", ".join((SEED, *SEEDS))),
    Keys("--sweep"),
    Void("--table", "whose sessions it compares", unless="--sweep, --seeds"),
    Void("--overwrite", "the folder that it is about; without --out a session has a new one", unless="--out"),
)
# Options of the sweep itself, each with a value, which are not passed on to the sessions.
_OWN = ("--sweep", "--seeds", "--table", "--out", "--jobs")
# The file of a sweep's folder that has a line for each session that began or is done.
KEPT_NAME = "sessions.jsonl"


class Point(NamedTuple):
    """One session of a sweep: its name, which its folder has as well, and its options."""

    name: str
    options: tuple[str, ...]

    def asked_of(self, request: R, folder: Path) -> R:
        """Return the request with these options added and a folder of its own in `folder`."""
        pairs = list(zip(self.options[::2], self.options[1::2], strict=True))
        delays = [_number(option, value) for option, value in pairs if option == _DELAY_OPTION]
        fields: dict[str, Any] = {_DELAY: delays[-1]} if delays else {}
        seeds = [_whole(option, value) for option, value in pairs if option == _SEED_OPTION]
        fields |= {SEED: seeds[-1]} if seeds else {}
        asked = dict(request)
        settings = (*asked["settings"], *(value for option, value in pairs if option == "--set"))
        return validated(type(request), {**asked, **fields, "settings": settings, "out": folder / self.name})


def points_of(sweeps: Sequence[str], seed_option: str = "") -> list[Point]:
    """Return a point for each combination of the values of `KEY=V1,V2,…`; ConfigError says which text is wrong.

    Args:
        sweeps: The texts, each a key with its values.
        seed_option: The option by which the command seeds a session; if empty, the keys of all seeds are set.
    """
    axes = [[(key, value) for value in values] for key, values in map(_axis, sweeps)]
    points = [Point(", ".join(f"{key.rpartition('.')[2]}={value}" for key, value in chosen).replace("/", "-"),
                    tuple(word for key, value in chosen for word in _option(key, value, seed_option)))
              for chosen in itertools.product(*axes)]  # fmt: skip
    if len(points) > _MOST_SESSIONS:
        raise ConfigError(f"--sweep: {len(points)} sessions are more than {_MOST_SESSIONS}")
    if len({point.name for point in points}) < len(points):
        raise ConfigError("--sweep: two sessions would have the same values, or keys with the same last part")
    return points


def without_sweep(words: Sequence[str], command: str = "up") -> list[str]:
    """Return the arguments of a command line that belong to each session of its sweep."""
    kept, skip = [], False
    # The sessions of --no-report have no figure; that which compares them has.
    own = (*_OWN, "--format", "--style") if "--no-report" in words else _OWN
    names = {command, *(alias for alias, meant in ALIASES.items() if meant == command)}
    begin = next(place for place, word in enumerate(words) if word in names)
    for word in words[begin + 1 :]:
        name, sign, _ = word.partition("=")
        if not skip and word != "--json" and name not in own:
            kept.append(word)
        skip = not skip and name in own and not sign
    return kept


def _axis(text: str) -> tuple[str, list[str]]:
    key, sign, values = text.partition("=")
    texts = [value.strip() for value in values.split(",")]
    if not sign or not key or not all(texts):
        raise ConfigError(f"--sweep {text}: is not of the form KEY=V1,V2, such as controller.law=wave,smith")
    if key not in (own := (_DELAY, SEED)) and (near := probably_meant(key, own)):
        raise ConfigError(f"--sweep {text}: no key of a scenario{near}")
    return key.strip(), texts


def _option(key: str, value: str, seed_option: str) -> tuple[str, ...]:
    if key == SEED and seed_option:
        return seed_option, value
    if key == SEED:
        return tuple(word for seed in SEEDS for word in ("--set", f"{seed}={value}"))
    return (_DELAY_OPTION, value) if key == _DELAY else ("--set", f"{key}={value}")


def _number(option: str, value: str) -> float:
    try:
        return float(value)
    except ValueError:
        raise ConfigError(f"{option} = {value}: is not a number of milliseconds") from None


def _whole(option: str, value: str) -> int:
    try:
        return int(value)
    except ValueError:
        raise ConfigError(f"{option} = {value}: is not a whole number") from None


class Kept:
    """The sessions of a sweep that were begun and that are done, in a file of its folder: a second start goes on."""

    def __init__(self, folder: Path) -> None:
        """Read the file if it exists; a line that an interruption has cut short counts as none."""
        self._folder, self._path = folder, folder / KEPT_NAME
        self._noted: dict[str, dict[str, Any]] = {}
        for line in self._path.read_text("utf-8").splitlines() if self._path.exists() else ():
            with contextlib.suppress(ValueError, KeyError, TypeError):
                row = json.loads(line)
                self._noted[row["session"]] = {"settings": row["settings"], "done": row["done"]}

    def is_done(self, name: str, settings: str) -> bool:
        """Return whether a session is done with these settings and its recording is still there."""
        noted = self._noted.get(name) == {"settings": settings, "done": True}
        return noted and any((self._folder / name).glob("*.mcap"))

    def is_partial(self, name: str) -> bool:
        """Return whether a session was begun and not done, so that its folder has nothing that is worth keeping."""
        return name in self._noted and not self._noted[name]["done"]

    def note(self, name: str, settings: str, *, done: bool) -> None:
        """Note that a session begins or is done; RigError if the file cannot be written."""
        self._noted[name] = {"settings": settings, "done": done}
        try:
            self._folder.mkdir(parents=True, exist_ok=True)
            with self._path.open("a", encoding="utf-8") as file:
                file.write(json.dumps({"session": name, **self._noted[name]}) + "\n")
        except OSError as error:
            raise RigError(f"{self._path}: cannot be written: {error.strerror}") from error


def settings_of(request: BaseModel, document: Mapping[str, Any]) -> str:
    """Return a digest of everything that decides a session: the effective scenario, and what else was asked for."""
    own = {"out", "overwrite", "scenario", "settings", "page", "wait_s"}
    places = {"recorder": {**document.get("recorder", {}), "directory": ""}}
    facts = [request.model_dump(mode="json", exclude=own), {**document, **places}]
    return hashlib.sha256(json.dumps(facts, sort_keys=True, default=str).encode()).hexdigest()


def plan_sweep(
    points: Sequence[Point], request: R, out: Path, plan: Callable[[R], Plan]
) -> tuple[Kept, dict[str, str]]:
    """Make the plan of every session before the first one runs, so that a wrong key or value is found at once.

    Returns:
        What is kept of an earlier start in the same folder, and for each session the digest of its settings.

    Raises:
        ConfigError: A key or value is wrong, or the folder has a session of another sweep; the message names it.
    """
    kept, settings = Kept(out), {}
    for point in points:
        asked = point.asked_of(request, out)
        found = plan(validated(type(request), {**dict(asked), "overwrite": True}))
        settings[point.name] = settings_of(asked, found.loaded.document)
        if not kept.is_done(point.name, settings[point.name]) and not kept.is_partial(point.name):
            plan(asked)
    return kept, settings


def run_sweep(
    points: Sequence[Point],
    arguments: Sequence[str],
    out: Path,
    kept: Kept,
    settings: Mapping[str, str],
    *,
    jobs: int | None = 1,
    quiet: bool = False,
    name: str = "up",
) -> list[Path]:
    """Run the sessions that are not done yet, each by its own command (`telenano up`); return the folders of all.

    Raises:
        RigError: A session failed; the message names it and quotes its report. No further one is begun then, and what
            is done stays.
    """
    own = [sys.executable, "-m", "telenano", name, *arguments]
    commands: dict[str, list[str]] = {}
    for point in points:
        if not kept.is_done(point.name, settings[point.name]):
            again = ["--overwrite"] if kept.is_partial(point.name) and "--overwrite" not in arguments else []
            commands[point.name] = [*own, *point.options, *again, "--out", str(out / point.name), "--json"]
    if not quiet and len(commands) < len(points):
        say(f"{len(points) - len(commands)} of {len(points)} sessions are done already")

    def note(session: str, done: bool) -> None:
        kept.note(session, settings[session], done=done)

    # An incomplete recording is no failure: its summary says so, and the table shows a hold without data.
    run_children(commands, jobs, note, what="session", quiet=quiet)
    return [out / point.name for point in points]


def run_children(
    commands: Mapping[str, Sequence[str]],
    jobs: int | None,
    note: Callable[[str, bool], None] = lambda name, done: None,
    *,
    what: str,
    quiet: bool,
) -> dict[str, dict[str, Any]]:
    """Run commands that print a summary with `--json`, some at a time, and return the summaries by name.

    Ctrl-C and SIGTERM end the running ones in order. After a failure no further one is begun.

    Args:
        commands: The commands by the name of what each works on.
        jobs: The number of them at a time, None for one a processor.
        note: Called with a name, and False at the begin of its command or True at its end.
        what: A word for what each works on, in the progress and in errors.
        quiet: Whether to show no progress.

    Raises:
        RigError: One or more failed; the message names each and quotes its report.
    """
    done: dict[str, dict[str, Any]] = {}
    failed: list[str] = []
    ending = threading.Event()

    def look(spent_s: float) -> None:
        if ending.is_set():
            raise interrupts.Interrupted

    def run(name: str) -> None:
        if ending.is_set() or failed:
            return
        note(name, False)
        try:
            done[name] = run_session(commands[name], progress=look)
        except RigError as error:
            failed.append(f"the {what} {name} failed: {error}")
            return
        note(name, True)

    with (
        progress(f"{what}s", len(commands), shown=not quiet, counted=True) as show,
        ThreadPoolExecutor(max(1, min(jobs or len(children.permitted()), len(commands)))) as pool,
    ):
        futures: list[Future[None]] = []
        try:
            futures.extend(pool.submit(run, name) for name in commands)
            for future in children.as_ended(futures):
                future.result()
                show(len(done))
        except BaseException:
            ending.set()
            for future in futures:
                future.cancel()
            if not quiet:
                say(f"{len(done)} of {len(commands)} {what}s are done and kept; the same command goes on in its --out")
            raise
    if failed:
        raise RigError("\n".join(failed))
    return done
