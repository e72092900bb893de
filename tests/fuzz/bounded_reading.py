"""Reads one file by one command in this process, and prints what it took: memory [MB], processor time [s], chunks read.

python bounded_reading.py COMMAND FILE FOLDER
"""

import json
import resource
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from telenano.recording import mcap_scan, reader, summary_section
from telenano.recording.multi_file import open_recordings
from telenano.recording.reader import Recording
from telenano.wire.errors import TelenanoError

# the process ends here rather than the machine
_HIGHEST_BYTES = 6 << 30
# the chunks that were unpacked, once for each time
unpacked: list[int] = []


def counted(data: Any, block: Any) -> bytes:
    unpacked.append(block.offset)
    return mcap_scan_unpack(data, block)


mcap_scan_unpack = mcap_scan.unpack


def bag(*words: str) -> Callable[[Path, Path], None]:
    """Return what runs a command on a file, {out} for a file in the folder."""

    def run(path: Path, folder: Path) -> None:
        from telenano.cli.app import main

        sys.argv = [
            "telenano",
            *(word.format(file=path, out=folder / "out.mcap", folder=folder, parent=path.parent) for word in words),
        ]
        main()

    return run


def view(path: Path, folder: Path) -> None:
    """Do what `telenano view FILE` does until everything is read: the transport, the curves, the judgement, a part."""
    from services.viz_node.document import RecordingDocument
    from services.viz_node.playback import RecordingPlayback
    from telenano.analysis.recording_document import judged_recording

    recording = open_recordings([path])
    playback = RecordingPlayback(recording, time.monotonic)
    document = RecordingDocument(recording, lambda: judged_recording(open_recordings([path])))
    document.wait()
    list(playback.poll(watched=True))
    document.part(0.0, 10.0, 100)


def open_file(path: Path, folder: Path) -> None:
    import telenano

    telenano.open(path).summary  # noqa: B018


COMMANDS: dict[str, Callable[[Path, Path], None]] = {
    "bag info": bag("bag", "info", "{file}", "--json"),
    "bag verify": bag("bag", "verify", "{file}", "--json"),
    "bag list": bag("bag", "list", "{parent}", "--json"),
    "bag cat": bag("bag", "cat", "{file}", "--count", "20"),
    "bag filter": bag("bag", "filter", "{file}", "--out", "{out}"),
    "bag recover": bag("bag", "recover", "{file}", "--out", "{out}"),
    "bag split": bag("bag", "split", "{file}", "--out", "{folder}/parts", "--interval", "2"),
    "bag export": bag("bag", "export", "{file}", "--to", "mcap-json", "--out", "{folder}/viewer.mcap"),
    "report": bag("report", "{file}", "--out", "{folder}/report"),
    "view": view,
    "whole": lambda path, folder: [None for _ in Recording(path).select()].clear(),
}


def read() -> dict[str, Any]:
    command, path, folder = sys.argv[1], Path(sys.argv[2]), Path(sys.argv[3])
    resource.setrlimit(resource.RLIMIT_AS, (_HIGHEST_BYTES, _HIGHEST_BYTES))
    for module in (reader, summary_section):
        module.unpack = counted  # type: ignore[attr-defined]
    try:
        COMMANDS[command](path, folder)
        outcome = "read"
    except SystemExit as end:
        outcome = f"exit {end.code}"
    except TelenanoError as error:
        outcome = str(error)
    used = resource.getrusage(resource.RUSAGE_SELF)
    return {
        "outcome": outcome,
        # The largest memory by `getrusage` is that of the process which has started this one, where that was larger.
        "peak_mb": int(Path("/proc/self/status").read_text().partition("VmHWM:")[2].split()[0]) / 1024,
        "processor_s": used.ru_utime + used.ru_stime,
        "chunks": len(unpacked),
    }


if __name__ == "__main__":
    found = read()
    sys.stdout.write(f"\n{json.dumps(found)}\n")
