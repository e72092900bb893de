"""A program of one's own for the instrument: settings, a plan or a refusal, a pure step, and words about its progress.

`trial` runs one over a spring, without a rig.
"""

from collections.abc import Iterator
from typing import Any

from telenano.afm.driver import Oscillation
from telenano.afm.lateral import Place as Place
from telenano.afm.lateral import moved
from telenano.afm.programs.feedback import gain_fault as gain_fault
from telenano.afm.programs.feedback import integral_share as integral_share
from telenano.afm.programs.program import APPROACH as APPROACH
from telenano.afm.programs.program import ARRIVED as ARRIVED
from telenano.afm.programs.program import RISE as RISE
from telenano.afm.programs.program import WAY_TEXTS as WAY_TEXTS
from telenano.afm.programs.program import Begun as Begun
from telenano.afm.programs.program import Inputs as Inputs
from telenano.afm.programs.program import Instrument as Instrument
from telenano.afm.programs.program import Program as Program
from telenano.afm.programs.program import Progress as Progress
from telenano.afm.programs.program import Wanted as Wanted
from telenano.afm.programs.program import way_to_surface as way_to_surface
from telenano.afm.programs.program_settings import Force as Force
from telenano.afm.programs.program_settings import Length as Length
from telenano.afm.programs.program_settings import Position as Position
from telenano.afm.programs.program_settings import ProgramSettings as ProgramSettings
from telenano.afm.programs.program_settings import Speed as Speed

_PERIOD_S = 1e-3


def trial(
    program: Program[Any, Any, Any], settings: ProgramSettings, stiffness_n_per_m: float = 40.0, most_s: float = 60.0
) -> Iterator[Inputs]:
    """Yield what a program is told at each step until it is done, on an instrument as shipped over a linear spring.

    The base goes where the program wants it to be, and the stage no faster than it can; nothing guards the tip.

    Args:
        program: The program to run.
        settings: Its settings.
        stiffness_n_per_m: Force on the tip for each metre of the base beyond the surface at `rest_distance_m` [N/m].
        most_s: The time after which a program that is not done is given up [s].

    Raises:
        RefusedError: The program refuses its settings.
        TimeoutError: It is not done within most_s.
    """
    # it holds the settings of every program, and so imports the packages that import this
    from telenano.afm.config import AfmConfig

    config = AfmConfig()
    limits, lateral = config.to_params().safety, config.to_lateral_params()
    k = config.cantilever.stiffness_n_per_m
    instrument = Instrument(limits, lateral, config.sample_sides_m(), k, _PERIOD_S)
    base_m, place = limits.retract_position_m, Place(0.0, 0.0)
    plan, state, *_ = program.begin(settings, instrument, place)
    for _ in range(round(most_s / _PERIOD_S)):
        force_n = stiffness_n_per_m * max(base_m - config.rest_distance_m, 0.0)
        inputs = Inputs(base_m, place, force_n, (0.0, 0.0), Oscillation(0.0, 0.0), Place(0.0, 0.0))
        yield inputs
        wanted = program.step(plan, state, inputs, _PERIOD_S)
        if wanted.is_done:
            return
        state, base_m = wanted.state, wanted.base_m
        place = moved(lateral, place, wanted.place, _PERIOD_S)[0]
    raise TimeoutError(f"the program is not done within {most_s:g} s")
