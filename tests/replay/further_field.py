"""Records reference sessions in a process whose node/health has a field more, and prints what is not as before.

python tests/replay/further_field.py machine    # the field is one that the machine of a node tells
python tests/replay/further_field.py node       # the node says it itself, also in virtual time
"""

import json
import sys
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Annotated

from telenano.wire import messages


class NodeHealth(messages.NodeHealth):
    """The health of a node with the number of its threads."""

    threads: Annotated[messages.Count | None, messages.about("Threads of the process")] = None


# Whatever is imported after this has the field, as if it stood in the module of the messages.
messages.NodeHealth = NodeHealth  # type: ignore[misc]

from references import REFERENCES, c_library, differences, digests_of, read_digests, record  # noqa: E402

from telenano.recording.reader import Recording  # noqa: E402
from telenano.runtime.loop.machine import OwnMachine  # noqa: E402
from telenano.virtual import machine as virtual_machine  # noqa: E402
from telenano.wire import TOPICS  # noqa: E402


def with_threads(health: object) -> object:
    """Return a method that tells what another one tells, and the number of threads."""

    def told(machine: object, processor_s: float, elapsed_s: float) -> dict[str, int | float]:
        return {**health(machine, processor_s, elapsed_s), "threads": 123_456}  # type: ignore[operator]

    return told


def main(teller: str) -> None:
    """Record all references, or those of a limited rate, and print in JSON what differs from their digests."""
    OwnMachine.health = with_threads(OwnMachine.health)  # type: ignore[method-assign,assignment]
    names = list(REFERENCES)
    if teller == "node":
        told = virtual_machine.VirtualMachine
        told.health = with_threads(told.health)  # type: ignore[method-assign,assignment]
        # Health crosses the link from the slave to the master.
        names = [
            name
            for name, row in REFERENCES.items()
            if "rate" in (row.forward if row.backward is None else row.backward)
        ]
    assert TOPICS["node/health"].model is NodeHealth
    library, kept = read_digests()
    found = {}
    for name in names:
        with TemporaryDirectory() as folder:
            recording = Recording(record(name, Path(folder)))
            said = [message.fields().get("threads") for message in recording.messages(("node/health",))]
            digests = digests_of(recording)
        changed = differences(kept[name], digests, same_bits=library == c_library())
        found[name] = {"reports": len(said), "with_threads": len([one for one in said if one]), "changed": changed}
    sys.stdout.write(json.dumps(found))


if __name__ == "__main__":
    main(sys.argv[1])
