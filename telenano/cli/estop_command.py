"""`telenano estop` and `telenano session estop`, without typer, and without models unless the request needs them."""

import contextlib
import json
import os
import sys
import threading
from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any, Literal, NamedTuple

from telenano.cli.exit_codes import EXIT_BAD_CONFIGURATION, EXIT_FAILED
from telenano.console.answers import Answer, all_acknowledged, unacknowledged
from telenano.console.emergency_stop import FarListener, LocalRig, Reach, emergency_stop
from telenano.runtime.bus.absence import absence_text
from telenano.runtime.bus.holders import Holder, Look, look
from telenano.runtime.bus.local_endpoint import (
    FIRST_RIG,
    RIG_VARIABLE,
    RUNTIME_DIRECTORY_VARIABLE,
    base_and_rig,
    base_directory,
    folder_identity,
    is_rig_name,
    path_of,
    rigs_with_folders,
)
from telenano.settings.included import DEFAULT_SITE_FILE, TWO_SITES_FILE, site_file_named
from telenano.wire.errors import ConfigError, RigError, TelenanoError
from telenano.wire.nodes import DEVICES, RECORDER
from telenano.wire.printable import one_line


def _print_json(document: Mapping[str, Any]) -> None:
    _print(json.dumps(document))


class EstopRequest(NamedTuple):
    """The options of the command; site '' stands for a rig of one machine, rig '' for every rig of this user.

    `answer` prints the document of the answers.
    """

    target: str = "*"
    site: str = ""
    site_file: Path | None = None
    as_json: bool = False
    rig: str = ""
    answer: Callable[[Mapping[str, Any]], None] = _print_json


def read_arguments(arguments: Sequence[str]) -> EstopRequest | None:
    """Return the request in a command line; None for another command, or for words that typer should read or refuse.

    An option that stands twice is no reason not to stop: with two values, all that they could mean is stopped.
    """
    words = list(arguments)
    if words[:1] == ["session"]:
        words = words[1:]
    if words[:1] != ["estop"]:
        return None
    words = [part for word in words[1:] for part in (word.split("=", 1) if word.startswith("--") else [word])]
    widest = request = EstopRequest()
    given: dict[str, str] = {}
    while words:
        option, value = words.pop(0), words[0] if words else ""
        if option == "--json":
            request = request._replace(as_json=True)
            continue
        is_other = given.setdefault(option, value) != value
        if option == "--target" and value:
            request = request._replace(target=widest.target if is_other else value)
        elif option == "--site" and value in ("master", "slave"):
            request = request._replace(site=widest.site if is_other else value)
        elif option == "--rig" and is_rig_name(value):
            request = request._replace(rig=widest.rig if is_other else value)
        elif option == "--site-file" and value and not is_other:
            request = request._replace(site_file=site_file_named(Path(value)))
        else:
            return None
        words.pop(0)
    return request


def run_estop(request: EstopRequest) -> int:
    """Stop the devices of the request, print what became of the stop at each, and return the exit code."""
    try:
        answers = _stop(request)
    except TelenanoError as error:
        _fail(request, str(error), {})
        return EXIT_BAD_CONFIGURATION if isinstance(error, ConfigError) else EXIT_FAILED
    except KeyboardInterrupt:
        sys.stderr.write("telenano: interrupted\n")
        return EXIT_FAILED
    if all_acknowledged(answers):
        if request.as_json:
            request.answer(_document(request, answers))
        return 0
    _fail(request, unacknowledged(answers) if answers else "no device was asked: the target means none", answers)
    return EXIT_FAILED


def _document(request: EstopRequest, answers: Mapping[str, Answer]) -> dict[str, Any]:
    rows = {node: answer.row() for node, answer in sorted(answers.items())}
    return {"command": "estop", "target": request.target, "answers": rows}


