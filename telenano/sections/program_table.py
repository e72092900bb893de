"""The programs of the instrument by name: those of the project, and of installed packages (`telenano.programs`)."""

from typing import Any

from telenano.afm.programs.curve import Curve
from telenano.afm.programs.scan import Scan
from telenano.afm.programs.tactile import Tactile
from telenano.extend.programs import AnyProgram, Program
from telenano.settings.config import Settings
from telenano.settings.plugins import load

OWN_PROGRAMS: dict[str, AnyProgram] = {"scan": Scan(), "curve": Curve(), "tactile": Tactile()}
# These values of `program` change the running program instead of beginning another one.
CHANGES = ("pause", "resume", "abort")
# Other keys of `set` at the instrument, which cannot be names of programs.
OTHER_KEYS = ("program", "lateral", "disturbances")


def _checked(name: str, value: Any) -> AnyProgram:
    program = value() if isinstance(value, type) and issubclass(value, Program) else value
    if not isinstance(program, Program):
        raise TypeError(f"is a {type(value).__name__}, must be a Program")
    if not (isinstance(program.settings, type) and issubclass(program.settings, Settings)):
        raise TypeError("its settings must be a class of Settings")
    try:
        program.settings()
    except ValueError as error:
        raise ValueError(f"its settings need a default for every key: {error}") from error
    for attribute in ("title", "about"):
        if not isinstance(getattr(program, attribute, None), str):
            raise TypeError(f"its attribute {attribute} must be a text for a person")
    return program


PACKAGE_PROGRAMS = load("programs", _checked, (*OWN_PROGRAMS, *CHANGES, *OTHER_KEYS))
PROGRAMS: dict[str, AnyProgram] = {**OWN_PROGRAMS, **PACKAGE_PROGRAMS.found}
