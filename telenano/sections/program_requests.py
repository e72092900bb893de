"""The keys of `set` at the instrument: a program to begin or change, the place of the tip, the simulation."""

from collections.abc import Callable, Mapping
from functools import partial
from typing import TYPE_CHECKING, Any, Literal

from pydantic import ConfigDict, Field, create_model, field_validator, model_validator

from telenano.extend.instruments import AfmDriver
from telenano.extend.programs import Position
from telenano.sections.program_table import CHANGES, OWN_PROGRAMS, PACKAGE_PROGRAMS, PROGRAMS
from telenano.settings.config import (
    Settings,
    changed_disturbances,
    nested,
    package_fields,
    section_of,
    validate,
)
from telenano.settings.known_packages import where_it_is
from telenano.settings.plugins import refuse
from telenano.wire.errors import ConfigError, RefusedError
from telenano.wire.messages import Scalar

_STIFFEST_N_PER_M = 1e9
# Keys of a simulated instrument that experiments set from trial to trial.
# The stiffness of environment spring.
STIFFNESS = "spring.stiffness_n_per_m"
# True restores the sample's initial state.
RESTORE = "sample.restore"
_DISTURBANCES = "disturbances."


class LateralTarget(Settings):
    """Place of the tip over the sample while no program runs; a hand adds the displacement that it commands."""

    x_m: Position | None = Field(None, description="Along x [m]; 0 is the middle of the sample.")
    y_m: Position | None = Field(None, description="Along y [m]; 0 is the middle of the sample.")


class _Written(Settings):
    model_config = ConfigDict(serialize_by_alias=True)


_FOUND = PACKAGE_PROGRAMS.found

if TYPE_CHECKING:

    class _Programs(_Written):
        """The name of a program, and the sections of all of them."""

        program: str | None = None

else:
    _Programs = create_model(
        "_Programs",
        __base__=_Written,
        program=(
            Literal[(*PROGRAMS, *CHANGES)] | None,
            Field(
                None,
                description=f"{', '.join(PROGRAMS)}: begin it; pause, resume: the running program; abort: end it"
                " and retract.",
            ),
        ),
        **{
            name: (program.settings, Field(program.settings(), title=program.title, description=program.about))
            for name, program in OWN_PROGRAMS.items()
        },
        **package_fields(
            {name: (program.settings, program.settings(), program.about) for name, program in _FOUND.items()},
            {name: program.title for name, program in _FOUND.items()},
        ),
    )


class InstrumentRequest(_Programs):
    """All keys that `set` takes at the AFM."""

    lateral: LateralTarget = Field(LateralTarget(), description="Place of the tip over the sample.")

    @model_validator(mode="before")
    @classmethod
    def _programs_are_here(cls, given: Any) -> Any:
        for name in given if isinstance(given, Mapping) else ():
            cls._usable_program(name)
        return given

    @field_validator("program", mode="before")
    @classmethod
    def _usable_program(cls, name: Any) -> Any:
        refuse(PACKAGE_PROGRAMS, name)
        if name not in PROGRAMS and (hint := where_it_is(f"program {name}")):
            raise ValueError(hint)
        return name

    def settings_of(self, program: str) -> Any:
        """Return the section of a program."""
        return section_of(self, program)


def requested(parameters: Mapping[str, Scalar], others: Mapping[str, Scalar] | None = None) -> InstrumentRequest:
    """Return the request that parameters by dotted key make; RefusedError says which are wrong, or that there are none.

    Args:
        parameters: The parameters by dotted key.
        others: Keys of the same command that are for something else.
    """
    try:
        request = validate(InstrumentRequest, nested(parameters, "session/control"), "session/control", "afm_node")
    except ConfigError as error:
        raise RefusedError(str(error)) from error
    sections = {key.partition(".")[0] for key in parameters}
    if idle := sections & PROGRAMS.keys() - {request.program}:
        raise RefusedError(f"{', '.join(sorted(idle))}: takes effect with program={min(idle)} in the same command only")
    if not sections and not others:
        raise RefusedError("set needs parameters, such as program=scan or lateral.x_m=2e-8")
    return request


def is_of_simulation(key: str) -> bool:
    """Return whether a key of `set` changes a simulated instrument itself."""
    return key in (STIFFNESS, RESTORE) or key.startswith(_DISTURBANCES)


def changed_simulation(driver: AfmDriver, parameters: Mapping[str, Scalar]) -> list[tuple[str, Callable[[], None]]]:
    """Return the changes of a simulated instrument that `set` asks for, each as a sentence and a function.

    The sentence says what the function does. The keys are those for which `is_of_simulation` holds.

    Raises:
        RefusedError: The instrument is real, it lacks the part that a key is for, or a value is wrong.
    """
    simulation = driver.simulation
    if simulation is None:
        for key in parameters:
            raise RefusedError(
                f"{key.partition('.')[0]}: only a simulated instrument has this setting, and this one is real"
            )
        return []
    found: list[tuple[str, Callable[[], None]]] = []
    if STIFFNESS in parameters:
        stiffness_n_per_m = _stiffness(parameters[STIFFNESS])
        if not simulation.is_spring:
            raise RefusedError(f"{STIFFNESS}: only the simulated environment spring has one")
        found.append((f"the sample has {stiffness_n_per_m:g} N/m", partial(simulation.take_spring, stiffness_n_per_m)))
    if RESTORE in parameters:
        if parameters[RESTORE] is not True:
            raise RefusedError(f"{RESTORE}: must be true, and only a simulated sample can be restored")
        found.append(("the sample is as it was in the beginning", simulation.restore_sample))
    if changes := {key: value for key, value in parameters.items() if key.startswith(_DISTURBANCES)}:
        if simulation.disturbances is None:
            raise RefusedError("disturbances: this simulated instrument has no cantilever that they could act on")
        changed = changed_disturbances(simulation.disturbances, changes, "afm_node")
        configure = partial(simulation.configure, changed)
        found.append(("set " + ", ".join(f"{key} = {value}" for key, value in changes.items()), configure))
    return found


def _stiffness(value: Scalar) -> float:
    """Return a value as a stiffness [N/m]; RefusedError unless it is a number above 0 and up to 1e9."""
    if isinstance(value, bool) or not isinstance(value, int | float) or not 0.0 < value <= _STIFFEST_N_PER_M:
        raise RefusedError(f"{STIFFNESS}: {value} must be a number of N/m, above 0, up to 1e9")
    return float(value)
