"""Access control: the key of this machine, the list of allowed keys as last read, and what each machine may do."""

from proto.errors import ConfigError
from services.runtime.bus.address_book import AddressBook
from services.runtime.security.keyring import ROLES, AllowList, Keyring, Role


class AccessControl:
    """The keys of one machine in use; in a rig that requires none, every machine may do everything."""

    def __init__(self, machine: str, keyring: Keyring, *, requires_keys: bool) -> None:
        """Read the keys of a machine if the rig requires keys; ConfigError when they are missing or invalid."""
        self.machine = machine
        self.keyring = keyring
        self.requires_keys = requires_keys
        self.own = keyring.own(machine) if requires_keys else None
        self._allowed = keyring.allowed() if requires_keys else AllowList()
        self._stamp = keyring.stamp() if requires_keys else None

    @property
    def public_key(self) -> str:
        """The public key of this machine, empty in a rig without keys."""
        return "" if self.own is None else self.own.public.decode()

    def reload(self) -> bool:
        """Read the list again if it has changed, and return whether it has; ConfigError leaves the old one in force."""
        if not self.requires_keys:
            return False
        stamp = self.keyring.stamp()
        if stamp == self._stamp:
            return False
        # The stamp is set first, so that an error is reported once.
        self._stamp = stamp
        if stamp is None:
            raise ConfigError(
                f"{self.keyring.allowed_path}: no longer exists; to exclude a machine, use `telenano keys revoke`"
            )
        self._allowed = self.keyring.allowed()
        return True

    def authorize(self, public_key: str) -> tuple[str, str]:
        """Return the machine that a key belongs to and, where it is rejected, why: unlisted or revoked."""
        if public_key == self.public_key:
            return self.machine, ""
        entry = self._allowed.of_key(public_key)
        if entry is None:
            return "", "unlisted"
        return entry.name, "revoked" if entry.revoked else ""

    def server_key(self, machine: str) -> bytes | None:
        """Return the public key of a machine, None when it is not listed."""
        if machine == self.machine:
            return self.public_key.encode()
        entry = self._allowed.of_machine(machine)
        return None if entry is None else entry.public_key.encode()

    def roles(self, machine: str) -> tuple[Role, ...]:
        """Return what a machine may do here."""
        if not self.requires_keys or machine == self.machine:
            return ROLES
        entry = self._allowed.of_machine(machine)
        return () if entry is None else entry.roles


def check_keys(book: AddressBook, machine: str, keyring: Keyring) -> None:
    """Raise ConfigError naming the command that helps when a machine lacks keys that it needs to take part in a rig."""
    if not book.requires_keys:
        return
    keyring.own(machine)
    allowed = keyring.allowed()
    needed = {book.machine_of(node) for node in book.nodes if book.network_endpoint(node)} - {machine}
    missing = sorted(name for name in needed if allowed.of_machine(name) is None)
    if missing:
        commands = "; ".join(f"`telenano keys allow {name} KEY {_roles_needed(book, name)}`" for name in missing)
        raise ConfigError(
            f"{keyring.allowed_path}: the key of {', '.join(missing)} is not allowed here: run {commands}, "
            "with the KEY that `telenano keys show` prints there"
        )


def _roles_needed(book: AddressBook, machine: str) -> str:
    published = [node for node in book.nodes if book.machine_of(node) == machine and book.network_endpoint(node)]
    commands = any("session/control" in book.published_by(node) for node in published)
    return "--role data" + " --role control" * commands
