"""The message for a user when no rig is found: the folders searched, other rigs that run, and what cannot be seen."""

import shlex
from collections.abc import Iterable
from pathlib import Path

from telenano.runtime.bus.holders import Look
from telenano.runtime.bus.local_endpoint import (
    RUNTIME_DIRECTORY_VARIABLE,
    base_and_rig,
    base_directory,
    folder_identity,
    runtime_directory,
)
from telenano.wire.nodes import DEVICES, LAUNCHERS

_OF_A_RIG = (*LAUNCHERS, *DEVICES)
# Users see this hint when nothing is received.
RIG_HINT = "is `telenano up` running with this site file?"


def absence_text(seen: Look, paths: Iterable[Path], command: str = "") -> str:
    """Return the reasons why no rig was found, to continue a sentence that says so.

    Args:
        seen: The processes of this user that hold endpoints.
        paths: The expected paths of the rig's sockets.
        command: The command for which a rig in another folder is suggested; empty for any.
    """
    folders = ", ".join(sorted({str(path.parent) for path in paths})) or runtime_directory()
    texts = [f"no socket in {folders} answers, and no process of this user holds one"]
    for folder, process in sorted(_elsewhere(seen).items()):
        given = f"{RUNTIME_DIRECTORY_VARIABLE}={shlex.quote(folder)}"
        reached = f"`{given} {command}` reaches it" if command else f"{given} before the command reaches it"
        texts.append(f"a rig of this user runs in {folder} (process {process}): {reached}")
    if seen.blind:
        texts.append(f"whether another one runs is not known here, because {seen.blind}")
    return "; ".join([*texts, RIG_HINT])


def _elsewhere(seen: Look) -> dict[str, int]:
    """Return one process of each rig whose folder differs from that of this process, by folder."""
    found: dict[tuple[int, str], tuple[str, int]] = {}
    for holder in seen.holders:
        base, _ = base_and_rig(holder.folder)
        if holder.node in _OF_A_RIG and folder_identity(base) != folder_identity(base_directory()):
            found.setdefault(holder.rig, (str(base), holder.process))
    return dict(found.values())
