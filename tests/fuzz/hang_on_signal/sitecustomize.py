"""Loaded by every Python whose PYTHONPATH has this folder: SIGUSR1 makes its loop spin, as a fault in it would."""

import signal


def _spin(number: int, frame: object) -> None:
    while True:
        pass


signal.signal(signal.SIGUSR1, _spin)
