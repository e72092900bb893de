"""The protocol between two sites and their relay, besides the bytes that it carries: keys, requests and answers.

Each pair of machines derives shared keys without an exchange: X25519 of the long-term CURVE keys that both have listed,
and HKDF-SHA256 for one key in each direction. Messages are sealed with ChaCha20-Poly1305 and a random nonce, and bound
to a challenge or a cookie of the other side, so that none can be replayed later or from elsewhere. The relay has none
of the keys of the data that it carries: CURVE and the keys of the datagrams are agreed between the sites.
"""

import json
import os
import struct
from typing import Any, NamedTuple

from cryptography.exceptions import InvalidTag
from cryptography.hazmat.primitives.asymmetric.x25519 import X25519PrivateKey, X25519PublicKey
from cryptography.hazmat.primitives.ciphers.aead import ChaCha20Poly1305
from cryptography.hazmat.primitives.hashes import SHA256
from cryptography.hazmat.primitives.kdf.hkdf import HKDF
from zmq.utils import z85

from telenano.runtime import AccessControl, KeyPair
from telenano.wire import ConfigError
from telenano_wide_area.sealed import RejectedError

# The name of the relay's machine, under which its key is listed, and of the role of that key.
RELAY = "relay"
# Every connection and every request begins with this.
MAGIC = b"tnrelay1"
CHALLENGE_BYTES = COOKIE_BYTES = 16
PUBLIC_BYTES = 32
# The contexts from which the keys between a site and the relay, and between two sites, are derived.
TO_RELAY = b"telenano relay, version 1"
TO_SITE = b"telenano sites behind a relay, version 1"
_NONCE_BYTES = 12
_KEY_BYTES = 32
# Magic, the tag with which the answers shall begin, cookie, public key.
_REQUEST = struct.Struct(f"!8s4s{COOKIE_BYTES}s{PUBLIC_BYTES}s")
# Requests are as long as the longest answer, so that a forged source address receives no more than was sent.
_BODY_BYTES = 192
REQUEST_BYTES = _REQUEST.size + _NONCE_BYTES + _BODY_BYTES + 16
# The byte after the tag of a datagram that is not a sample.
COOKIE = b"\x00"
ANSWER = b"\x01"
PING = b"\x02"
PONG = b"\x03"


class SharedKeys:
    """The keys that this machine shares with another machine."""

    def __init__(self, own: KeyPair, peer_public: bytes, purpose: bytes) -> None:
        """Derive the keys for one purpose; ValueError for a public key of 32 bytes that gives no shared secret."""
        mine = raw_key(own.public)
        private = X25519PrivateKey.from_private_bytes(raw_key(own.secret))
        secret = private.exchange(X25519PublicKey.from_public_bytes(peer_public))
        salt = b"".join(sorted((mine, peer_public)))
        derived = HKDF(algorithm=SHA256(), length=2 * _KEY_BYTES, salt=salt, info=purpose).derive(secret)
        first, second = ChaCha20Poly1305(derived[:_KEY_BYTES]), ChaCha20Poly1305(derived[_KEY_BYTES:])
        self._outgoing, self._incoming = (first, second) if mine < peer_public else (second, first)

    def seal(self, body: bytes, context: bytes) -> bytes:
        """Return nonce and cipher text, which can be opened with the same context only."""
        nonce = os.urandom(_NONCE_BYTES)
        return nonce + self._outgoing.encrypt(nonce, body, context)

    def open(self, sealed: bytes, context: bytes) -> bytes:
        """Return the body that the other machine sealed; RejectedError (`forged`) for anything else."""
        try:
            return self._incoming.decrypt(sealed[:_NONCE_BYTES], sealed[_NONCE_BYTES:], context)
        except (InvalidTag, ValueError):
            raise RejectedError("forged") from None


class Request(NamedTuple):
    """A request of an end for a place at the relay."""

    tag: bytes
    cookie: bytes
    public: bytes
    sealed: bytes

    @property
    def context(self) -> bytes:
        """The bytes to which the sealed parts of the request and of its answer are bound."""
        return self.tag + self.cookie


def raw_key(text: bytes) -> bytes:
    """Return the 32 bytes of a key that is given as Z85 text."""
    return bytes(z85.decode(text))


def key_text(raw: bytes) -> str:
    """Return a key of 32 bytes as Z85 text."""
    encoded: bytes = z85.encode(raw)
    return encoded.decode("ascii")


def relay_key(access: AccessControl) -> bytes:
    """Return the public key of the relay; ConfigError names the command that lists it."""
    key = access.server_key(RELAY) if RELAY in access.roles(RELAY) else None
    if key is None:
        raise ConfigError(
            f"{access.why_not(RELAY)} with the role relay: run `telenano keys allow {RELAY} KEY --role relay`, with "
            "the KEY that `telenano relay` shows where it runs"
        )
    return key


def pack(fields: dict[str, Any]) -> bytes:
    """Return the body of a sealed part with these fields."""
    return json.dumps(fields, separators=(",", ":")).encode()


def unpack(body: bytes) -> dict[str, Any]:
    """Return the fields of a sealed part; RejectedError (`malformed`) if it has none."""
    try:
        document = json.loads(body)
    except (ValueError, RecursionError):
        document = None
    if not isinstance(document, dict):
        raise RejectedError("malformed")
    return document


def make_request(
    keys: SharedKeys, tag: bytes, cookie: bytes, public: bytes, peer: bytes, *, direct: bool = True
) -> Request:
    """Return a request to be joined with the end at the machine with the key `peer`; b"" asks for no place.

    Without `direct` the other end does not learn the address of this one.
    """
    body = pack({"peer": peer.hex(), "direct": direct}).ljust(_BODY_BYTES)
    return Request(tag, cookie, public, keys.seal(body, tag + cookie))


def request_bytes(request: Request) -> bytes:
    """Return the datagram of a request."""
    return _REQUEST.pack(MAGIC, *request[:3]) + request.sealed


def parse_request(datagram: bytes) -> Request:
    """Return the request in a datagram; RejectedError (`malformed`) if it is none."""
    if len(datagram) != REQUEST_BYTES:
        raise RejectedError("malformed")
    _, tag, cookie, public = _REQUEST.unpack_from(datagram)
    return Request(tag, cookie, public, datagram[_REQUEST.size :])


def answer_bytes(keys: SharedKeys, request: Request, fields: dict[str, Any]) -> bytes:
    """Return the datagram of the answer to a request, which is no longer than the request."""
    return request.tag + ANSWER + keys.seal(pack(fields), request.context)


def split_host_port(text: str) -> tuple[str, int]:
    """Return host and port of `host:port`, an IPv6 address without its brackets; ValueError for anything else."""
    host, _, port = text.rpartition(":")
    if not host or not port.isdecimal() or not 1 <= int(port) <= 65535:
        raise ValueError(f"{text} is not of the form host:port")
    return host.strip("[]"), int(port)
