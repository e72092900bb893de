"""`telenano relay`: a relay between two sites that can only dial out, or the end of one site alone."""

import contextlib
from collections.abc import AsyncIterator
from typing import Annotated

import typer

from telenano.cli import SiteFileOption, Void, report_errors, rules
from telenano.runtime import AccessControl, AddressBook, StructuredLog, beside_the_loop
from telenano.settings import TWO_SITES_FILE
from telenano.wire import ConfigError
from telenano_wide_area.relay.protocol import RELAY, split_host_port
from telenano_wide_area.relay.server import DEFAULT_PORT, Relay
from telenano_wide_area.relay.site_end import site_end, until_stopped


@rules(
    Void("--listen, --mbit-per-s", "which runs the end of one site alone", beside="--join"),
    Void("--site-file, --rig", "whose end is run", unless="--join"),
)
def relay(
    listen: Annotated[
        str,
        typer.Option("--listen", metavar="HOST:PORT", help="Address to listen at, by TCP and UDP."),
    ] = f"0.0.0.0:{DEFAULT_PORT}",
    mbit_per_s: Annotated[
        float,
        typer.Option(
            "--mbit-per-s",
            metavar="MBIT",
            min=0.1,
            max=1e5,
            help="Greatest rate that is carried for each site [Mbit/s].",
        ),
    ] = 50.0,
    join: Annotated[
        str | None,
        typer.Option(
            "--join",
            metavar="SITE",
            help="Run the end of this site alone, where `telenano up` does not: master or slave.",
        ),
    ] = None,
    site_file: SiteFileOption = TWO_SITES_FILE,
) -> None:
    """Relay encrypted messages between two sites that can only dial out, until Ctrl-C; it needs the keys of both."""
    with report_errors(as_json=False):
        beside_the_loop()
        if join is not None:
            if join not in ("master", "slave"):
                raise ConfigError(f"--join: {join} is not a site, must be master or slave")
            work = site_end(AddressBook.load(site_file), join, StructuredLog(f"{RELAY}@{join}")).run()
        else:
            work = _serve(listen, mbit_per_s)
        until_stopped(work)


async def _serve(listen: str, mbit_per_s: float) -> None:
    async with serving_relay(listen, mbit_per_s) as relay:
        await relay.run()


@contextlib.asynccontextmanager
async def serving_relay(listen: str, mbit_per_s: float) -> AsyncIterator[Relay]:
    """Yield a relay that listens at `HOST:PORT` and logs its key and who may use it; ConfigError for another form."""
    try:
        host, port = split_host_port(listen)
    except ValueError as error:
        raise ConfigError(f"--listen: {error}") from error
    access = AccessControl(RELAY)
    log = StructuredLog(RELAY)
    relay = Relay(access, log, mbit_per_s)
    await relay.start(host, port)
    log.info(f"listening on {host} port {port}, TCP and UDP; the key of this relay is {access.public_key}")
    names = [key.name for key in access.keyring.allowed().keys if "relay" in access.roles(key.name)]
    if names:
        log.info(f"it may be used by {', '.join(names)}")
    else:
        log.warning("no machine may use it yet: run `telenano keys allow NAME KEY --role relay` for each site")
    for text in access.keyring.expiring():
        log.warning(text)
    try:
        yield relay
    finally:
        await relay.close()
