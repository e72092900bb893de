"""Access control: the key of this machine, the list of allowed keys as last read, and the roles of each machine."""

from pathlib import Path

from telenano.runtime.security.keyring import ROLES, AllowedKey, AllowList, Keyring, Role, list_bytes
from telenano.wire.errors import ConfigError


class AccessControl:
    """The keys in use on one machine; in a rig that requires no keys, every machine has all roles."""

    def __init__(self, machine: str, keyring: Keyring | None = None, *, requires_keys: bool = True) -> None:
        """Read the keys of a machine if the rig requires keys.

        Args:
            machine: The machine.
            keyring: The folder of keys of the machine; None for that of this user.
            requires_keys: Whether the rig requires keys.

        Raises:
            ConfigError: The key of the machine is missing, invalid or expired, or the list of allowed keys is invalid.
        """
        self.machine = machine
        self.keyring = keyring = keyring or Keyring()
        self.requires_keys = requires_keys
        self.own = keyring.own_in_force(machine) if requires_keys else None
        self._allowed = keyring.allowed() if requires_keys else AllowList()
        self._stamp = keyring.stamp() if requires_keys else None
        self._expired = self._expired_keys()

    @property
    def public_key(self) -> str:
        """The public key of this machine, empty in a rig without keys."""
        return "" if self.own is None else self.own.public.decode()

    def held_files(self) -> dict[Path, bytes]:
        """Return the contents, as in force, of the key files that a process of this machine needs, by path."""
        if self.own is None:
            return {}
        pair = self.keyring.pair_bytes(self.machine, self.own)
        return {self.keyring.secret_path(self.machine): pair, self.keyring.allowed_path: list_bytes(self._allowed.keys)}

    def reload(self) -> bool:
        """Read the list of allowed keys again if its file has changed.

        Returns:
            Whether the list has changed, or a key in it has expired, since the last call.

        Raises:
            ConfigError: The list is invalid or no longer exists; the old one stays in force.
        """
        if not self.requires_keys:
            return False
        stamp = self.keyring.stamp()
        if stamp == self._stamp:
            before, self._expired = self._expired, self._expired_keys()
            return self._expired != before
        # The stamp is set first, so that an error is reported only once.
        self._stamp = stamp
        if stamp is None:
            raise ConfigError(
                f"{self.keyring.allowed_path}: no longer exists; to exclude a machine, use `telenano keys revoke`"
            )
        self._allowed = self.keyring.allowed()
        self._expired = self._expired_keys()
        return True

    def authorize(self, public_key: str) -> tuple[str, str]:
        """Return the machine of a key, and the reason why it may not subscribe: unlisted, revoked, expired or relay.

        The machine is empty for an unlisted key, and the reason is empty if the key may subscribe.
        """
        if public_key == self.public_key:
            return self.machine, ""
        entry = self._allowed.of_key(public_key)
        if entry is None:
            return "", "unlisted"
        if entry.revoked or self._has_expired(entry):
            return entry.name, "revoked" if entry.revoked else "expired"
        # A relay carries encrypted messages, and may not read them.
        return entry.name, "relay" if entry.roles == ("relay",) else ""

    def server_key(self, machine: str) -> bytes | None:
        """Return the public key of a machine, None if no valid one is listed."""
        if machine == self.machine:
            return self.public_key.encode()
        entry = self._in_force(machine)
        return None if entry is None else entry.public_key.encode()

    def roles(self, machine: str) -> tuple[Role, ...]:
        """Return the roles of a machine here; empty if no valid key of it is listed."""
        if not self.requires_keys or machine == self.machine:
            return ROLES
        entry = self._in_force(machine)
        return () if entry is None else entry.roles

    def why_not(self, machine: str) -> str:
        """Return the reason, in words, why no valid key of a machine is listed here."""
        entry = self._allowed.of_machine(machine)
        if entry is not None and self._has_expired(entry):
            return f"the key of {machine} in {self.keyring.allowed_path} expired at the end of {entry.expires} (UTC)"
        return f"no valid key of {machine} is in {self.keyring.allowed_path}"

    def _in_force(self, machine: str) -> AllowedKey | None:
        entry = self._allowed.of_machine(machine)
        return None if entry is None or self._has_expired(entry) else entry

    def _has_expired(self, entry: AllowedKey) -> bool:
        return entry.has_expired(self.keyring.today())

    def _expired_keys(self) -> list[str]:
        return [entry.public_key for entry in self._allowed.keys if self._has_expired(entry)]
