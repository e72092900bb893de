"""`telenano keys`: the key of this machine, and the list of the keys of others with their roles."""

from datetime import date, timedelta
from enum import StrEnum
from pathlib import Path
from typing import Annotated, Any

import typer

from telenano.cli.options import JsonOption, command_group
from telenano.cli.output import print_answer, print_json, print_rows, report_errors
from telenano.runtime.security.keyring import AllowedKey, Keyring, expiry_in, keys_directory, keys_in, utc_today
from telenano.runtime.security.private_files import read_regular
from telenano.wire.errors import ConfigError

app = command_group()

DirOption = Annotated[
    Path | None,
    typer.Option(
        "--dir", metavar="DIR", help="Folder of the keys; default: TELENANO_KEYS_DIR, or telenano/keys in ~/.config."
    ),
]
ExpiresOption = Annotated[
    str | None,
    typer.Option(
        "--expires", metavar="DATE|DAYS", help="Last day (UTC) of the key, such as 2027-06-30 or 90d; default: none."
    ),
]
NameArgument = Annotated[str, typer.Argument(metavar="NAME", help="Machine of the site file, such as master or slave.")]


class RoleName(StrEnum):
    """The roles of a key."""

    DATA = "data"
    CONTROL = "control"
    OBSERVE = "observe"
    RELAY = "relay"


@app.command()
def new(
    name: NameArgument,
    replace: Annotated[
        bool, typer.Option("--replace", help="Replace an existing key; the other machines must allow the new one.")
    ] = False,
    expires: ExpiresOption = None,
    folder: DirOption = None,
    as_json: JsonOption = False,
) -> None:
    """Make a key pair for a machine; the secret key stays in a file that only you can read."""
    with report_errors(as_json):
        ring = _ring(folder)
        pair = ring.create(name, replace=replace, expires=_last_day(expires))
        public = pair.public.decode()
    if as_json:
        until = {"expires": str(pair.expires)} if pair.expires else {}
        print_json({"name": name, "public_key": public, "folder": str(ring.folder), **until})
        return
    typer.echo(f"made the key of {name} in {ring.folder}; its public key is\n\n  {public}\n")
    typer.echo(f"On each other machine:  telenano keys allow {name} '{public}' --role ...")


@app.command()
def show(folder: DirOption = None, as_json: JsonOption = False) -> None:
    """Show the public keys of this machine and the keys that it knows of others; secret keys are never shown."""
    with report_errors(as_json):
        ring = _ring(folder)
        own = {name: ring.own(name).public.decode() for name in ring.names()}
        allowed = ring.allowed().keys
        warnings = [*(text for name in own if (text := ring.misplaced(name))), *ring.expiring()]
    if as_json:
        print_json(
            {
                "folder": str(ring.folder),
                "own": own,
                "allowed": [_entry(key) for key in allowed],
                **({"warnings": warnings} if warnings else {}),
            }
        )
        return
    rows = [{"machine": name, "public key": key, "here": "own"} for name, key in own.items()]
    rows += [{"machine": key.name, "public key": key.public_key, "here": _roles_text(key)} for key in allowed]
    if rows:
        print_rows(rows)
    for text in warnings:
        typer.echo(f"warning: {text}", err=True)
    typer.echo(f"keys are in {ring.folder}" if rows else f"no key is in {ring.folder}: `telenano keys new NAME`")


@app.command()
def allow(
    name: NameArgument,
    key: Annotated[
        str,
        typer.Argument(
            metavar="KEY|FILE",
            help="Its public key (quoted; behind -- where it begins with a hyphen), or its NAME.key file.",
        ),
    ],
    role: Annotated[
        list[RoleName],
        typer.Option(
            "--role",
            help="data: accept its messages; control: its commands; observe: let it subscribe; relay: it may use the "
            "relay here, or is the relay (repeatable).",
        ),
    ],
    expires: ExpiresOption = None,
    folder: DirOption = None,
    as_json: JsonOption = False,
) -> None:
    """Allow a machine to connect, or change its roles; running nodes apply it within a second."""
    with report_errors(as_json):
        public, until = _public_key(key)
        entry = _ring(folder).allow(name, public, [entry.value for entry in role], _last_day(expires) or until)
    print_answer(_entry(entry), f"{name} is allowed: {_roles_text(entry)}", as_json=as_json)


@app.command()
def revoke(
    name: Annotated[str, typer.Argument(metavar="NAME|KEY", help="Machine, or its public key (quoted).")],
    folder: DirOption = None,
    as_json: JsonOption = False,
) -> None:
    """Revoke a key for ever; running nodes close its connections within a second."""
    with report_errors(as_json):
        entry = _ring(folder).revoke(name)
    print_answer(_entry(entry), f"the key {entry.public_key} of {entry.name} is revoked", as_json=as_json)


def _ring(folder: Path | None) -> Keyring:
    return Keyring(folder or keys_directory())


def _last_day(text: str | None) -> date | None:
    """Return the day given as a date or as a number of days from today; None for None."""
    if text is None:
        return None
    try:
        day = utc_today() + timedelta(int(text[:-1])) if text.endswith("d") else date.fromisoformat(text)
    except (ValueError, OverflowError) as error:
        raise ConfigError(f"--expires: {text} is neither a date such as 2027-06-30 nor days such as 90d") from error
    if day < utc_today():
        raise ConfigError(f"--expires: {day} is over: the key would be refused at once")
    return day


def _public_key(text: str) -> tuple[str, date | None]:
    """Return the public key, given itself or by its file, and the last day that the file states."""
    path = Path(text)
    if not path.name.endswith(".key"):
        return text, None
    try:
        content, _ = read_regular(path)
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read: {error.strerror}") from error
    public, _ = keys_in(content)
    if not public:
        raise ConfigError(f"{path}: contains no public key; give the NAME.key file of that machine")
    return public.decode(errors="replace"), expiry_in(content, path)


def _roles_text(key: AllowedKey) -> str:
    until = f" until {key.expires}" if key.expires else ""
    return "revoked" if key.revoked else ", ".join(key.roles) + until


def _entry(key: AllowedKey) -> dict[str, Any]:
    return key.model_dump(mode="json", exclude_none=True)
