"""The keyring of a machine: its own CURVE key pairs, and the list of allowed keys with the roles of each.

A machine has one key pair for all its nodes, named after the machine in the site file. Keys and list are in one folder,
which only its owner can read.
"""

import os
import re
import struct
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from datetime import UTC, date, datetime
from pathlib import Path
from typing import Annotated, Literal, NamedTuple, Self

import yaml
import zmq
from pydantic import AfterValidator, BeforeValidator, Field, model_validator
from zmq.utils import z85

from telenano.files.atomic_files import changed, locked, write_whole
from telenano.files.held_files import listed
from telenano.runtime.bus.address_book import MACHINE_PATTERN
from telenano.runtime.security.private_files import check_folder_of_files, read_secret, read_trusted
from telenano.settings.config import Settings, parse_yaml, validate
from telenano.wire.errors import ConfigError

KEYS_DIRECTORY_VARIABLE = "TELENANO_KEYS_DIR"
MACHINE_VARIABLE = "TELENANO_MACHINE"
ALLOWED_NAME = "allowed.yaml"
_PUBLIC_SUFFIX = ".key"
_SECRET_SUFFIX = ".key_secret"
_OTHERS = 0o077
# A certificate in the format of ZeroMQ's tools (ZPL).
_CERTIFICATE = "# ZeroMQ CURVE {kind} certificate of the machine {name}\nmetadata\ncurve\n"
_NAMED = re.compile(rb"certificate of the machine ([^\s]+)")
# A key that expires within this number of days causes a warning before a rig is started.
EXPIRES_SOON_DAYS = 14

Role = Literal["data", "control", "observe", "relay"]
# The roles of a machine at itself; the role relay is for carrying messages of others.
ROLES: tuple[Role, ...] = ("data", "control", "observe")
_KEY_LENGTH = 40


def _check_key(text: str) -> str:
    try:
        valid = len(text) == _KEY_LENGTH and bool(z85.decode(text))
    # The decoder raises these for characters, and for values, that do not exist in Z85.
    except (KeyError, ValueError, struct.error):
        valid = False
    if not valid:
        raise ValueError(f"is not a public key, which has {_KEY_LENGTH} characters of Z85 (`telenano keys show`)")
    return text


def _as_day(value: object) -> object:
    try:
        return date.fromisoformat(value) if isinstance(value, str) else value
    except ValueError as error:
        raise ValueError(f"{value} is not a date such as 2027-06-30") from error


PublicKey = Annotated[str, AfterValidator(_check_key)]
Day = Annotated[date, BeforeValidator(_as_day)]


class KeyPair(NamedTuple):
    """A CURVE key pair as Z85 text, and the last day (UTC) on which it is used; None for one that does not expire."""

    public: bytes
    secret: bytes
    expires: date | None = None


class AllowedKey(Settings):
    """A key of another machine and what it may do here; every valid key with more than the role relay may observe."""

    name: Annotated[str, Field(pattern=MACHINE_PATTERN)] = Field(description="Machine that the key belongs to")
    public_key: PublicKey = Field(description="Its public key, 40 characters of Z85")
    roles: tuple[Role, ...] = Field(
        min_length=1,
        description="data: its measurements and references are accepted; control: its commands; observe; relay: it may "
        "use the relay here, or is the relay",
    )
    revoked: bool = Field(default=False, description="The key is rejected permanently")
    expires: Day | None = Field(default=None, description="Last day (UTC) on which the key is accepted, if any")

    def has_expired(self, today: date) -> bool:
        """Return whether the key is no longer accepted because its last day is over."""
        return self.expires is not None and today > self.expires


class AllowList(Settings):
    """The keys that are known at this machine."""

    keys: tuple[AllowedKey, ...] = Field(default=(), description="One entry a key")

    @model_validator(mode="after")
    def _check_unique(self) -> Self:
        valid = [key.name for key in self.keys if not key.revoked]
        for values, what in ((valid, "name"), ([key.public_key for key in self.keys], "public_key")):
            twice = next((value for value in values if values.count(value) > 1), None)
            if twice is not None:
                raise ValueError(f"keys: {what} {twice} is given twice")
        return self

    def of_machine(self, name: str) -> AllowedKey | None:
        """Return the valid key of a machine, None if it has none."""
        return next((key for key in self.keys if key.name == name and not key.revoked), None)

    def of_key(self, public_key: str) -> AllowedKey | None:
        """Return the entry of a key, revoked or not; None when it is not listed."""
        return next((key for key in self.keys if key.public_key == public_key), None)


