"""Liveness of nodes that run elsewhere: heartbeat timeouts and returns, on an injected clock."""

from collections.abc import Sequence
from dataclasses import dataclass

from telenano.timing.clock import Clock

# Silence after which a node counts as silent [s]; it publishes node/health twice a second.
NODE_TIMEOUT_S = 3.0
# Silence after which a whole site counts as silent [s]. It is shorter than that of a node, so that a pulled cable is
# reported as one silent site and not as one node after the other.
SITE_TIMEOUT_S = 2.0
# Time that the nodes of a returned site have to report [s]; a restarted site does not have all its nodes at once.
_RETURN_GRACE_S = 20.0


@dataclass(frozen=True)
class Change:
    """A node, or the site as a whole, fell silent or is alive again.

    `nodes`: the nodes concerned; `first`: the site was never alive before; `since_ns`: time of the last heartbeat
    before the silence, on the clock of message headers [ns]; `silence_s`: length of the silence so far [s].
    """

    subject: str
    nodes: tuple[str, ...]
    silent: bool
    since_ns: int
    silence_s: float
    first: bool = False


class LivenessMonitor:
    """Reports each liveness timeout once, and its end once; a timeout of all nodes of a site is one report."""

    def __init__(self, clock: Clock, nodes: Sequence[str], site: str = "") -> None:
        """Monitor each of `nodes` from its first heartbeat on; `site` is the name of the other site, empty if none."""
        self._clock = clock
        self._nodes = tuple(nodes)
        self.site = site
        self._last_seen_ns: dict[str, int] = {}
        self._silent_ns: dict[str, int] = {}
        self._site_seen = False
        self._returned_ns = self._grace_until_ns = 0

    def record(self, node: str) -> None:
        """Record a heartbeat; those of other nodes are ignored."""
        if node in self._nodes:
            self._last_seen_ns[node] = self._clock.monotonic_ns()

    @property
    def site_name(self) -> str:
        return f"the {self.site}'s site"

    @property
    def any_alive(self) -> bool:
        return any(node not in self._silent_ns for node in self._last_seen_ns) and not self.site_silent

    @property
    def site_silent(self) -> bool:
        """Whether the other site as a whole was alive before and is silent now."""
        return self.site_name in self._silent_ns

    @property
    def silent(self) -> list[str]:
        """The nodes that were alive before and are silent now, or the site if all of them are."""
        return list(self._silent_ns)

    def check(self) -> list[Change]:
        """Return the changes of liveness since the last call."""
        changes = self._check_site() if self.site and self._last_seen_ns else []
        if not self.site_silent:
            in_grace = self._clock.monotonic_ns() < self._grace_until_ns
            for node, last_seen_ns in self._last_seen_ns.items():
                if last_seen_ns >= self._returned_ns or not in_grace:
                    changes += self._check_one(node, (node,), last_seen_ns, NODE_TIMEOUT_S)
        return changes

    def _check_site(self) -> list[Change]:
        if not self._site_seen:
            self._site_seen = True
            return [Change(self.site_name, self._nodes, False, 0, 0.0, first=True)]
        changes = self._check_one(self.site_name, self._nodes, max(self._last_seen_ns.values()), SITE_TIMEOUT_S)
        if changes and changes[0].silent:
            # Nodes that were missing before are now part of the silent site.
            self._silent_ns = {self.site_name: self._silent_ns[self.site_name]}
        elif changes:
            self._returned_ns = max(self._last_seen_ns.values())
            self._grace_until_ns = self._returned_ns + round(_RETURN_GRACE_S * 1e9)
        return changes

    def _check_one(self, subject: str, nodes: tuple[str, ...], last_seen_ns: int, limit_s: float) -> list[Change]:
        silence_ns = self._clock.monotonic_ns() - last_seen_ns
        silent = silence_ns > limit_s * 1e9
        if silent == (subject in self._silent_ns):
            return []
        if silent:
            self._silent_ns[subject] = last_seen_ns
        else:
            since_ns = self._silent_ns.pop(subject)
            silence_ns, last_seen_ns = last_seen_ns - since_ns, since_ns
        return [Change(subject, nodes, silent, last_seen_ns + self._clock.epoch_offset_ns, silence_ns * 1e-9)]
