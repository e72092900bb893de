"""`telenano view`: serve the operator's page of a running rig or of a recording."""

import contextlib
import os
import signal
import time
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import typer

from services.viz_node.document import RecordingDocument
from services.viz_node.hub import Hub
from services.viz_node.level_cache import LevelCache
from services.viz_node.live import LiveSource
from services.viz_node.node import page_of_rig
from services.viz_node.page_server import PageServer
from services.viz_node.playback import RecordingPlayback
from services.viz_node.recording_files import RecordingFiles
from telenano.cli.model_options import validated, with_options
from telenano.cli.option_rules import Void, rules
from telenano.cli.options import SameSessionOption, SiteFileOption
from telenano.cli.output import report_errors, say
from telenano.launcher.restart_policy import RestartTracker
from telenano.recording.multi_file import RecordingSource, open_recordings
from telenano.recording.session_folder import recordings_of
from telenano.runtime.bus.address_book import AddressBook
from telenano.runtime.bus.local_endpoint import runtime_directory
from telenano.runtime.loop.realtime import behind_others
from telenano.runtime.wiring.main import EXIT_DIED
from telenano.runtime.wiring.observer import runs_no_node
from telenano.runtime.wiring.participant import Participant, StopSignals
from telenano.serving.access import Access
from telenano.serving.config import ViewConfig
from telenano.serving.connections import Listener
from telenano.serving.people import ROLES, People, known_role
from telenano.serving.serve import Tls, addresses_of, announced, missing_for_view, served_addresses
from telenano.settings.included import DEFAULT_SITE_FILE, DEMO_RECORDING
from telenano.timing.clock import SystemClock
from telenano.wire.errors import ConfigError, TelenanoError, described
from telenano.wire.nodes import PAGE

_MINUTES = 90.0  # Default validity of a person's address [min].


class PageService(NamedTuple):
    """Access rights, encryption and listener of a page, and the signals that end it."""

    access: Access
    tls: Tls | None
    bound: Listener
    signals: StopSignals


@rules(
    Void("*", "which serves no page", beside="--revoke", but="--rig"),
    Void("*", "which serves no page", beside="--addresses"),
    Void("*", "which serves no page", beside="--for", but="--role, --for-minutes, --rig"),
    Void("--role, --for-minutes", "which names the person", unless="--for"),
    Void("FILE|DIR", "which shows the recording that comes with telenano", beside="--demo"),
    Void("--site-file, --rig", "which is shown instead of a rig", beside="--demo, FILE|DIR"),
    Void("--same-session", "the files to join", unless="FILE|DIR"),
)
@with_options(ViewConfig)
def view(
    given: dict[str, Any],
    files: Annotated[
        list[Path] | None,
        typer.Argument(metavar="FILE|DIR", help="Recording to show, in its parts; without it the running rig."),
    ] = None,
    demo: Annotated[
        bool, typer.Option("--demo", help="Show the recording of Fig. 12 that comes with telenano.")
    ] = False,
    site_file: SiteFileOption = DEFAULT_SITE_FILE,
    addresses: Annotated[
        bool,
        typer.Option("--addresses", help="Print the addresses, with their tokens, of your pages here, and end."),
    ] = False,
    person: Annotated[
        str | None,
        typer.Option("--for", metavar="NAME", help="Print an address of its own for a person, and end."),
    ] = None,
    role: Annotated[
        str, typer.Option("--role", metavar="ROLE", callback=known_role, help=f"With --for: {', '.join(ROLES)}.")
    ] = "operator",
    minutes: Annotated[
        float,
        typer.Option("--for-minutes", metavar="MIN", help="With --for: time for which the address is valid [min]."),
    ] = _MINUTES,
    revoke: Annotated[
        str | None, typer.Option("--revoke", metavar="NAME", help="Revoke the address of a person at once, and end.")
    ] = None,
    same_session: SameSessionOption = False,
) -> None:
    """Serve the operator's page of a running rig, or of a recording, until Ctrl-C; prints the addresses to open.

    Where the output is no terminal, no token is written to it, because a pipe or a log keeps it. `--addresses` prints
    the addresses of every page that you serve on this machine, those of `telenano up` too, whenever you ask.

    The token of the operator is in TELENANO_VIEW_OPERATOR_TOKEN, that of observers in TELENANO_VIEW_OBSERVER_TOKEN,
    that of a participant of an experiment in TELENANO_VIEW_PARTICIPANT_TOKEN; without them new ones are made.

    `--for NAME` gives a person an address at the pages of the rig that --rig or TELENANO_RIG names.
    """
    with report_errors(False):
        if revoke is not None:
            People().revoke(revoke)
            typer.echo(f"the address of {revoke} is revoked")
            return
        if person is not None:
            _print_address_for(person, role, minutes)
            return
        if addresses:
            if not (lines := served_addresses()):
                raise ConfigError("you serve no page on this machine: `telenano up` serves one, or `telenano view`")
            typer.echo("\n".join(lines))
            return
        if reason := missing_for_view():
            raise ConfigError(f"the view cannot be served: {reason}")
        config = validated(ViewConfig, given)
        tls, access = config.tls(), config.access()
        files = [DEMO_RECORDING] if demo else [file for path in files or () for file in recordings_of(path)]
        recordings = open_recordings(files, same_session=same_session) if files else None
        if recordings is None:
            # Connect once, so that a machine which cannot join the rig gets an error before an address is shown.
            LiveSource(AddressBook.load(site_file), "").close()
        idle = recordings is None and runs_no_node(AddressBook.load(site_file))
        signals = StopSignals()
        with config.bind() as bound:
            page = PageService(access, tls, bound, signals)
            behind_others()
            if idle:
                # A rig may be started after its page.
                text = "telenano: no rig of this site file was found on this machine yet; the page waits for one"
                typer.echo(text, err=True)
            # The address is shown after the last step that could fail, because its reader may open it.
            with announced(addresses_of(bound, access, tls, config.name), typer.echo):
                _serve_again(
                    partial(_serve_rig, site_file, page)
                    if recordings is None
                    else partial(_serve_recording, recordings, files, page, same_session)
                )
    # SIGTERM gives its usual exit code, as after any other command; Ctrl-C is the normal end.
    if os.read(signals.descriptor, 1)[0] == signal.SIGTERM:
        raise SystemExit(128 + signal.SIGTERM)