def utc_today() -> date:
    """Return the current day in UTC, by the machine's clock, for checking the expiry of keys."""
    return datetime.now(UTC).date()


def keys_directory() -> Path:
    """Return the folder of keys: TELENANO_KEYS_DIR, or `telenano/keys` in the user's configuration folder."""
    named = os.environ.get(KEYS_DIRECTORY_VARIABLE)
    if named:
        return Path(named)
    base = os.environ.get("XDG_CONFIG_HOME")
    return (Path(base) if base else Path.home() / ".config") / "telenano" / "keys"


class Keyring:
    """The folder of keys of one machine.

    Its methods raise ConfigError, which names the file at fault and the command that helps.
    """

    def __init__(self, folder: Path | None = None, today: Callable[[], date] = utc_today) -> None:
        self.folder = folder or keys_directory()
        self.allowed_path = self.folder / ALLOWED_NAME
        self.today = today

    def names(self) -> list[str]:
        try:
            return sorted(path.name.removesuffix(_SECRET_SUFFIX) for path in listed(self.folder, _SECRET_SUFFIX))
        except OSError as error:
            raise ConfigError(f"{self.folder}: cannot be read: {error.strerror}") from error

    def own(self, name: str) -> KeyPair:
        """Return the key pair of a machine; raise ConfigError also if other users can read its file."""
        path = self.secret_path(name)
        hint, again = (f"`telenano keys new {name}{option}` creates one" for option in ("", " --replace"))
        try:
            data = read_secret(path)
        except FileNotFoundError as error:
            raise ConfigError(f"{path}: there is no key for the machine {name}: {hint}") from error
        except OSError as error:
            raise ConfigError(f"{path}: cannot be read: {error.strerror}") from error
        public, secret = keys_in(data)
        if not _is_key_pair(public, secret):
            raise ConfigError(f"{path}: contains no valid key pair: {again}")
        return KeyPair(public, secret, expiry_in(data, path))

    def secret_path(self, name: str) -> Path:
        """Return the path of the file with both halves of a machine's key pair."""
        return self.folder / f"{name}{_SECRET_SUFFIX}"

    def own_in_force(self, name: str) -> KeyPair:
        """Return the key pair of a machine as `own` does; raise ConfigError also if it has expired."""
        pair = self.own(name)
        if pair.expires is not None and self.today() > pair.expires:
            raise ConfigError(
                f"{self.folder / name}{_SECRET_SUFFIX}: the key of {name} expired at the end of {pair.expires} (UTC): "
                f"`telenano keys new {name} --replace` creates a new one, which the other machines must allow"
            )
        return pair

    def expiring(self) -> list[str]:
        """Return a sentence for each key of this folder that has expired, or expires within EXPIRES_SOON_DAYS."""
        today = self.today()
        own = [(f"the key of this machine, {name},", self.own(name).expires) for name in self.names()]
        others = [(f"the key of {key.name}", key.expires) for key in self.allowed().keys if not key.revoked]
        return [
            f"{what} {'expired' if expires < today else 'expires'} at the end of {expires} (UTC)"
            for what, expires in (*own, *others)
            if expires is not None and (expires - today).days <= EXPIRES_SOON_DAYS
        ]

    def create(self, name: str, *, replace: bool = False, expires: date | None = None) -> KeyPair:
        """Create the key pair of a machine; raise ConfigError if there is one already, unless `replace`."""
        _check_name(name)
        path = self.secret_path(name)
        pair = KeyPair(*zmq.curve_keypair())
        # A key that begins with a dash would be parsed as an option on a command line.
        while pair.public.startswith(b"-"):
            pair = KeyPair(*zmq.curve_keypair())
        pair = pair._replace(expires=expires)
        with self._folder_for_writing(), locked(self.allowed_path):
            if not replace and path.exists():
                raise ConfigError(
                    f"{path} already exists: --replace creates a new key, which the other machines must allow"
                )
            write_whole(path, self.pair_bytes(name, pair))
            public_path = path.with_suffix(_PUBLIC_SUFFIX)
            write_whole(public_path, _certificate("public", name, pair))
        return self.own(name)

    @staticmethod
    def pair_bytes(name: str, pair: KeyPair) -> bytes:
        """Return the content of the file with both halves of a key pair."""
        return _certificate("secret", name, pair) + f'    secret-key = "{pair.secret.decode()}"\n'.encode()

    def misplaced(self, name: str) -> str:
        """Return the reason why the secret in a machine's file does not fit its name; empty if none is found."""
        path = self.folder / f"{name}{_SECRET_SUFFIX}"
        own = self.own(name).public
        named = _NAMED.search(read_secret(path))
        if named is not None and named[1] != name.encode():
            made_for = named[1].decode(errors="replace")
            return f"{path} holds the secret of {made_for}, and by its name it should be that of {name}"
        holder = self.allowed().of_key(own.decode())
        if holder is not None and holder.name != name:
            return f"{path} holds a key that {self.allowed_path} lists as that of {holder.name}, and not of {name}"
        try:
            public, _ = keys_in(read_trusted(path.with_suffix(_PUBLIC_SUFFIX)))
        except (OSError, ConfigError):
            return ""
        if public and public != own:
            return f"{path} and {path.with_suffix(_PUBLIC_SUFFIX).name} beside it hold different keys"
        return ""

    def allowed(self) -> AllowList:
        """Return the list of allowed keys, empty without a file; raise ConfigError also if others can change it."""
        try:
            data = read_trusted(self.allowed_path)
        except FileNotFoundError:
            return AllowList()
        except OSError as error:
            raise ConfigError(f"{self.allowed_path}: cannot be read: {error.strerror}") from error
        return self._parsed(data)

    def allow(self, name: str, public_key: str, roles: Sequence[Role], expires: date | None = None) -> AllowedKey:
        """Add a key, or change roles and expiry of a listed one; an expired key of the machine is replaced."""
        _check_name(name)
        fields = {"name": name, "public_key": public_key, "roles": list(dict.fromkeys(roles)), "expires": expires}
        entry = validate(AllowedKey, fields, f"key of {name}")

        def with_entry(known: AllowList) -> list[AllowedKey]:
            listed, holder = known.of_key(public_key), known.of_machine(name)
            gone = listed
            if holder is not None and holder is not listed and holder.has_expired(self.today()):
                gone, holder = holder, None
            if listed is not None and listed.revoked:
                raise ConfigError(f"{public_key} was revoked permanently: create a new key on {name}")
            if listed is not None and listed.name != name:
                raise ConfigError(f"{public_key} is already allowed, as {listed.name}")
            if holder is not None and holder.public_key != public_key:
                raise ConfigError(f"{name} is already listed with another key: run `telenano keys revoke {name}` first")
            return [*(key for key in known.keys if key not in (listed, gone)), entry]

        self._change(with_entry)
        return entry

    def revoke(self, name_or_key: str) -> AllowedKey:
        """Revoke the key of a machine, or a key itself; running nodes apply the change within a second."""
        revoked: list[AllowedKey] = []

        def without_entry(known: AllowList) -> list[AllowedKey]:
            entry = known.of_machine(name_or_key) or known.of_key(name_or_key)
            if entry is None:
                listed = ", ".join(key.name for key in known.keys if not key.revoked) or "none"
                raise ConfigError(f"{self.allowed_path}: there is no key of {name_or_key}, listed keys are {listed}")
            revoked.append(entry.model_copy(update={"revoked": True}))
            return [revoked[0] if key is entry else key for key in known.keys]

        self._change(without_entry)
        return revoked[0]

    def stamp(self) -> tuple[int, int] | None:
        """Return a value that changes with the file of the list, None while there is no file."""
        try:
            status = self.allowed_path.stat()
        except FileNotFoundError:
            return None
        except OSError as error:
            return error.errno or 0, 0
        return status.st_mtime_ns, status.st_ino

    def _change(self, step: Callable[[AllowList], Sequence[AllowedKey]]) -> None:
        """Change the list; `step` gets its newest entries, because another command may have changed it meanwhile."""

        def changed_bytes(before: bytes | None) -> bytes:
            return list_bytes(step(AllowList() if before is None else self._parsed(before)))

        # The file is replaced atomically, because a running node may read it at any moment.
        with self._folder_for_writing():
            changed(self.allowed_path, changed_bytes, read=read_trusted)

    def _parsed(self, data: bytes) -> AllowList:
        return validate(AllowList, parse_yaml(data, str(self.allowed_path)), str(self.allowed_path))

    @contextmanager
    def _folder_for_writing(self) -> Iterator[None]:
        """Make the folder, readable by this user alone; raise ConfigError if it or a file in it cannot be written."""
        before = os.umask(_OTHERS)
        try:
            self.folder.mkdir(mode=0o700, parents=True, exist_ok=True)
            check_folder_of_files(self.folder)
            yield
        except OSError as error:
            raise ConfigError(f"{self.folder}: cannot be written: {error.strerror}") from error
        finally:
            os.umask(before)


