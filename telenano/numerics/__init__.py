"""Compiled steps and small numerical tools that give the same bits on every processor."""

from typing import TYPE_CHECKING

from telenano.faces import face

if TYPE_CHECKING:
    from telenano.numerics.compiled import always_compiled as always_compiled
else:
    __getattr__, __dir__ = face(__name__)