def _print_address_for(name: str, role: str, minutes: float) -> None:
    """Print an address for a person at each page of this rig that is served here; raise ConfigError if none is."""
    # A page is listed under several names, and the address of a participant opens another page (.html).
    lines = (line.partition(": ")[2].partition("#") for line in served_addresses([runtime_directory()]))
    served = dict.fromkeys(base for base, sign, _ in lines if sign and not base.endswith(".html"))
    if not served:
        raise ConfigError("no page of this rig is served on this machine: `telenano up` serves one, or `telenano view`")
    token = People().add(name, role, minutes)
    for base in served:
        typer.echo(f"{name} ({role}, {minutes:g} min): {base}#{token}")


def _serve_again(serve_once: Callable[[], None]) -> None:
    """Serve until a signal comes. After an unexpected error, report it and start the server again."""
    restarts = RestartTracker(SystemClock(), [], beside=[PAGE])
    while True:
        restarts.record_start(PAGE)
        try:
            return serve_once()
        except TelenanoError as error:
            raise type(error)(f"the view has ended: {error}") from error
        except Exception as error:  # noqa: BLE001
            # The operator must be able to stop the rig from the page after any error.
            end = restarts.record_exit(PAGE, EXIT_DIED)
            text = f"the view has ended: {described(error)}; {end.verdict}"
            say(text)
            time.sleep(end.restart_in_s or 0.0)


def _serve_recording(recordings: RecordingSource, files: Sequence[Path], page: PageService, same_session: bool) -> None:
    def judged() -> Mapping[str, Any]:
        # Importing the analysis takes longer than opening the page.
        from telenano.analysis.recording_document import judged_recording

        return judged_recording(open_recordings(files, same_session=same_session))

    def judged_before() -> Mapping[str, Any] | None:
        from telenano.analysis.recording_document import summary_facts
        from telenano.api import RecordedSession

        session = RecordedSession(files, same_session=same_session)
        if not session.is_judged or session.start_ns is None:
            return None
        return summary_facts(session.summary, (session.start_ns - recordings.span_ns[0]) * 1e-9)

    document = RecordingDocument(recordings, judged, LevelCache(files), judged_before)
    playback = RecordingPlayback(recordings, time.monotonic)
    with (
        contextlib.closing(Hub(playback, document=document, recording=RecordingFiles.of_paths(files))) as hub,
        contextlib.closing(PageServer(hub, page.access, page.bound, page.tls, page.signals.descriptor)) as server,
    ):
        server.run()


def _serve_rig(site_file: Path, page: PageService) -> None:
    """Run, in this process, the page's node that `telenano up` would start."""
    book = AddressBook.load(site_file)
    # Only a page with an endpoint on the network publishes; a machine that may only observe has no key for that.
    is_public = PAGE in book.nodes and book.network_endpoint(PAGE) is not None
    with Participant.open(PAGE, book, page.signals.descriptor, publisher=is_public) as participant:
        node, bus = page_of_rig(participant, site_file, page.bound, page.access, page.tls)
        page.signals.run(node, bus, freeze=False)
