"""Who may open the page of a rig, and what they may do there: tokens, roles, hosts and addresses."""

import hmac
import ipaddress
import os
import re
import secrets
from collections.abc import Sequence
from dataclasses import dataclass, field
from enum import StrEnum

from telenano.serving.people import People, Person
from telenano.wire.errors import ConfigError

LOOPBACK = "127.0.0.1"
OPERATOR_VARIABLE = "TELENANO_VIEW_OPERATOR_TOKEN"
OBSERVER_VARIABLE = "TELENANO_VIEW_OBSERVER_TOKEN"
PARTICIPANT_VARIABLE = "TELENANO_VIEW_PARTICIPANT_TOKEN"
_TOKEN_BYTES = 24
_LEAST_TOKEN = 16
# as browsers write it: no path, and null for a page that has none
_ORIGIN = re.compile(r"null|[a-z][a-z0-9+.-]*://[^/\s]*")


class Role(StrEnum):
    """What a page may do: all look and may stop, and who is more than an observer may have the hand.

    A pupil has it when it is handed over; an operator takes it when it is free, a teacher from anybody. A
    participant of an experiment presses, answers and stops, and sees nothing of the rig.
    """

    OBSERVER = "observer"
    PUPIL = "pupil"
    PARTICIPANT = "participant"
    OPERATOR = "operator"
    TEACHER = "teacher"


@dataclass(frozen=True)
class Access:
    """The tokens of the roles, the names by which the server may be addressed, and the networks that may connect.

    The names keep out pages of other servers that a resolver was made to map to this one (DNS rebinding).
    """

    operator_token: str
    observer_token: str
    hosts: tuple[str, ...] = (LOOPBACK, "localhost", "[::1]")
    networks: tuple[str, ...] = ("127.0.0.0/8", "::1/128")
    # further origins of web sockets; empty is that of a program, because a browser always names one
    origins: tuple[str, ...] = ()
    # empty where there is none
    participant_token: str = ""
    # those who were given an address by name
    people: People = field(default_factory=People)

    @classmethod
    def made(
        cls,
        *,
        operator: str = "",
        observer: str = "",
        participant: str = "",
        names: Sequence[str] = (),
        allow: Sequence[str] = (),
        origins: Sequence[str] = (),
    ) -> "Access":
        """Return the access to a server with further names, networks and origins; tokens not given are new ones.

        Raises: ConfigError for a token that could be guessed, and for an address that is none.
        """
        tokens = [token for token in (operator, observer, participant) if token]
        for token in tokens:
            if len(token) < _LEAST_TOKEN:
                raise ConfigError(f"a token of the view has {len(token)} characters, it must have {_LEAST_TOKEN}")
        if len(set(tokens)) < len(tokens):
            raise ConfigError("the tokens of two roles are the same: an observer or a participant could command")
        hosts, networks = (*cls.hosts, *names), (*cls.networks, *allow)
        for network in networks:
            try:
                ipaddress.ip_network(network)
            except ValueError as error:
                raise ConfigError(f"--allow {network}: is not an address or a network such as 10.0.0.0/24") from error
        for origin in filter(None, origins):
            if not _ORIGIN.fullmatch(origin):
                raise ConfigError(f"--allow-origin {origin}: is not of the form https://HOST, nor null")
        return cls(
            operator or secrets.token_urlsafe(_TOKEN_BYTES),
            observer or secrets.token_urlsafe(_TOKEN_BYTES),
            tuple(dict.fromkeys(hosts)),
            networks,
            tuple(origins),
            participant or secrets.token_urlsafe(_TOKEN_BYTES),
        )

    def role_of(self, token: str) -> Role | None:
        """Return the role that a token gives; None for an unknown one, in a time that does not depend on it."""
        token_bytes = token.encode()
        is_operator = hmac.compare_digest(token_bytes, self.operator_token.encode())
        is_observer = hmac.compare_digest(token_bytes, self.observer_token.encode())
        is_participant = hmac.compare_digest(token_bytes, self.participant_token.encode()) and bool(token_bytes)
        if is_operator:
            return Role.OPERATOR
        if is_participant:
            return Role.PARTICIPANT
        if is_observer:
            return Role.OBSERVER
        person = self.person_of(token)
        return Role(person.role) if person is not None and self.people.is_admitted(person) else None

    def person_of(self, token: str) -> Person | None:
        """Return who was given a token by name, also one that is no longer valid; None for any other token.

        Its digest is looked up, and a time that depends on a digest tells nothing of the token.
        """
        return self.people.find(token)

    def admits_address(self, address: str) -> bool:
        """Return whether the address that a connection comes from is in one of the networks."""
        try:
            parsed = ipaddress.ip_address(address)
        except ValueError:
            return False
        return any(parsed in ipaddress.ip_network(network) for network in self.networks)

    def admits_host(self, host: str) -> bool:
        """Return whether the Host of a request is a name of this server; its port does not matter."""
        name = host if host.endswith("]") or ":" not in host else host.rpartition(":")[0]
        return name in self.hosts

    def admits_origin(self, origin: str, host: str) -> bool:
        """Return whether the page that opens a web socket came from this very server, or from one that is named."""
        return origin in (f"http://{host}", f"https://{host}", *self.origins)


def is_loopback(host: str) -> bool:
    """Return whether a server that binds `host` can be reached from this machine only."""
    if host == "localhost":
        return True
    try:
        return ipaddress.ip_address(host.strip("[]")).is_loopback
    except ValueError:
        return False


def tokens_given() -> dict[str, str]:
    """Return the tokens that the environment names; a role without one gets a new one."""
    variables = {"operator": OPERATOR_VARIABLE, "observer": OBSERVER_VARIABLE, "participant": PARTICIPANT_VARIABLE}
    return {role: os.environ.get(variable, "") for role, variable in variables.items()}