def _fail(request: EstopRequest, text: str, answers: Mapping[str, Answer]) -> None:
    """Print why a stop has not succeeded: a line for each device that has not answered, and in JSON all rows."""
    silent = [answer for _, answer in sorted(answers.items()) if answer.kind not in ("ack", "refused")]
    lines = [f"{answer.node} {answer.sentence}" for answer in silent] if silent else [text] if text else []
    with contextlib.suppress(OSError):
        for line in lines:
            sys.stderr.write(f"telenano: {one_line(line)}\n")
    if request.as_json:
        refused = "; ".join(f"{a.node} refused: {a.text}" for a in answers.values() if a.kind == "refused")
        request.answer({**(_document(request, answers) if answers else {}), "error": text or refused})


def _print(line: str) -> None:
    """Print a line; if that is not possible, the stop continues and keeps its exit code."""
    try:
        sys.stdout.write(one_line(line) + "\n")
        sys.stdout.flush()
    except OSError as error:
        with contextlib.suppress(OSError):
            sys.stderr.write(f"telenano: standard output cannot be written: {error.strerror}\n")
        # Otherwise Python would fail to write the rest of the buffer when it ends.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def _stop(request: EstopRequest) -> dict[str, Answer]:
    """Stop the rig that is named, or else every rig of this user, because a person in a hurry names none."""
    seen = look()
    if request.rig or os.environ.get(RIG_VARIABLE):
        name = request.rig or os.environ[RIG_VARIABLE]
        return _stop_rig(request, name, seen, lambda answer: _show(request, answer))
    first = _reached(request, FIRST_RIG, seen)[0].endpoints
    here, elsewhere = _rigs_of(seen)
    # A site file may have folders of its own, which are then the same for all names.
    named = [name for name in here if _reached(request, name, seen)[0].endpoints != first]
    others = [name for name in named if _runs(request, name, seen)]
    rigs: dict[str, tuple[LocalRig, Reach]] = {}
    if request.site_file is None and not os.environ.get(RUNTIME_DIRECTORY_VARIABLE):
        # Rigs that were started with another folder for this user, as in a session without a login.
        found = {folder: LocalRig.of_holders(holders, seen) for folder, holders in elsewhere.items()}
        rigs = {folder: (rig, rig.reach(request.target, request.site)) for folder, rig in found.items()}
    if not others and not rigs:
        return _stop_rig(request, "", seen, lambda answer: _show(request, answer))
    # All rigs are stopped at once: one that does not answer must not delay the stop of the others.
    names = [name for name in (FIRST_RIG, *others) if name in others or _runs(request, name, seen)]
    rigs |= {name: _reached(request, name, seen) for name in names}
    # Each device that is asked has a row, also if its thread fails.
    asked = [f"{name}/{device}" for name, (_, reach) in rigs.items() for device in reach.asked]
    answers = {node: Answer(node, "unreached", "was not asked to the end") for node in asked}

    def stop(name: str) -> None:
        def of_rig(answer: Answer) -> Answer:
            return answer._replace(node=f"{name}/{answer.node}")

        rows = _stop_directly(request, *rigs[name], lambda answer: _show(request, of_rig(answer)))
        answers.update({of_rig(answer).node: of_rig(answer) for answer in rows.values()})

    threads = [threading.Thread(target=stop, args=(name,)) for name in rigs]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    _tell_which(sorted(rigs))
    return answers


def _tell_which(rigs: Sequence[str]) -> None:
    """Print the rigs that were stopped, if none was named and there are others than the one of this folder."""
    text = f"no rig was named, and the stop went to each one of this user that was found: {', '.join(rigs)}"
    with contextlib.suppress(OSError):
        sys.stderr.write(
            one_line(f"telenano: {text}; --rig or {RUNTIME_DIRECTORY_VARIABLE} names those that are meant")
        )
        sys.stderr.write("\n")


def _rigs_of(seen: Look) -> tuple[list[str], dict[str, list[Holder]]]:
    """Return the names of the rigs in this process's folder, and device and recorder processes of others by folder.

    A rig elsewhere counts only if one of its devices runs.
    """
    names, elsewhere = rigs_with_folders(), dict[tuple[int, str], list[Holder]]()
    for holder in seen.holders:
        base, name = base_and_rig(holder.folder)
        if folder_identity(base) == folder_identity(base_directory()):
            names += [] if name in names else [name]
        elif holder.node in (*DEVICES, RECORDER):
            elsewhere.setdefault(holder.rig, []).append(holder)
    rigs = [found for found in elsewhere.values() if {one.node for one in found} & set(DEVICES)]
    return names, {str(found[0].folder): found for found in rigs}


