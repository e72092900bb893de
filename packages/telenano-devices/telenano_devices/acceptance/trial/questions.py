"""The questions of a trial on a terminal: y or n, and at any time `end` or Ctrl-C."""

import os
import select
import signal
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any, NoReturn

from telenano.wire import ConfigError
from telenano_devices.acceptance.take import EndedError, Guide, Step, Verdict

ENDED = "the person has ended it"
_EMULATED = ("emulat", "simulat")
# A tick of this computer counts as late beyond this.
_LATE_S = 2e-3
# The largest share of late ticks.
_MOST_SHARE = 0.01
# The largest lateness of any tick.
_WORST_S = 0.02


class Questions:
    """Asks a person before each step, and ends the motion at any time on request.

    Args:
        tell: The function that prints a line.
        yes: Whether every question is answered with yes, for emulators only.
        is_emulated: Whether the device is known to be an emulator by its address.
    """

    def __init__(self, tell: Callable[[str], None], *, yes: bool = False, is_emulated: bool = False) -> None:
        self._tell, self._yes, self._is_emulated = tell, yes, is_emulated
        self._signals: list[int] = []
        self._typed, self._ends, self._is_over = bytearray(), False, False
        self._is_typed_at = sys.stdin.isatty()
        self._waits = self._late = 0
        self._worst_s = 0.0

    @property
    def guide(self) -> Guide:
        """Return the guide that leads a person through the motion by these questions."""
        return Guide(self._say, self._ask, self._poll, self._met, self._waited)

    def computer(self) -> list[Verdict]:
        """Return the verdict on the punctuality of this computer's ticks; an empty list if there were none."""
        if not self._waits:
            return []
        share = self._late / self._waits
        is_good = share <= _MOST_SHARE and self._worst_s <= _WORST_S
        text = f"{100.0 * share:.1f} % of the milliseconds late, by {1e3 * self._worst_s:.0f} ms at most"
        advice = "" if is_good else ": end other programs and try again, as this may cause other faults"
        wanted = (
            f"at most {100.0 * _MOST_SHARE:.0f} % by {1e3 * _LATE_S:.0f} ms or more, none by {1e3 * _WORST_S:.0f} ms"
        )
        return [Verdict("this computer", "pass" if is_good else "retake", text + advice, wanted)]

    @contextmanager
    def hear(self) -> Iterator[None]:
        """End the motion on Ctrl-C or SIGTERM while the block runs; a second signal ends the program."""
        before = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}

        def received(number: int, frame: Any) -> None:
            if self._signals:
                raise KeyboardInterrupt
            self._signals.append(number)

        for number in before:
            signal.signal(number, received)
        try:
            yield
        finally:
            for number, handler in before.items():
                signal.signal(number, handler)

    def _met(self, identity: str) -> None:
        if self._yes and not self._is_emulated and not any(word in identity.lower() for word in _EMULATED):
            raise ConfigError(f"--yes: is for emulators, and this is {identity}: answer the questions yourself")
        self._tell(f"found: {identity}")

    def _say(self, step: Step) -> None:
        self._tell(f"{step.seconds:4.0f} s  {step.name}: {step.prompt}")

    def _ask(self, step: Step, idle: Callable[[], None]) -> bool:
        self._tell(f"\n{step.name} ({step.load}, {step.seconds:.0f} s): {step.prompt}.")
        if self._yes:
            self._poll()
            return True
        if self._is_typed_at:
            # Text typed before the question does not answer it.
            self._poll()
            self._typed.clear()
        self._tell("Begin? y: yes, n: leave it out, end: end the trial")
        while True:
            answer = self._line(idle).strip().lower()
            if answer in ("y", "yes"):
                return True
            if answer in ("n", "no"):
                return False
            self._tell(f"{answer!r} is not y, n or end")

    def _line(self, idle: Callable[[], None]) -> str:
        """Return the next typed line, keeping the device at rest meanwhile; raise EndedError for `end`."""
        while b"\n" not in self._typed:
            if self._is_over:
                self._end()
            self._poll()
            idle()
        line, _, rest = bytes(self._typed).partition(b"\n")
        self._typed[:] = rest
        if line.strip().lower() == b"end":
            self._end()
        return line.decode(errors="replace")

    def _poll(self) -> None:
        """Raise EndedError if the person has ended the motion."""
        if self._ends:
            return
        if self._signals:
            self._end()
        if self._yes or self._is_over or not self._arrived():
            return
        whole = [line.strip().lower() for line in bytes(self._typed).split(b"\n")[:-1]]
        # Lines of a file or pipe wait for their questions, so only the first one counts.
        if b"end" in (whole if self._is_typed_at else whole[:1]):
            self._end()

    def _waited(self, late_s: float) -> None:
        self._waits += 1
        self._late += late_s > _LATE_S
        self._worst_s = max(self._worst_s, late_s)

    def _end(self) -> NoReturn:
        self._ends = True
        raise EndedError(ENDED)

    def _arrived(self) -> bool:
        """Store the text that was typed, and return whether there was any."""
        try:
            descriptor = sys.stdin.fileno()
        except (OSError, ValueError):
            data = sys.stdin.readline().encode()
        else:
            if not select.select([descriptor], [], [], 0.0)[0]:
                return False
            data = os.read(descriptor, 4096)
        self._typed += data
        self._is_over = not data
        return bool(data)
