"""The base of the settings of a program: kinds of numbers, and defaults that depend on the rate of the instrument.

On the bus an instrument steps at 1 kHz, and a person waits for it; in simulated time the feedback acts at 20 kHz, or
once a period of the drive, and nobody does. Where a default cannot suit both, its field states both (`by_rate`).
"""

from collections.abc import Mapping
from typing import Annotated, Any, Self

from pydantic import Field
from pydantic.fields import FieldInfo

from services.runtime.settings.config import Settings, validate

Length = Annotated[float, Field(ge=1e-9, le=1e-3)]
Position = Annotated[float, Field(ge=-1e-3, le=1e-3)]
Speed = Annotated[float, Field(gt=0.0, le=1e-3)]
Force = Annotated[float, Field(gt=-1e-3, le=1e-3)]

_SIMULATED = "in_simulated_time"
# This text separates a description from the defaults at its end.
_DEFAULT = " Default: "


def by_rate(bus: Any, simulated: Any, description: str, **bounds: Any) -> Any:
    """Return a field whose default is `bus` at the 1 kHz of the bus and `simulated` in simulated time.

    `simulated` may be a mapping from the mode of the program to a default. The description of the field says both.
    """
    if isinstance(simulated, Mapping):
        words = ", ".join(f"{value:g} in {mode} mode" for mode, value in simulated.items())
    else:
        words = simulated if isinstance(simulated, str) else f"{simulated:g}"
    usual = bus if isinstance(bus, str) else f"{bus:g}"
    return Field(
        bus,
        description=f"{description}{_DEFAULT}{usual} on the bus; in simulated time {words}.",
        json_schema_extra={_SIMULATED: simulated},
        **bounds,
    )


class ProgramSettings(Settings):
    """Settings of a program. Its defaults are those of the bus; `in_simulated_time` has the others."""

    @classmethod
    def in_simulated_time(cls, **given: Any) -> Self:
        """Return settings in which the keys that are not given have their defaults in simulated time.

        Raises:
            ConfigError: A value is impossible; the message names its key and what would be right.
        """
        values = {name: stated(field)[1] for name, field in cls.model_fields.items()}
        mode = given.get("mode", values.get("mode"))
        for name, value in values.items():
            if isinstance(value, Mapping):
                # The model itself refuses an unknown mode.
                values[name] = value.get(mode, cls.model_fields[name].default)
        return validate(cls, {**values, **given}, "in simulated time")


def stated(field: FieldInfo) -> tuple[str, Any]:
    """Return what the description of a field says beside its defaults, and its default in simulated time."""
    extra = field.json_schema_extra
    simulated = extra.get(_SIMULATED, field.default) if isinstance(extra, dict) else field.default
    return (field.description or "").partition(_DEFAULT)[0], simulated
