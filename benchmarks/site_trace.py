"""How long each turn takes in a process of several nodes, by the node and what brought it, for `loop.py`.

`traced_node/sitecustomize.py` installs it in the process of a site, as it does `hop_trace` in that of a node.
"""

import functools
import statistics
import time
from collections import defaultdict
from collections.abc import Callable

from telenano.runtime.loop.log import StructuredLog
from telenano.runtime.site.site_loop import Member, SiteLoop

# These are ten seconds of a kind of turn that comes six times a tick.
_MOST_TRACED = 60_000


def install() -> Callable[[], None]:
    """Time every turn of this process from now on; return what writes the medians [us] to its log."""
    spent_ns: dict[str, list[int]] = defaultdict(list)
    keys: list[str] = []
    take = SiteLoop.take

    @functools.wraps(take)
    def timed(site: SiteLoop, member: Member) -> None:
        near = [row[2] for reader in member.bus.near for row in reader.inbox]
        brought = near[-1] if near else "a socket" if member.bus.asked else "its deadline"
        begun_ns = time.perf_counter_ns()
        take(site, member)
        spent = spent_ns[f"{member.key}, by {brought}"]
        if len(spent) < _MOST_TRACED:
            spent.append(time.perf_counter_ns() - begun_ns)
        keys[:] = list(site.members)

    def write() -> None:
        rows = {name: [len(ns), statistics.median(ns) * 1e-3] for name, ns in sorted(spent_ns.items())}
        StructuredLog(keys[0] if keys else "site").info("turns of this process: number, median [us]", turns=rows)

    SiteLoop.take = timed  # type: ignore[method-assign]
    return write
