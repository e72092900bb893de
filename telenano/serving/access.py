"""Access control of a rig's page: tokens, roles, host names and addresses."""

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
# An origin as browsers send it: without a path, or null for a page without an origin.
_ORIGIN = re.compile(r"null|[a-z][a-z0-9+.-]*://[^/\s]*")


class Role(StrEnum):
    """Role of a page: all of them may stop the rig, and an operator may hold control.

    A participant of an experiment presses, answers and stops, and sees nothing of the rig.
    """

    OBSERVER = "observer"
    PARTICIPANT = "participant"
    OPERATOR = "operator"


@dataclass(frozen=True)
class Access:
    """Tokens of the roles, host names of the server, and networks that may connect.

    Checking the host names keeps out pages of other servers whose name was made to resolve to this one (DNS rebinding).
    """

    operator_token: str
    observer_token: str
    hosts: tuple[str, ...] = (LOOPBACK, "localhost", "[::1]")
    networks: tuple[str, ...] = ("127.0.0.0/8", "::1/128")
    # Further origins of web sockets; an empty one admits programs, because only browsers always send an origin.
    origins: tuple[str, ...] = ()
    # Empty if there is none.
    participant_token: str = ""
    # People with an address of their own.
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
        """Return the access to a server with further names, networks and origins; missing tokens are generated.

        Raises ConfigError for a token that is too short or not unique, and for an invalid network or origin.
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
        """Return the role of a token; None for an unknown one. The time does not depend on the token."""
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
        """Return the person of a personal token, even one that is no longer valid; None for any other token.

        The token is looked up by its digest, so the time of the search reveals nothing about the token.
        """
        return self.people.find(token)

    def admits_address(self, address: str) -> bool:
        """Return whether the remote address of a connection is in one of the networks."""
        try:
            parsed = ipaddress.ip_address(address)
        except ValueError:
            return False
        return any(parsed in ipaddress.ip_network(network) for network in self.networks)

    def admits_host(self, host: str) -> bool:
        """Return whether the Host header of a request is a name of this server, whatever the port."""
        name = host if host.endswith("]") or ":" not in host else host.rpartition(":")[0]
        return name in self.hosts

    def admits_origin(self, origin: str, host: str, *, encrypted: bool = False) -> bool:
        """Return whether the page that opens a web socket came from this server or from an allowed origin.

        `encrypted`: whether the connection is by https, to this server or to a proxy of this machine. A page of another
        scheme is of another origin, although its host and port are the same.
        """
        return origin in (f"{'https' if encrypted else 'http'}://{host}", *self.origins)


def is_loopback(host: str) -> bool:
    """Return whether a server that binds `host` can be reached only from this machine."""
    if host == "localhost":
        return True
    try:
        return ipaddress.ip_address(host.strip("[]")).is_loopback
    except ValueError:
        return False


def tokens_given() -> dict[str, str]:
    """Return the tokens in the environment by role; empty for a role without one."""
    variables = {"operator": OPERATOR_VARIABLE, "observer": OBSERVER_VARIABLE, "participant": PARTICIPANT_VARIABLE}
    return {role: os.environ.get(variable, "") for role, variable in variables.items()}
