"""Signals within compiled code, in destructors and in what must be done as a whole."""

import signal
import subprocess
import sys

import pytest

# compiled code that returns named tuples, called again and again while signals arrive at random times
_COMPUTES = """
import os, random, signal, sys, threading, time
from telenano.signals import interrupts
{prepare}
from telenano.sections.afm_section import AfmConfig
from telenano.afm.dynamic import NO_NOISE, advance, steady_state
from telenano.numerics.compiler import compiled

plant = AfmConfig().to_dynamic()
state = steady_state(plant, -1e-6, 0.0)
draw = random.Random(7)
state, _ = advance(plant, state, state.base_m, 0.0, 0.0, 96, NO_NOISE)
count, go_on = 0, threading.Semaphore(0)

def send():
    while True:
        go_on.acquire()
        time.sleep(draw.uniform(0.0, 4e-3))
        os.kill(os.getpid(), signal.{name})

threading.Thread(target=send, daemon=True).start()
while count < 60:
    try:
        go_on.release()
        while True:
            # lasts about as long as a signal takes to come
            state, reading = advance(plant, state, state.base_m, 0.0, 0.0, 9600, NO_NOISE)
    except KeyboardInterrupt as error:
        count += 1
        assert type(error).__name__ == "Interrupted", error
print(count, state.phase_step)
"""


def run(script: str) -> "subprocess.CompletedProcess[str]":
    return subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, check=False,
        # what a shell has in the background ignores SIGINT, and its children with it
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
    )  # fmt: skip


@pytest.mark.check("takes 3.0 s")
@pytest.mark.parametrize(("prepare", "name"), [("", "SIGINT"), ("interrupts.install()", "SIGTERM")])
def test_a_signal_within_compiled_code_is_raised_after_it(prepare: str, name: str) -> None:
    done = run(_COMPUTES.format(prepare=prepare, name=name))
    # What is not in the cache is compiled first, which is said.
    said = [line for line in done.stderr.splitlines() if not line.startswith("compiling models")]
    assert (done.returncode, done.stdout, said) == (0, "60 0\n", [])


def test_an_interruption_that_a_destructor_would_swallow_is_raised_again() -> None:
    done = run("""
import os, signal, time
from telenano.signals import interrupts

class Ends:
    def __del__(self):
        os.kill(os.getpid(), signal.SIGTERM)
        time.sleep(0.01)

interrupts.install()
try:
    Ends()
    time.sleep(60.0)
except KeyboardInterrupt:
    print(interrupts.exit_code())
""")
    assert (done.returncode, done.stdout, done.stderr) == (0, "143\n", "")


def test_a_signal_is_kept_until_the_end_of_what_must_be_done_as_a_whole() -> None:
    done = run("""
import os, signal
from telenano.signals import interrupts

interrupts.install()
try:
    with interrupts.held():
        os.kill(os.getpid(), signal.SIGINT)
        print("all of it")
    print("not this")
except KeyboardInterrupt:
    print(interrupts.received())
""")
    assert (done.returncode, done.stdout) == (0, f"all of it\n{int(signal.SIGINT)}\n"), done.stderr


def test_a_signal_while_results_are_written_is_kept_and_a_second_one_gives_up() -> None:
    done = run("""
import os, signal
from telenano.signals import interrupts

interrupts.install()
with interrupts.finishing() as finish:
    try:
        os.kill(os.getpid(), signal.SIGTERM)
    except KeyboardInterrupt:
        print("the work is ended")
    finish()
    os.kill(os.getpid(), signal.SIGINT)
    print("written")
    try:
        os.kill(os.getpid(), signal.SIGINT)
    except KeyboardInterrupt:
        print("given up")
print(interrupts.received())
try:
    os.kill(os.getpid(), signal.SIGINT)
except KeyboardInterrupt:
    print("as before")
""")
    said = f"the work is ended\nwritten\ngiven up\n{int(signal.SIGTERM)}\nas before\n"
    assert (done.returncode, done.stdout) == (0, said), done.stderr


def test_a_signal_that_is_ignored_stays_so_and_a_handler_of_somebody_else_too() -> None:
    done = run("""
import signal
from telenano.signals import interrupts

signal.signal(signal.SIGINT, signal.SIG_IGN)
interrupts.install()
assert signal.getsignal(signal.SIGINT) is signal.SIG_IGN
own = lambda number, frame: None
signal.signal(signal.SIGINT, own)
interrupts.watch()
assert signal.getsignal(signal.SIGINT) is own
""")
    assert (done.returncode, done.stderr) == (0, "")
