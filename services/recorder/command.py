"""`telenano record`: an additional recorder that attaches to a running rig without changing it."""

from collections.abc import Callable
from pathlib import Path
from typing import Annotated

import typer

from services.recorder.attach import run_record
from services.recorder.node import RecorderNode
from telenano.cli.keyboard import RawKeyboard
from telenano.cli.model_options import SECONDS, Given, with_options
from telenano.cli.option_rules import Void, rules
from telenano.cli.options import ExcludeOption, JsonOption, SiteFileOption, TopicsOption
from telenano.cli.output import fail, fail_incomplete, print_answer, report_errors, say
from telenano.recording.provenance import configuration_files
from telenano.recording.recorder_config import RecorderConfig
from telenano.runtime.bus.address_book import AddressBook
from telenano.runtime.wiring.observer import RIG_HINT, runs_no_node
from telenano.settings.config import validate
from telenano.settings.included import DEFAULT_SITE_FILE
from telenano.wire.errors import TelenanoError

_KEYS_TEXT = "s new file · q end"


class RecordKeyBindings:
    """Maps keys to actions of a recorder, and shows its status line."""

    def __init__(self, keys: RawKeyboard) -> None:
        self._keys = keys
        self._note = _KEYS_TEXT

    def __call__(self, node: RecorderNode) -> None:
        actions: dict[str, Callable[[], None]] = {"s": node.split, "q": node.context.request_stop}
        for key in self._keys.pressed():
            try:
                self._note = _KEYS_TEXT if key in actions else f"unknown key {key!r}: {_KEYS_TEXT}"
                actions.get(key, lambda: None)()
            except TelenanoError as error:
                self._note = str(error)
        self._keys.show(f"{node.status()} · {self._note}")


# Settings for which the command has its own options, or that only the recorder of a rig has.
_FILES = ("directory", "file_name", "sync_to_disk", "chunk_size_bytes")
_OWN = (*_FILES, "topics", "exclude", "far", "fetch_kbit_per_s")


@rules(Void("--quota-policy", "at which it acts", unless="--quota"))
@with_options(RecorderConfig, _OWN, units=SECONDS)
def record(
    out: Annotated[Path, typer.Option("--out", metavar="FILE", help="Recording to make; an existing one is kept.")],
    given: Given,
    topics: TopicsOption = None,
    exclude: ExcludeOption = None,
    sync: Annotated[bool, typer.Option("--sync", help="Wait for the disk at each flush.")] = False,
    duration: Annotated[
        float | None, typer.Option("--duration", min=0.0, metavar="S", help="End after this time [s].")
    ] = None,
    scenario: Annotated[
        Path | None,
        typer.Option("--scenario", metavar="FILE", help="Scenario to attach, which report and re-run need (YAML)."),
    ] = None,
    site_file: SiteFileOption = DEFAULT_SITE_FILE,
    as_json: JsonOption = False,
) -> None:
    """Attach to a running rig and record it; Ctrl-C or q completes the file. Keys: s new file, q end.

    The exit code is 3 if the recording lacks messages that were sent.
    """
    with report_errors(as_json):
        place = {"directory": str(out.absolute().parent), "file_name": out.name, "sync_to_disk": sync}
        config = validate(
            RecorderConfig, {**given, **place, "topics": topics or (), "exclude": exclude or ()}, "telenano record"
        )
        # Check the files: a rig is recorded even with an unreadable scenario, but here a person has named it.
        configuration_files(site_file, scenario)
        reason = (
            "no rig of this site file was found on this machine" if runs_no_node(AddressBook.load(site_file)) else ""
        )
        if reason and not as_json:
            # The rig may be started after its recorder.
            say(f"{reason} yet; waiting for one")
        with RawKeyboard() as keys:
            done = run_record(site_file, config, scenario, duration, RecordKeyBindings(keys))
        if not done.fault and not done.messages and not reason:
            reason = "nothing was received"
        if reason and not done.messages:
            fail(f"{reason}: {RIG_HINT} The recording is empty: {done.path}", as_json=as_json, **done.model_dump())
        if done.fault:
            fail(done.fault, as_json=as_json, **done.model_dump())
        text = f"recorded {done.messages} messages, {done.lost} lost, {done.files} file(s), newest {done.path}"
        print_answer(done.model_dump(), text, as_json=as_json)
        missing = [f"{done.missing} messages are missing"] if done.missing else []
        if missing or done.notes:
            fail_incomplete([*missing, *done.notes])
