"""Terminal view of a program that a running rig's instrument carries out: a progress bar, keys to pause and end."""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from telenano.cli import RawKeyboard, Void

if TYPE_CHECKING:
    from telenano.wire import AfmProgram, Scalar
    from telenano_lab.microscopy.image_files import LiveImage
    from telenano_lab.microscopy.live_program import LiveCurve

_BAR = 30

AfmOption = Annotated[
    list[str] | None,
    typer.Option("--afm", metavar="KEY=VALUE", help="Change a key of afm_node, as in a scenario (repeatable)."),
]
LiveOption = Annotated[
    bool, typer.Option("--live", help="Use the instrument of the running rig, with its sample and cantilever.")
]


# Without a running rig no site file is read.
LIVE_RULES = (Void("--site-file, --rig", "which names a rig", unless="--live"),)


def decided_by_rig(options: str, unless: str = "") -> Void:
    """Return the rule that these options have no meaning for a running rig."""
    return Void(options, "whose scenario decides it", beside="--live", unless=unless)


def follow_program(
    site_file: Path,
    parameters: "Mapping[str, Scalar]",
    collected: "LiveImage | LiveCurve",
    *,
    as_json: bool,
    on_end: Callable[[], None] = lambda: None,
) -> "AfmProgram":
    """Run a program on the rig with a progress bar and keys (space pauses and resumes, q ends); return its last report.

    `on_end` is called as soon as the instrument reports the end, before anything of the program is closed.
    """
    from telenano_lab.microscopy.live_program import run_program

    with RawKeyboard() as keyboard:

        def on_report(report: "AfmProgram") -> str:
            if report.state in ("finished", "ended"):
                on_end()
            if not as_json:
                keyboard.show(bar_of(report))
            for key in keyboard.pressed():
                if key == "q":
                    return "abort"
                if key == "space" and report.program == "scan":
                    return "resume" if report.state == "paused" else "pause"
            return ""

        return run_program(site_file, parameters, collected, on_report)


def bar_of(report: "AfmProgram") -> str:
    """Return a line of text with the progress of a program, its state and the keys."""
    full = round(_BAR * report.done_percent / 100.0)
    count = f" {report.line}/{report.lines}" if report.lines else ""
    keys = "space: pause, q: end" if report.program == "scan" else "q: end"
    state = "paused" if report.state == "paused" else report.text
    return f"{report.program} {'━' * full}{'╌' * (_BAR - full)}{count}  {state}  ({keys})"
