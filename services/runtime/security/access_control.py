"""What a process believes of the machines around it: its own key, the list as last read, and verdicts on both."""

from proto.errors import ConfigError
from services.runtime.address_book import AddressBook
from services.runtime.security.keyring import ROLES, AllowList, Keyring, Role


class AccessControl:
    """The keys of one machine in use; without them, in a rig that has none, everybody may do everything."""

    def __init__(self, machine: str, keyring: Keyring, *, locked: bool) -> None:
        """Read the keys of a machine if the rig is `locked`; ConfigError says what is wrong with them."""
        self.machine = machine
        self.keyring = keyring
        self.locked = locked
        self.own = keyring.own(machine) if locked else None
        self._allowed = keyring.allowed() if locked else AllowList()
        self._stamp = keyring.stamp() if locked else None

    @property
    def public_key(self) -> str:
        """The public key of this machine, empty in a rig without keys."""
        return "" if self.own is None else self.own.public.decode()

    def reload(self) -> bool:
        """Read the list again if it has changed, and say whether it has; ConfigError leaves the old one in force."""
        if not self.locked:
            return False
        stamp = self.keyring.stamp()
        if stamp == self._stamp:
            return False
        # first, so that what is wrong is said once
        self._stamp = stamp
        if stamp is None:
            raise ConfigError(f"{self.keyring.allowed_path}: is gone; to shut a machine out, `telenano keys revoke` it")
        self._allowed = self.keyring.allowed()
        return True

    def judge(self, public_key: str) -> tuple[str, str]:
        """Give the name of a key and, where it is refused, why: unlisted or revoked."""
        if public_key == self.public_key:
            return self.machine, ""
        entry = self._allowed.of_key(public_key)
        if entry is None:
            return "", "unlisted"
        return entry.name, "revoked" if entry.revoked else ""

    def server_key(self, machine: str) -> bytes | None:
        """Give the public key of a machine, None when it is not listed."""
        if machine == self.machine:
            return self.public_key.encode()
        entry = self._allowed.of_machine(machine)
        return None if entry is None else entry.public_key.encode()

    def roles(self, machine: str) -> tuple[Role, ...]:
        """Give what a machine may do here."""
        if not self.locked or machine == self.machine:
            return ROLES
        entry = self._allowed.of_machine(machine)
        return () if entry is None else entry.roles


def check_keys(book: AddressBook, machine: str, keyring: Keyring) -> None:
    """Raise ConfigError naming the command that helps, when a machine could not take part in a rig for want of keys."""
    if not book.locked:
        return
    keyring.own(machine)
    allowed = keyring.allowed()
    needed = {book.machine_of(node) for node in book.nodes if book.network_endpoint(node)} - {machine}
    missing = sorted(name for name in needed if allowed.of_machine(name) is None)
    if missing:
        commands = "; ".join(f"`telenano keys allow {name} KEY {_roles_needed(book, name)}`" for name in missing)
        raise ConfigError(
            f"{keyring.allowed_path}: the key of {', '.join(missing)} is not allowed here: {commands}, "
            "with the KEY that `telenano keys show` says there"
        )


def _roles_needed(book: AddressBook, machine: str) -> str:
    heard = [node for node in book.nodes if book.machine_of(node) == machine and book.network_endpoint(node)]
    commands = any("session/control" in book.published_by(node) for node in heard)
    return "--role data" + " --role control" * commands
