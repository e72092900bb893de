"""The base of the settings of a program, and the kinds of numbers in them."""

from typing import Annotated

from pydantic import Field

from telenano.settings.config import Settings

Length = Annotated[float, Field(ge=1e-9, le=1e-3)]
Position = Annotated[float, Field(ge=-1e-3, le=1e-3)]
Speed = Annotated[float, Field(gt=0.0, le=1e-3)]
Force = Annotated[float, Field(gt=-1e-3, le=1e-3)]


class ProgramSettings(Settings):
    """Settings of a program."""
