"""One end of a rig's network as a process: publishes as a node, reads another node, and counts received messages.

python damaged_peer.py BOOK MACHINE KEYS NODE READS HEARD

It runs until its standard input ends, and creates the file HEARD when it has received a message.
"""

import json
import select
import sys
import time
from pathlib import Path

from telenano.runtime.bus.address_book import AddressBook
from telenano.runtime.security.keyring import Keyring
from telenano.runtime.wiring.transport import Transport, open_context
from telenano.testing import payload
from telenano.timing.clock import SystemClock

TOPIC_OF = {"afm_node@slave": "afm/state", "delay_node@slave": "teleop/forward"}
SOURCE_OF = {"delay_node@slave": "controller@master"}
_TURN_S = 0.002


def main(book_file: str, machine: str, keys: str, node: str, read: str, heard: str) -> None:
    """Publish and read until standard input ends, then print the counts as a line of JSON."""
    book, clock = AddressBook.load(Path(book_file)), SystemClock()
    context = open_context(serves_network=True)
    network = Transport(context, clock, book, machine, Keyring(Path(keys)))
    publisher = network.publisher(node)
    readers = network.subscribers({read: [TOPIC_OF[read]]})
    received = sent = 0
    last_s, longest_s = time.monotonic(), 0.0
    while not select.select([sys.stdin], [], [], _TURN_S)[0]:
        publisher.send(TOPIC_OF[node], payload(TOPIC_OF[node], SOURCE_OF.get(node, node), sent))
        sent += 1
        network.process_events()
        if messages := [one for reader in readers for one in reader.receive()]:
            received += len(messages)
            longest_s = max(longest_s, time.monotonic() - last_s)
            last_s = time.monotonic()
            Path(heard).touch()
    rejected = [network.rejected, *(reader.rejected for reader in readers)]
    facts = {"sent": sent, "received": received, "longest_s": longest_s, "rejected": rejected}
    sys.stdout.write(json.dumps(facts) + "\n")
    for reader in readers:
        reader.close()
    publisher.close()
    network.close()
    context.destroy(linger=0)


if __name__ == "__main__":
    main(*sys.argv[1:])
