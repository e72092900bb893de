"""Handling of SIGINT and SIGTERM in a process that computes, and the safe start of child processes."""

from typing import TYPE_CHECKING

from telenano.lazy_exports import face

if TYPE_CHECKING:
    from telenano.signals.children import in_processes as in_processes
    from telenano.signals.children import run as run
    from telenano.signals.children import start as start
    from telenano.signals.interrupts import finishing as finishing
    from telenano.signals.interrupts import held as held
else:
    __getattr__, __dir__ = face(__name__)
