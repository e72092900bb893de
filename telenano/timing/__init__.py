"""Clocks and ages: the age of samples, the offset between two clocks, and the play-out time of messages."""

from typing import TYPE_CHECKING

from telenano.lazy_exports import face

if TYPE_CHECKING:
    from telenano.timing.clock import NEVER_NS as NEVER_NS
    from telenano.timing.clock import Clock as Clock
    from telenano.timing.clock_fit import ClockLine as ClockLine
    from telenano.timing.clock_offset import STEP_NS as STEP_NS
    from telenano.timing.clock_offset import OffsetFilter as OffsetFilter
    from telenano.timing.loop_age import STAGES as STAGES
    from telenano.timing.play_out import PlayOut as PlayOut
else:
    __getattr__, __dir__ = face(__name__)
