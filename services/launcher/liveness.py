"""Who of the nodes that are somebody else's has fallen silent, and who is heard again: bookkeeping on a clock."""

from collections.abc import Sequence
from dataclasses import dataclass

from services.runtime.clock import Clock

# node/health comes twice a second
NODE_SILENT_S = 3.0
# all of a site at once is told first, so that a cable is not told as a dead node after the other
SITE_SILENT_S = 2.0
# a site that was started anew does not have all its nodes at once
_RETURN_S = 20.0


@dataclass(frozen=True)
class Change:
    """Somebody fell silent, or is heard again.

    `nodes` are those concerned; `first` is a site that was never heard before. `since_ns` is when it was heard last
    before the silence, on the clock of message headers; `silence_s` is how long it has lasted.
    """

    who: str
    nodes: tuple[str, ...]
    silent: bool
    since_ns: int
    silence_s: float
    first: bool = False


class Watch:
    """Silence is told once, and once more when it is over. With a site, silence of all its nodes is told as one."""

    def __init__(self, clock: Clock, nodes: Sequence[str], site: str = "") -> None:
        """Watch `nodes` from the first time that each is heard; `site` is the other site, where there is one."""
        self._clock = clock
        self._nodes = tuple(nodes)
        self.site = site
        self._heard_ns: dict[str, int] = {}
        self._silent_ns: dict[str, int] = {}
        self._site_met = False
        self._returned_ns = self._lenient_until_ns = 0

    def enter(self, node: str) -> None:
        """Take a sign of life."""
        if node in self._nodes:
            self._heard_ns[node] = self._clock.monotonic_ns()

    @property
    def site_name(self) -> str:
        """Name of the other site, for a sentence."""
        return f"the {self.site}'s site"

    @property
    def heard(self) -> bool:
        """Somebody is heard, or was a moment ago."""
        return any(node not in self._silent_ns for node in self._heard_ns) and not self.site_silent

    @property
    def site_silent(self) -> bool:
        """The other site as a whole was heard once and is silent."""
        return self.site_name in self._silent_ns

    @property
    def silent(self) -> list[str]:
        """Who is silent that was heard before: nodes, or the site as a whole."""
        return list(self._silent_ns)

    def look(self) -> list[Change]:
        """Give what has changed since the last call."""
        changes = self._look_at_site() if self.site and self._heard_ns else []
        if not self.site_silent:
            lenient = self._clock.monotonic_ns() < self._lenient_until_ns
            for node, heard_ns in self._heard_ns.items():
                if heard_ns >= self._returned_ns or not lenient:
                    changes += self._judge(node, (node,), heard_ns, NODE_SILENT_S)
        return changes

    def _look_at_site(self) -> list[Change]:
        if not self._site_met:
            self._site_met = True
            return [Change(self.site_name, self._nodes, False, 0, 0.0, first=True)]
        changes = self._judge(self.site_name, self._nodes, max(self._heard_ns.values()), SITE_SILENT_S)
        if changes and changes[0].silent:
            # what was missing before is now part of the whole
            self._silent_ns = {self.site_name: self._silent_ns[self.site_name]}
        elif changes:
            self._returned_ns = max(self._heard_ns.values())
            self._lenient_until_ns = self._returned_ns + round(_RETURN_S * 1e9)
        return changes

    def _judge(self, who: str, nodes: tuple[str, ...], heard_ns: int, limit_s: float) -> list[Change]:
        silence_ns = self._clock.monotonic_ns() - heard_ns
        silent = silence_ns > limit_s * 1e9
        if silent == (who in self._silent_ns):
            return []
        if silent:
            self._silent_ns[who] = heard_ns
        else:
            since_ns = self._silent_ns.pop(who)
            silence_ns, heard_ns = heard_ns - since_ns, since_ns
        return [Change(who, nodes, silent, heard_ns + self._clock.epoch_offset_ns, silence_ns * 1e-9)]
