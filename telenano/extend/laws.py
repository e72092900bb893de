"""A law of one's own: its two halves as pure steps, and what the laws of this project are built from."""

from services.controller.law import (
    NO_SIGNAL,
    EnergyAccount,
    HandSample,
    Law,
    MasterReference,
    PortSignal,
    SlaveReference,
    TipMeasurement,
    port_signal,
)
from services.controller.laws.shared import pass_through
from services.controller.laws.shared.virtual_mass import (
    Mass,
    MassConfig,
    MassParams,
    ScaledConfig,
    at_rest,
    is_coupled,
    let_go,
    moved,
    periods_in,
    rescaled,
    resumed,
    tip_reference,
)
from services.numerics.compiled import compiled

__all__ = [
    "NO_SIGNAL",
    "EnergyAccount",
    "HandSample",
    "Law",
    "Mass",
    "MassConfig",
    "MassParams",
    "MasterReference",
    "PortSignal",
    "ScaledConfig",
    "SlaveReference",
    "TipMeasurement",
    "at_rest",
    "compiled",
    "is_coupled",
    "let_go",
    "moved",
    "pass_through",
    "periods_in",
    "port_signal",
    "rescaled",
    "resumed",
    "tip_reference",
]