def _show(request: EstopRequest, answer: Answer) -> None:
    if not request.as_json:
        _print(f"{answer.node} {answer.kind}: {answer.text}")


def _runs(request: EstopRequest, name: str, seen: Look) -> bool:
    """Return whether devices of a rig can be stopped here, or will be started again by its launcher."""
    rig, reach = _reached(request, name, seen)
    return reach.is_sent or rig.is_supervised()


def _reached(request: EstopRequest, name: str, seen: Look) -> tuple[LocalRig, Reach]:
    """Return a rig on this machine with its endpoints, and the paths to its devices."""
    before = os.environ.get(RIG_VARIABLE, "")
    os.environ[RIG_VARIABLE] = name
    try:
        if request.site_file is None:
            rig = LocalRig.packaged(two_machines=bool(request.site), seen=seen)
        else:
            rig = LocalRig.read(request.site_file, seen)
    finally:
        os.environ[RIG_VARIABLE] = before
    return rig, rig.reach(request.target, request.site)


def _stop_rig(request: EstopRequest, name: str, seen: Look, show: Callable[[Answer], None]) -> dict[str, Answer]:
    """Stop the devices of one rig by every available way, and return what became of the stop at each.

    Raises:
        RigError: Nothing of a rig runs here, and no device is to be reached from here.
        ConfigError: The target means no node of the site file.
    """
    os.environ[RIG_VARIABLE] = name
    rig, reach = _reached(request, name, seen)
    answers = _stop_directly(request, rig, reach, show)
    if reach.by_console or not answers:
        answers |= _stop_by_console(request, reach.by_console or (request.target,), show)
    if answers and all(answer.kind == "absent" for answer in answers.values()):
        text = absence_text(rig.seen, map(path_of, rig.endpoints.values()), "telenano estop")
        raise RigError(f"no device of the site file was found here: {text}")
    return answers


def _stop_directly(
    request: EstopRequest, rig: LocalRig, reach: Reach, on_answer: Callable[[Answer], None]
) -> dict[str, Answer]:
    """Stop the devices that are reached without a console, and return what became of the stop at each."""
    for text in rig.strangers():
        sys.stderr.write(f"telenano: {text}\n")

    def listen() -> AbstractContextManager[FarListener]:
        # Imported here, because it loads keys and models, which takes longer.
        from telenano.console.far_answers import listening

        return listening(request.site_file or TWO_SITES_FILE)

    answers = emergency_stop(rig, reach, request.target, on_answer, os.environ.get("TELENANO_NAME", ""), listen)
    if all_acknowledged(answers):
        return answers
    # Imported here, because it loads what reads recordings: nothing is looked up before the stop was sent.
    from telenano.console.last_seen import with_last_seen

    return with_last_seen(rig, answers)


def _stop_by_console(
    request: EstopRequest, targets: Sequence[str], show: Callable[[Answer], None]
) -> dict[str, Answer]:
    """Send the stop like any other command: over a network, to nodes of an older version, to nodes without a device."""
    # Imported here, because it loads models and keys, which takes longer.
    from telenano.console.send_commands import send_control
    from telenano.runtime.loop.commands import Command
    from telenano.wire.messages import SessionEvent

    site: Literal["master", "slave"] = "slave" if request.site == "slave" else "master"
    site_file = request.site_file or (TWO_SITES_FILE if request.site else DEFAULT_SITE_FILE)
    answers: dict[str, Answer] = {}

    def on_answer(event: SessionEvent) -> None:
        answers[event.src] = Answer(event.src, event.kind, event.text)
        show(answers[event.src])

    for target in targets:
        try:
            send_control(Command("estop", target), site_file, site, on_answer)
        except TelenanoError as error:
            if target not in DEVICES:
                raise
            answers.setdefault(target, Answer(target, "unreached", f"takes no stop from here: {error}"))
    return answers
