"""Section `afm_node.feel`: the table by which a measured channel is felt (`telenano.afm.felt`)."""

from itertools import pairwise
from typing import Self

from pydantic import Field, model_validator

from telenano.afm.felt import ChannelName, FeltParams
from telenano.extend.maps import SI_UNITS, UNITS
from telenano.settings.config import Settings


class FeelConfig(Settings):
    """A measured channel that the hand feels instead of the force, through a table for one branch of its curve."""

    channel: ChannelName = Field(description="Channel that the hand feels; the instrument has to measure it.")
    unit: str = Field(description="Unit of the values and of tolerance, such as Hz, pA, nm, deg.")
    table: list[list[float]] = Field(
        min_length=2,
        max_length=1000,
        description="Rows of value [unit] and force [N], from far to near; both monotone, the force of one sign.",
    )
    tolerance: float = Field(
        gt=0.0,
        description="Amount by which the value may go back while the base advances [unit]: its peak-to-peak noise.",
    )
    slope_limit_n_per_unit: float = Field(gt=0.0, description="Greatest slope that the table may have [N/unit].")
    rate_limit_n_per_s: float = Field(
        1e-6, gt=0.0, le=1.0, description="Fastest change of the force that is felt [N/s]."
    )
    least_n: float = Field(-1e-6, ge=-1e-3, le=0.0, description="Least force that is felt [N].")
    most_n: float = Field(1e-6, ge=0.0, le=1e-3, description="Greatest force that is felt [N].")

    @model_validator(mode="after")
    def _usable(self) -> Self:
        quantity = UNITS.get(self.unit, ("", 0.0))[0]
        if quantity != self.channel:
            raise ValueError(
                f"unit: {self.unit!r} is not a unit of {self.channel}, which is in {SI_UNITS[self.channel]}"
            )
        for number, row in enumerate(self.table, 1):
            if len(row) != 2:
                raise ValueError(f"table: row {number} has {len(row)} numbers; it must have a value and a force")
        ways = [(after[0] - before[0], after[1] - before[1]) for before, after in pairwise(self.table)]
        for column, name in ((0, "value"), (1, "force")):
            turn = next((i for i, way in enumerate(ways) if not way[column] * ways[0][column] > 0.0), None)
            if turn is not None:
                raise ValueError(
                    f"table: the {name} is not monotone at row {turn + 2}: a table holds on one branch, to where it"
                    " turns"
                )
        if min(row[1] for row in self.table) < 0.0 < max(row[1] for row in self.table):
            raise ValueError(
                "table: the force changes its sign; on one branch it pulls throughout, or pushes throughout"
            )
        for number, (value, force) in enumerate(ways, 1):
            slope = abs(force / value)
            if slope > self.slope_limit_n_per_unit * (1.0 + 1e-9):
                raise ValueError(
                    f"table: between rows {number} and {number + 1} its slope is {slope:.3g} N/{self.unit}, more than"
                    f" slope_limit_n_per_unit = {self.slope_limit_n_per_unit:g}"
                )
        return self

    def to_params(self) -> FeltParams:
        scale = UNITS[self.unit][1]
        sense = 1.0 if self.table[-1][0] > self.table[0][0] else -1.0
        return FeltParams(
            sense,
            tuple(sense * scale * row[0] for row in self.table),
            tuple(row[1] for row in self.table),
            scale * self.tolerance,
            self.rate_limit_n_per_s,
            self.least_n,
            self.most_n,
        )