def list_bytes(keys: Sequence[AllowedKey]) -> bytes:
    """Return the content of the file of a list of allowed keys."""
    ordered = sorted(keys, key=lambda key: key.name)
    document = {"keys": [key.model_dump(mode="json", exclude_none=True) for key in ordered]}
    return yaml.safe_dump(document, sort_keys=False, width=120).encode()


def this_machine(keyring: Keyring) -> str:
    """Return the machine on which this process runs, for programs that are no node of the site file.

    It is TELENANO_MACHINE, else the machine whose key is in the keyring, `master` if there are several keys or none.
    """
    named = os.environ.get(MACHINE_VARIABLE)
    if named:
        if not re.fullmatch(MACHINE_PATTERN, named):
            raise ConfigError(f"environment variable {MACHINE_VARIABLE} is {named!r}, must be a name such as master")
        return named
    names = keyring.names()
    return names[0] if len(names) == 1 else "master"


def keys_in(data: bytes) -> tuple[bytes, bytes]:
    """Return the public and the secret key of a certificate; a missing one is empty."""
    lines = (line.strip().partition(b"=") for line in data.splitlines())
    values = {name.strip(): value.strip(b" \t'\"") for name, sign, value in lines if sign}
    return values.get(b"public-key", b""), values.get(b"secret-key", b"")


