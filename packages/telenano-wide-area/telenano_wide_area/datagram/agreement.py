"""Key agreement: the keys in force at an end, and the exchange by which both ends change to new ones.

The master's end offers a public key, and the slave's end answers with its own. From then on the slave opens datagrams
under the new pair; when the answer arrives, the master seals with it, and the slave follows when the first such
datagram arrives. Datagrams in transit under the previous keys are opened for a short time longer. No pair of public
keys is used twice, because sequence numbers begin at 0 again and would repeat under the same key.
"""

from telenano_wide_area.datagram.sealing import KeyPair, Opener, Sealer

REKEY_NS = 600 * 1_000_000_000
_GRACE_NS = 10_000_000_000


class Agreement:
    """The keys of one end: `sealer` for sending, `openers` by tag for receiving."""

    def __init__(self, now_ns: int, *, is_master: bool) -> None:
        self.is_master = is_master
        self.sealer: Sealer | None = None
        self.openers: dict[bytes, Opener] = {}
        # The opener of the newest keys.
        self.opener: Opener | None = None
        self.peer_public = b""
        self._pair = KeyPair()
        self._used: set[bytes] = set()
        self._waiting: Sealer | None = None
        self._made_ns = now_ns
        self._retire_ns: int | None = None

    @property
    def public(self) -> bytes:
        """The public key to offer."""
        return self._pair.public

    @property
    def tags(self) -> list[bytes]:
        """The tags with which datagrams that can be opened begin."""
        return list(self.openers)

    def hear(self, public: bytes, answers: bytes, now_ns: int) -> bool:
        """Handle the other end's public key and the key of this end that it `answers`; return whether keys are new.

        Raises:
            ValueError: The public key gives no shared secret.
        """
        if public == self.peer_public:
            return False
        if self.is_master and answers != self.public:
            # This answers the offer of an earlier process, or is no answer yet; the offer is repeated until one comes.
            return False
        if public in self._used or (not self.is_master and self.peer_public):
            self._renew(now_ns)
            if self.is_master:
                return False
        outgoing, incoming = self._pair.agree(public, is_master=self.is_master)
        self._used.add(public)
        self.peer_public = public
        self.opener = Opener(incoming, now_ns)
        self.openers = {key: opener for key, opener in list(self.openers.items())[-1:]}
        self.openers[incoming.tag] = self.opener
        self._retire_ns = now_ns + _GRACE_NS
        if self.is_master or self.sealer is None:
            self.sealer, self._waiting = Sealer(outgoing), None
        else:
            self._waiting = Sealer(outgoing)
        return True

    def opened(self, opener: Opener) -> None:
        """Change to sealing with the newest keys, once the other end has used them."""
        if self._waiting is not None and opener is self.opener:
            self.sealer, self._waiting = self._waiting, None

    def maintain(self, now_ns: int, *, silent: bool) -> bool:
        """Retire old keys and offer new ones when they are due; return whether the tags or the offer have changed.

        Args:
            now_ns: The time now [ns].
            silent: Whether no datagram arrives under the present keys: the other end may be a new process without them.
        """
        changed = False
        if silent and self._waiting is not None:
            self.sealer, self._waiting = self._waiting, None
        if self._retire_ns is not None and now_ns >= self._retire_ns and self.opener is not None:
            self._retire_ns = None
            if self._waiting is not None:
                self.sealer, self._waiting = self._waiting, None
            self.openers = {self.opener.tag: self.opener}
            changed = True
        if self.is_master and self.peer_public and now_ns - self._made_ns >= REKEY_NS:
            self._renew(now_ns)
            changed = True
        return changed

    def forget(self, now_ns: int) -> None:
        """Forget all keys, because the other machine is no longer allowed."""
        self._renew(now_ns)
        self.sealer = self._waiting = self.opener = self._retire_ns = None
        self.openers, self.peer_public = {}, b""

    def _renew(self, now_ns: int) -> None:
        self._pair, self._made_ns = KeyPair(), now_ns
        self._used.clear()
