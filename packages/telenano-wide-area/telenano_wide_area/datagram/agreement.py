"""Which keys are in force at an end, and how both ends come to the same ones.

The master's end offers a public key, the slave's answers with its own: after that the slave can open what comes under
the pair, and once its answer is there the master seals with it. The slave goes over when the first such datagram has
come. What is under way with the keys before is opened for a moment longer. No pair of public keys is used twice: with
the same key the numbers would begin again.
"""

from telenano_wide_area.datagram.sealing import KeyPair, Opener, Sealer

REKEY_NS = 600 * 1_000_000_000
_GRACE_NS = 10_000_000_000


class Agreement:
    """The keys of one end."""

    def __init__(self, now_ns: int, *, is_master: bool) -> None:
        self.is_master = is_master
        self.sealer: Sealer | None = None
        self.openers: dict[bytes, Opener] = {}
        # It opens datagrams under the newest keys.
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
        """What the datagrams that may be opened begin with."""
        return list(self.openers)

    def hear(self, public: bytes, answers: bytes, now_ns: int) -> bool:
        """Take the public key of the other end and which one of this end it `answers`; return whether keys are new.

        Raises:
            ValueError: The public key gives no secret.
        """
        if public == self.peer_public:
            return False
        if self.is_master and answers != self.public:
            # The answer is for the offer of an earlier process, or is not one yet: the offer is repeated until it is.
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
        """Go over to the newest keys, once the other end has used them."""
        if self._waiting is not None and opener is self.opener:
            self.sealer, self._waiting = self._waiting, None

    def maintain(self, now_ns: int, *, silent: bool) -> bool:
        """Retire old keys, and offer new ones when it is time; return whether the tags or the offer have changed.

        Args:
            now_ns: The time now [ns].
            silent: Whether nothing comes under the keys so far: the other end may be a new process without them.
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
        """Forget every key: the other machine is no longer allowed."""
        self._renew(now_ns)
        self.sealer = self._waiting = self.opener = self._retire_ns = None
        self.openers, self.peer_public = {}, b""

    def _renew(self, now_ns: int) -> None:
        self._pair, self._made_ns = KeyPair(), now_ns
        self._used.clear()
