"""A relay that does with datagrams what it likes: drops, repeats, holds back, forges and floods."""

import random
import sys
from typing import Any

from telenano_wide_area.relay import server
from telenano_wide_area.relay.forwarder import Forwarder
from telenano_wide_area.relay.protocol import MAGIC

Address = tuple[Any, ...]
# shares of the datagrams, and how many others overtake one that is held back
DROPPED, REPEATED, HELD, FLOODED = 0.05, 0.2, 0.05, 0.1
OVERTAKEN_BY = 200
FORGED = 5


class HostileForwarder(Forwarder):
    """Carries most datagrams, and worse ones beside them."""

    def outgoing(self, datagram: bytes, address: Address) -> list[tuple[bytes, Address]]:
        """Return what is sent now that a datagram has come."""
        found = super().outgoing(datagram, address)
        if not found or datagram.startswith(MAGIC):
            return found
        draw = random.random()
        self.held: list[tuple[bytes, Address]] = getattr(self, "held", [])
        late = [self.held.pop(0)] if len(self.held) > OVERTAKEN_BY * HELD else []
        ((sealed, to),) = found
        if draw < DROPPED:
            return late
        if draw < DROPPED + REPEATED:
            return [*found, *found, *late]
        if draw < DROPPED + REPEATED + HELD:
            self.held += found
            return late
        if draw < DROPPED + REPEATED + HELD + FLOODED:
            forged = [(sealed[:12] + random.randbytes(len(sealed) - 12), to) for _ in range(FORGED)]
            return [*forged, (random.randbytes(300), to), *found, *late]
        return [*found, *late]


if __name__ == "__main__":
    server.Forwarder = HostileForwarder  # type: ignore[misc]
    from telenano.cli.app import main

    sys.argv[1:1] = ["relay"]
    main()
