"""Run laws of this package and the core on a live rig: `python -m telenano_laws.live_sessions FOLDER [LAW ...]`.

Each law runs Fig. 12 over two measured lines, with the simulated hand and with an emulated Inverse3, in processes of
their own on this machine. FOLDER gets a folder with recording, summary and figure for each session, and sessions.md, a
row a session. A live session depends on how busy the machine is: two runs agree in their verdicts, and not in bits.
"""

import argparse
import contextlib
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from telenano.cli import run_session
from telenano.files import atomic_file
from telenano.signals import start
from telenano.wire import RigError

LINES = ("cicv5g_n78_urban", "starlink_driving")
DEVICES = ("sim", "haply")
LAWS = ("bounded_model", "passivity", "model_mediated")
SEED = 3
HEADS = ("law", "line", "device", "verdict", "hand's force over the tip's in each hold", "greatest force / N", "reason")
_READY_S = 60.0


@contextlib.contextmanager
def emulated_inverse3(scenario: str) -> Iterator[tuple[str, ...]]:
    """Run an emulated Inverse3 with the hand of a scenario, and yield the settings with which a rig uses it.

    Raises:
        RigError: The emulator ended, or did not answer within a minute; the message contains its standard error.
    """
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    command = [sys.executable, "-m", "telenano", "device", "simulate", "haply", "--port", str(port)]
    streams: dict[str, Any] = {"stdin": subprocess.PIPE, "stdout": subprocess.DEVNULL}
    with (
        tempfile.TemporaryFile() as log,
        start([*command, "--scenario", scenario], stderr=log, dies_with_parent=True, **streams) as device,
    ):
        try:
            until = time.monotonic() + _READY_S
            while not _answers(port):
                if device.poll() is not None or time.monotonic() > until:
                    log.seek(0)
                    raise RigError(f"the emulated Inverse3 did not start: {log.read().decode().strip()}")
                time.sleep(0.1)
            yield ("haptic_node.device=haply", f"haptic_node.haply.service=ws://127.0.0.1:{port}")
        finally:
            device.terminate()


def _answers(port: int) -> bool:
    with contextlib.suppress(OSError), socket.create_connection(("127.0.0.1", port), timeout=1.0):
        return True
    return False


def summary_of(folder: Path, law: str, line: str, settings: Sequence[str] = ()) -> dict[str, Any]:
    """Run one session and return its summary.

    Raises:
        RigError: `telenano up` gave no summary; the message contains its output.
    """
    keys = (f"controller.law={law}", f"delay_node.profile={line}", f"delay_node.seed={SEED}", *settings)
    command = [sys.executable, "-m", "telenano", "up", "--scenario", "fig12", "--json", "--overwrite", "--out"]
    sets = [word for key in keys for word in ("--set", key)]
    try:
        return run_session([*command, str(folder), *sets])
    except RigError as error:
        raise RigError(f"{law} over {line}: {error}") from error


def row(law: str, line: str, device: str, summary: dict[str, Any]) -> str:
    """Return the row of a session in the Markdown table."""
    ratios = [hold["hold_ratio"] for hold in summary["holds"] if hold["hand_force_n"] > 0.0]
    shown = ", ".join("–" if ratio is None else f"{ratio:.3f}" for ratio in ratios)
    struck = [fact["value"] for hold in summary["holds"] for fact in hold["facts"] if fact["kind"] == "struck"]
    greatest = f"{max(struck):.3g}" if struck else "–"
    return f"| {law} | {line} | {device} | {summary['verdict']} | {shown} | {greatest} | {summary['reason']} |"


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the sessions, and write the table after each one."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("laws", nargs="*", default=LAWS, metavar="LAW")
    parser.add_argument("--line", action="append", help="a network of `telenano link profile`; may be repeated")
    parser.add_argument("--device", action="append", choices=DEVICES, help="sim, haply; may be repeated")
    parser.add_argument("--rate", type=float, default=1000.0, help="rate of the loops [Hz]")
    chosen = parser.parse_args(arguments)
    rows = [f"| {' | '.join(HEADS)} |", "|" + "---|" * len(HEADS)]
    rate = f"realtime.rate_hz={chosen.rate:g}"
    for law in chosen.laws:
        for line in chosen.line or LINES:
            for device in chosen.device or DEVICES:
                folder = chosen.folder / f"{law}-{line}-{device}"
                try:
                    with emulated_inverse3("fig12") if device == "haply" else contextlib.nullcontext(()) as taken:
                        summary = summary_of(folder, law, line, (rate, *taken))
                except RigError as error:
                    parser.exit(4, f"{error}\n")
                rows.append(row(law, line, device, summary))
                sys.stdout.write(f"{rows[-1]}\n")
                sys.stdout.flush()
                with atomic_file(chosen.folder / "sessions.md") as part:
                    part.write_text("\n".join([*rows, ""]), encoding="utf-8")


if __name__ == "__main__":
    main()