def expiry_in(data: bytes, path: Path) -> date | None:
    """Return the last day of a certificate, None if it has none; raise ConfigError if it is no date."""
    match = re.search(rb'^\s*expires\s*=\s*"([^"]*)"', data, re.M)
    if match is None:
        return None
    try:
        return date.fromisoformat(match[1].decode())
    except ValueError as error:
        raise ConfigError(f"{path}: expires is {match[1]!r}, must be a date such as 2027-06-30") from error


def key_text(raw: bytes) -> str:
    """Return a key of 32 bytes as Z85 text."""
    encoded: bytes = z85.encode(raw)
    return encoded.decode("ascii")


def _certificate(kind: str, name: str, pair: KeyPair) -> bytes:
    expires = "" if pair.expires is None else f'    expires = "{pair.expires}"\n'
    text = _CERTIFICATE.format(kind=kind, name=name) + f'    public-key = "{pair.public.decode()}"\n' + expires
    return text.encode()


def _check_name(name: str) -> None:
    if not re.fullmatch(MACHINE_PATTERN, name):
        raise ConfigError(
            f"{name!r} is not a valid machine name: lower-case letters, digits and _, a letter first, 32 at most"
        )


def _is_key_pair(public: bytes, secret: bytes) -> bool:
    try:
        return bool(secret) and zmq.curve_public(secret) == public
    except (zmq.ZMQError, ValueError, UnicodeDecodeError):
        return False
