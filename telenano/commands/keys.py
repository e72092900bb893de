"""`telenano keys`: the key of this machine, and the list of those of others with what each may do."""

from enum import StrEnum
from pathlib import Path
from typing import Annotated, Any

import typer
import zmq.auth

from proto.errors import ConfigError
from services.runtime.security.keyring import AllowedKey, Keyring, Role, keys_directory
from telenano.output import console, print_json, report_errors

app = typer.Typer(
    help="Make, show and list the keys with which machines prove who they are.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    # markup would swallow the units in brackets
    rich_markup_mode=None,
)

DirOption = Annotated[
    Path | None,
    typer.Option(
        "--dir", metavar="DIR", help="Folder of the keys; default: TELENANO_KEYS_DIR, or telenano/keys in ~/.config."
    ),
]
JsonOption = Annotated[bool, typer.Option("--json", help="Print exactly one JSON object on stdout, nothing else.")]
NameArgument = Annotated[str, typer.Argument(metavar="NAME", help="Machine of the site file, such as master or slave.")]


class RoleName(StrEnum):
    """What a key may do."""

    DATA = "data"
    CONTROL = "control"
    OBSERVE = "observe"


@app.command()
def new(
    name: NameArgument,
    replace: Annotated[
        bool, typer.Option("--replace", help="Make a new key in the place of one that is there; others must allow it.")
    ] = False,
    folder: DirOption = None,
    as_json: JsonOption = False,
) -> None:
    """Make a key pair for a machine; its secret half stays in a file that only you can read."""
    with report_errors(as_json):
        ring = _ring(folder)
        public = ring.create(name, replace=replace).public.decode()
    if as_json:
        print_json({"name": name, "public_key": public, "folder": str(ring.folder)})
        return
    typer.echo(f"made the key of {name} in {ring.folder}; its public half is\n\n  {public}\n")
    typer.echo(f"On each other machine:  telenano keys allow {name} '{public}' --role ...")


@app.command()
def show(folder: DirOption = None, as_json: JsonOption = False) -> None:
    """Show the public keys of this machine and the list of keys that it knows; secret keys are never shown."""
    with report_errors(as_json):
        ring = _ring(folder)
        own = {name: ring.own(name).public.decode() for name in ring.names()}
        allowed = ring.allowed().keys
    if as_json:
        print_json(
            {"folder": str(ring.folder), "own": own, "allowed": [key.model_dump(mode="json") for key in allowed]}
        )
        return
    rows = [{"machine": name, "public key": key, "here": "own"} for name, key in own.items()]
    rows += [{"machine": key.name, "public key": key.public_key, "here": _standing(key)} for key in allowed]
    if rows:
        _print(rows)
    typer.echo(f"keys are in {ring.folder}" if rows else f"no key is in {ring.folder}: `telenano keys new NAME`")


@app.command()
def allow(
    name: NameArgument,
    key: Annotated[str, typer.Argument(metavar="KEY|FILE", help="Its public key (quoted), or its NAME.key file.")],
    role: Annotated[
        list[RoleName],
        typer.Option("--role", help="data: its messages are taken; control: its commands; observe (repeatable)."),
    ],
    folder: DirOption = None,
    as_json: JsonOption = False,
) -> None:
    """Let a machine in, or change what it may do; running nodes notice within a second."""
    with report_errors(as_json):
        roles: list[Role] = [entry.value for entry in role]
        entry = _ring(folder).allow(name, _public_key(key), roles)
    _tell(entry, f"{name} is allowed: {_standing(entry)}", as_json=as_json)


@app.command()
def revoke(
    name: Annotated[str, typer.Argument(metavar="NAME|KEY", help="Machine, or its public key (quoted).")],
    folder: DirOption = None,
    as_json: JsonOption = False,
) -> None:
    """Shut a key out for ever; running nodes close its connections within a second."""
    with report_errors(as_json):
        entry = _ring(folder).revoke(name)
    _tell(entry, f"the key {entry.public_key} of {entry.name} is revoked", as_json=as_json)


def _ring(folder: Path | None) -> Keyring:
    return Keyring(folder or keys_directory())


def _public_key(text: str) -> str:
    path = Path(text)
    if not path.name.endswith(".key"):
        return text
    try:
        public, _ = zmq.auth.load_certificate(path)
    except (OSError, ValueError) as error:
        raise ConfigError(f"{path}: holds no public key: {error}") from error
    return public.decode(errors="replace")


def _standing(key: AllowedKey) -> str:
    return "revoked" if key.revoked else ", ".join(key.roles)


def _tell(entry: AllowedKey, text: str, *, as_json: bool) -> None:
    if as_json:
        print_json(entry.model_dump(mode="json"))
    else:
        typer.echo(text)


def _print(rows: list[dict[str, Any]]) -> None:
    from telenano.live_view import rows_table

    console().print(rows_table(rows))
