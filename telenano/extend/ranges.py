"""Ranges of the parameters of the laws: wider than any hand and instrument need, and so that no step overflows.

The steps multiply a handful of these with quantities of the wire, which have ranges of their own
(`telenano.wire.ranges`). With every factor between 1e-15 and 1e15 the products, summed over any session, stay far below
the 1.8e308 of a double.
"""

from typing import Annotated

from pydantic import Field

# The range goes from a metre at the hand to a picometre at the tip, and up to 1000 for a rig with the larger slave.
PositionScale = Annotated[float, Field(ge=1e-12, le=1e3)]
# a newton at the hand for a femtonewton at the tip
ForceScale = Annotated[float, Field(ge=1e-3, le=1e15)]
# The range goes from a milligram to a thousand tonnes.
MassKg = Annotated[float, Field(ge=1e-6, le=1e6)]
# the heaviest hand is a few thousand N s/m; a rigid one is 1e9
DampingNSPerM = Annotated[float, Field(ge=1e-6, le=1e9)]
DampingOrNoneNSPerM = Annotated[float, Field(ge=0.0, le=1e9)]
# the stiffest environment that an AFM can be given has 1e9 N/m
StiffnessNPerM = Annotated[float, Field(ge=1e-6, le=1e9)]
StiffnessOrNoneNPerM = Annotated[float, Field(ge=0.0, le=1e9)]
# 4/3 E* sqrt(R): diamond and a radius of 1 mm have 5e10
ContactNPerM15 = Annotated[float, Field(ge=1e-3, le=1e15)]
Gain = Annotated[float, Field(ge=0.0, le=1e9)]
# The range goes from a microsecond to eleven days.
TimeS = Annotated[float, Field(ge=1e-6, le=1e6)]
TimeOrNoneS = Annotated[float, Field(ge=0.0, le=1e6)]
# the ranges of the wire, and nothing
ForceOrNoneN = Annotated[float, Field(ge=0.0, le=1e6)]
PositionOrNoneM = Annotated[float, Field(ge=0.0, le=10.0)]
VelocityOrNoneMPerS = Annotated[float, Field(ge=0.0, le=1e3)]
WaveOrNoneSqrtW = Annotated[float, Field(ge=0.0, le=1e6)]
SpeedMPerS = Annotated[float, Field(ge=1e-12, le=1e3)]
# The range begins at a thousandth of a picometre.
LengthM = Annotated[float, Field(ge=1e-15, le=1.0)]
EnergyJ = Annotated[float, Field(ge=1e-15, le=1e9)]
EnergyOrNoneJ = Annotated[float, Field(ge=0.0, le=1e9)]
ForceRateNPerS = Annotated[float, Field(ge=1e-9, le=1e9)]
StiffnessRateNPerMS = Annotated[float, Field(ge=1e-6, le=1e15)]
