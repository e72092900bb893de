"""Compiled steps and small numerical tools that give the same bits on every processor."""

from typing import TYPE_CHECKING

from telenano.lazy_exports import face

if TYPE_CHECKING:
    from telenano.numerics.compiler import always_compiled as always_compiled
    from telenano.numerics.compiler import chosen_step as chosen_step
    from telenano.numerics.compiler import compiled as compiled
    from telenano.numerics.compiler import compiled_form as compiled_form
    from telenano.numerics.digests import source_digest as source_digest
    from telenano.numerics.discretisation import decay as decay
    from telenano.numerics.frames import to_site_frame as to_site_frame
    from telenano.numerics.least_squares import regression as regression
else:
    __getattr__, __dir__ = face(__name__)
