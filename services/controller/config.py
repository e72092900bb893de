"""Configuration of the controller: which law, and the parameters of each."""

from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field

from services.controller.law import Law
from services.controller.virtual_impedance import VIRTUAL_IMPEDANCE, VirtualImpedanceConfig

LAWS: dict[str, Law] = {law.name: law for law in (VIRTUAL_IMPEDANCE,)}


class ControllerConfig(BaseModel):
    """Section `controller` of a scenario, read by both halves of the law."""

    model_config = ConfigDict(frozen=True, strict=True, extra="forbid", allow_inf_nan=False)

    law: Literal["virtual_impedance"] = Field(default="virtual_impedance", description="Law in force at the start")
    period_s: Annotated[float, Field(ge=1e-4, le=0.1)] = Field(
        default=1e-3, description="Period of the hand's samples [s]"
    )
    virtual_impedance: VirtualImpedanceConfig = Field(
        default=VirtualImpedanceConfig(), description="Parameters of the paper's law"
    )

    def params(self) -> object:
        """Give the compiled constants of the law in force."""
        section: VirtualImpedanceConfig = getattr(self, self.law)
        return section.to_params(self.period_s)
