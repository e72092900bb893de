"""Keys of the datagrams, and the sealing and opening of a datagram.

Both ends make an X25519 key pair for each run and each change of keys, and exchange the public halves over the
authenticated CURVE connection: a machine that cannot authenticate there cannot agree on a key here. HKDF-SHA256 over
the shared secret gives each direction its own key, so that no number is used twice with one key. A datagram is

    tag (4 bytes) | number (8 bytes) | ChaCha20-Poly1305 of the body, 16 bytes longer than the body

with the number as nonce, and the bytes before the body authenticated with it. The tag comes from the same derivation:
it identifies the key and lets the kernel drop datagrams of strangers. It is not secret.
"""

import struct
from typing import NamedTuple

from cryptography.exceptions import InvalidTag
from cryptography.hazmat.primitives.asymmetric.x25519 import X25519PrivateKey, X25519PublicKey
from cryptography.hazmat.primitives.ciphers.aead import ChaCha20Poly1305
from cryptography.hazmat.primitives.hashes import SHA256
from cryptography.hazmat.primitives.kdf.hkdf import HKDF

from telenano_wide_area.datagram.replay_window import WINDOW, ReplayWindow
from telenano_wide_area.sealed import RejectedError

HEADER = struct.Struct("!4sQ")
# A sealed datagram is longer than its body by this.
OVERHEAD_BYTES = HEADER.size + 16
TAG_BYTES = 4
_NUMBER_LIMIT = 2**63
# Twice the rate of a controller with the shortest period that its settings allow, with its reports [1/s].
_MOST_PER_S = 25_000
_PURPOSE = b"telenano link datagrams, version 1"
_KEY_BYTES = 32
_NONCE_HEAD = bytes(4)


class DirectionKeys(NamedTuple):
    """The key of one direction, and the tag with which its datagrams begin."""

    key: bytes
    tag: bytes


class KeyPair:
    """An ephemeral X25519 key pair."""

    def __init__(self) -> None:
        self._private = X25519PrivateKey.generate()
        self.public: bytes = self._private.public_key().public_bytes_raw()

    def agree(self, peer_public: bytes, *, is_master: bool) -> tuple[DirectionKeys, DirectionKeys]:
        """Return the keys for sending and for receiving; ValueError for a public key that gives no shared secret."""
        secret = self._private.exchange(X25519PublicKey.from_public_bytes(peer_public))
        salt = self.public + peer_public if is_master else peer_public + self.public
        length = 2 * (_KEY_BYTES + TAG_BYTES)
        derived = HKDF(algorithm=SHA256(), length=length, salt=salt, info=_PURPOSE).derive(secret)
        half = length // 2
        parts = (derived[:half], derived[half:])
        forward, backward = (DirectionKeys(part[:_KEY_BYTES], part[_KEY_BYTES:]) for part in parts)
        return (forward, backward) if is_master else (backward, forward)


class Sealer:
    """Seals datagrams with one key, numbered from 0."""

    def __init__(self, keys: DirectionKeys) -> None:
        self.number = 0
        self._tag = keys.tag
        self._encrypt = ChaCha20Poly1305(keys.key).encrypt

    def seal(self, body: bytes) -> bytes:
        """Return the datagram of a body, with the next number."""
        header = HEADER.pack(self._tag, self.number)
        self.number += 1
        return header + self._encrypt(_NONCE_HEAD + header[TAG_BYTES:], body, header)


class Opener:
    """Opens the datagrams under one key, each once."""

    def __init__(self, keys: DirectionKeys, now_ns: int) -> None:
        self.tag = keys.tag
        self._agreed_ns = now_ns
        self.window = ReplayWindow()
        self._decrypt = ChaCha20Poly1305(keys.key).decrypt

    def open(self, datagram: bytes, now_ns: int) -> tuple[int, bytes]:
        """Return number and body; RejectedError (`replayed`, `forged`, `ahead`) for a datagram that must not be used.

        The window is checked before the cipher, which costs more, and changed after it, so that a forger cannot move
        it. `ahead` is a number beyond the window that no sender can have reached since the keys were agreed.
        """
        header = datagram[: HEADER.size]
        _, number = HEADER.unpack(header)
        if number >= _NUMBER_LIMIT or not self.window.is_new(number):
            raise RejectedError("replayed")
        try:
            body = self._decrypt(_NONCE_HEAD + header[TAG_BYTES:], datagram[HEADER.size :], header)
        except InvalidTag:
            raise RejectedError("forged") from None
        if number - self.window.newest > WINDOW and number > self._most(now_ns):
            raise RejectedError("ahead")
        self.window.record(number)
        return number, body

    def _most(self, now_ns: int) -> int:
        return WINDOW + (now_ns - self._agreed_ns) * _MOST_PER_S // 1_000_000_000
