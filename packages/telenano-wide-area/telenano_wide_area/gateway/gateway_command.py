"""`telenano gateway`: serve the page of rigs that dial out, or be the end of the rig of this machine."""

import asyncio
import contextlib
import datetime
import hashlib
import ipaddress
import ssl
import tempfile
from importlib import util
from pathlib import Path
from typing import Annotated, Any

import typer

from telenano.cli import Void, report_errors, rules
from telenano.runtime import AccessControl, StructuredLog, beside_the_loop
from telenano.serving import (
    Access,
    Connections,
    Listener,
    Tls,
    bind,
    checked_tls,
    make_server,
    missing_for_view,
    page_folder,
)
from telenano.wire import ConfigError
from telenano_wide_area.relay.relay_command import serving_relay
from telenano_wide_area.relay.server import DEFAULT_PORT
from telenano_wide_area.relay.site_end import until_stopped

_PAGE_PORT = 8443
# Browsers accept a certificate by its hash alone for at most 14 days.
_DAYS = 13


@rules(
    Void("--listen, --mbit-per-s, --host, --port, --name, --certificate, --key", "which joins a rig", beside="--join"),
    Void("--page-port, --machine", "which is of the end of a rig", unless="--join"),
)
def gateway(
    names: Annotated[
        list[str] | None,
        typer.Option("--name", metavar="HOST", help="Name of this machine in addresses of pages (repeatable)."),
    ] = None,
    certificate: Annotated[
        Path | None,
        typer.Option("--certificate", metavar="FILE", help="Certificate (PEM); without one it is made for some days."),
    ] = None,
    key: Annotated[Path | None, typer.Option("--key", metavar="FILE", help="Key of the certificate (PEM).")] = None,
    host: Annotated[str, typer.Option("--host", metavar="ADDRESS", help="Address of the page.")] = "0.0.0.0",
    port: Annotated[
        int, typer.Option("--port", metavar="PORT", min=1, max=65535, help="Port of the page, by TCP and UDP.")
    ] = _PAGE_PORT,
    listen: Annotated[
        str, typer.Option("--listen", metavar="HOST:PORT", help="Address to which rigs dial out, by TCP and UDP.")
    ] = f"0.0.0.0:{DEFAULT_PORT}",
    mbit_per_s: Annotated[
        float,
        typer.Option("--mbit-per-s", metavar="MBIT", min=0.1, max=1e5, help="Greatest rate of each rig [Mbit/s]."),
    ] = 50.0,
    join: Annotated[
        str | None,
        typer.Option("--join", metavar="HOST:PORT", help="Be the end of this machine's rig at a gateway."),
    ] = None,
    page_port: Annotated[
        int,
        typer.Option("--page-port", metavar="PORT", min=1, max=65535, help="Port of the rig's page on this machine."),
    ] = 8650,
    machine: Annotated[
        str, typer.Option("--machine", metavar="NAME", help="Name of the key of the rig's machine.")
    ] = "master",
) -> None:
    """Serve the page of rigs that dial out to this machine, until Ctrl-C; with --join, be the end of a rig."""
    with report_errors(as_json=False):
        beside_the_loop()
        if reason := missing_for_view() or ("" if join else missing_for_gateway()):
            raise ConfigError(reason)
        if join is not None:
            from telenano_wide_area.gateway.rig_end import RigEnd

            try:
                end = RigEnd(join, page_port, AccessControl(machine), StructuredLog(f"gateway@{machine}"))
            except ValueError as error:
                raise ConfigError(f"--join: {error}") from error
            until_stopped(end.run())
            return
        with tempfile.TemporaryDirectory(prefix="telenano-gateway-") as folder:
            tls, digest = checked_tls(host, certificate, key) if certificate or key else None, b""
            if tls is None:
                tls = self_signed(names or ["localhost"], Path(folder))
                digest = hashlib.sha256(ssl.PEM_cert_to_DER_cert(tls.certificate.read_text())).digest()
            until_stopped(_serve(names or [], tls, digest, bind(host, port, "the gateway"), listen, mbit_per_s))


def missing_for_gateway() -> str:
    """Return a sentence on what a gateway lacks beside a server of the page; empty if it is all there."""
    is_there = util.find_spec("aioquic") is not None
    return "" if is_there else "aioquic is not installed: pip install 'telenano-wide-area[gateway]'"


async def _serve(names: list[str], tls: Tls, digest: bytes, bound: Listener, listen: str, mbit_per_s: float) -> None:
    from telenano_wide_area.gateway.gateway import Gateway
    from telenano_wide_area.gateway.web_transport import open_sessions

    page = page_folder()
    assert page is not None
    access = Access.made(names=names, allow=["0.0.0.0/0", "::/0"])
    connections = Connections()
    host, port = bound.getsockname()[:2]
    async with serving_relay(listen, mbit_per_s) as relay:
        gateway = Gateway(relay, digest)
        server = make_server(gateway.app(page, access, connections), tls)
        # `until_stopped` handles the signals.
        server.capture_signals = contextlib.nullcontext  # type: ignore[method-assign, assignment]
        sessions = await open_sessions(gateway, access, tls, host, port)
        shown = names[0] if names else host
        StructuredLog("gateway").info(
            f"the page of a rig is at https://{shown}:{port}/NAME/, NAME being that of its key"
        )
        tidying = asyncio.create_task(relay.run())
        try:
            await server.serve(sockets=[bound.again(connections)])
        finally:
            tidying.cancel()
            sessions.close()
            bound.close()


def _general(name: str) -> Any:
    """Return a host name or an address as certificates have it."""
    from cryptography import x509

    try:
        return x509.IPAddress(ipaddress.ip_address(name))
    except ValueError:
        return x509.DNSName(name)


def self_signed(names: list[str], folder: Path) -> Tls:
    """Return the files of a certificate for host names that is valid for some days, made in a private folder."""
    from cryptography import x509
    from cryptography.hazmat.primitives import hashes, serialization
    from cryptography.hazmat.primitives.asymmetric import ec

    private = ec.generate_private_key(ec.SECP256R1())
    name = x509.Name([x509.NameAttribute(x509.NameOID.COMMON_NAME, names[0][:64])])
    now = datetime.datetime.now(datetime.UTC)
    made = (
        x509.CertificateBuilder()
        .subject_name(name)
        .issuer_name(name)
        .public_key(private.public_key())
        .serial_number(x509.random_serial_number())
        .not_valid_before(now - datetime.timedelta(hours=1))
        .not_valid_after(now + datetime.timedelta(days=_DAYS))
        .add_extension(x509.SubjectAlternativeName([_general(each) for each in names]), critical=False)
        .sign(private, hashes.SHA256())
    )
    tls = Tls(folder / "certificate.pem", folder / "key.pem")
    tls.certificate.write_bytes(made.public_bytes(serialization.Encoding.PEM))
    plain = serialization.NoEncryption()
    form = serialization.PrivateFormat.PKCS8
    tls.key.write_bytes(private.private_bytes(serialization.Encoding.PEM, form, plain))
    return tls
