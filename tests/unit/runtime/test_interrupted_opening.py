"""A command that is interrupted while it opens its part in the bus still exits: no socket is waited for in vain.

An interruption can arrive between any two lines, and the command line lets no garbage be collected before the process
exits. What such a line had opened is then closed by the garbage collector, in whatever order it finds things.
"""

import subprocess
import sys
from pathlib import Path

import pytest

OPENERS = {
    "observer": "from telenano.runtime.wiring.observer import Observer; make = Observer",
    "messages of a page": "from services.viz_node.live import LiveSource; make = lambda book: LiveSource(book, 'rig')",
    "messages of a recorder": "from telenano.console.live_recording import LiveRecording; make = LiveRecording",
    "console": """
def make(book):
    with Participant.open("console@master", book) as participant:
        participant.bind("console@master")
        participant.subscribers(book.sources("console@master", ["session/event", "node/health"]))
""",
}
# A process, because a context that waits for a socket cannot be interrupted.
CODE = """
import gc, sys
from telenano.runtime.bus.address_book import AddressBook
from telenano.runtime.wiring.participant import Participant

folder, every = sys.argv[1], int(sys.argv[2])
nodes = ("haptic_node@master", "afm_node@slave", "delay_node@master", "delay_node@slave", "controller@master",
         "controller@slave", "console@master")
book = AddressBook(nodes={node: f"ipc://{folder}/{node}" for node in nodes})
gc.disable()
{opener}

def interrupted_at(step):
    count = 0

    def trace(frame, event, argument):
        nonlocal count
        if not frame.f_globals.get("__name__", "").startswith("telenano."):
            return None
        count += event == "line"
        if count == step:
            sys.settrace(None)
            raise KeyboardInterrupt
        return trace

    sys.settrace(trace)
    try:
        made = make(book)
    except KeyboardInterrupt as error:
        # As what reports an interruption, it refers to itself, so that only the collector ends it.
        error.itself = error
        return True
    finally:
        sys.settrace(None)
    if made is not None:
        made.close()
    return False

step = 1
while interrupted_at(step):
    gc.collect()
    step += every
print(step)
"""


@pytest.mark.check("takes 2.3 s")
@pytest.mark.drawn(0.3)
@pytest.mark.parametrize("opener", OPENERS.values(), ids=OPENERS)
def test_what_an_interruption_leaves_open_does_not_keep_a_process_from_exiting(opener: str, tmp_path: Path) -> None:
    code = CODE.replace("{opener}", opener)
    # Steps of 37 lines meet some line of every socket that is opened.
    done = subprocess.run(
        [sys.executable, "-c", code, str(tmp_path), "37"], capture_output=True, text=True, timeout=120.0, check=False
    )
    assert done.returncode == 0, done.stderr
    assert int(done.stdout) > 100
