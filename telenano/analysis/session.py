"""Interface of a session, recorded or simulated: conditions, verdict, holds, columns, tables, and a figure.

`telenano.open` and `telenano.simulate` both return a `Session`, so that one function reads both.
"""

from abc import abstractmethod
from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import asdict, dataclass, fields
from html import escape
from typing import TYPE_CHECKING, Any, Literal, overload

import numpy as np
import numpy.typing as npt

from telenano.analysis.figure_style import VERDICT_COLOURS
from telenano.files.optional_modules import required_module
from telenano.recording.column_table import Column, ColumnTable, no_attribute
from telenano.settings.named_instruments import IDEAL
from telenano.wire.errors import TelenanoError, named_by

if TYPE_CHECKING:
    import pandas
    import xarray
    from matplotlib.figure import Figure

    from telenano.analysis.felt_stiffness import FeltSession
    from telenano.analysis.fig12 import SessionSeries
    from telenano.analysis.findings import Kind
    from telenano.analysis.holds import Hold
    from telenano.settings.scenario import Scenario

# columns of every session, with unit and description
COLUMNS = {
    "time_s": ("s", "Time since the start of the operator's force profile"),
    "operator_force_n": ("N", "Force of the operator on the device, F_m, towards the sample"),
    "hand_position_m": ("m", "Position of the device, x_m, towards the sample"),
    "reference_m": ("m", "Reference of the device, x_mr"),
    "rendered_force_n": ("N", "Force that the law ascribes to the environment, at the hand's scale"),
    "base_position_m": ("m", "Position of the base, x_s, towards the sample"),
    "tip_force_n": ("N", "Force on the tip, F_s, repulsive positive"),
    "scaled_tip_force_n": ("N", "The same at the hand's scale, alpha_f F_s"),
    "separation_m": ("m", "Distance between tip and sample, h"),
    "in_contact": ("", "Whether the tip touches"),
    "hand_following": ("", "Whether the device follows commands"),
}
# greatest number of holds in the HTML representation, which then has at most 20 lines
_HOLDS_SHOWN = 10
# verdicts whose colour needs white text
_DARK = ("diverged", "contact_lost", "guarded", "cannot_say")


@dataclass(frozen=True)
class Conditions:
    """Settings of a session, as a figure must state them; measured values are in `Session` and its summary.

    law: the laws in order, joined by `then`; parameters: those of the law that the scenario names; round_trip_ms: the
    sum of the fixed delays of both directions of the link [ms], without the delays that a network adds; link_profile:
    the name of the network; sample and hand: in words; changed: settings changed during the session.
    """

    scenario: str
    law: str
    parameters: dict[str, Any]
    environment: str
    round_trip_ms: float
    link_profile: str
    link_seed: int
    instrument: str = IDEAL
    sample: str = ""
    hand: str = ""
    changed: tuple[str, ...] = ()

    def title(self) -> str:
        """Return a title: scenario, law, round trip, and the network and the instrument if they are not ideal."""
        from telenano.settings.link_settings import EVEN

        words = [self.scenario, self.law]
        if self.link_profile in EVEN or self.round_trip_ms:
            words.append(f"round trip {self.round_trip_ms:g} ms")
        if self.link_profile not in EVEN:
            words.append(f"link {self.link_profile}")
        if self.instrument != IDEAL:
            words.append(f"instrument {self.instrument}")
        return ", ".join(words)

    def row(self) -> dict[str, Any]:
        """Return the settings as a row of a table, without the parameters of the law; the changes are one text."""
        own = {name: value for name, value in asdict(self).items() if name != "parameters"}
        return {**own, "changed": "; ".join(self.changed)}


def sample_in_words(scenario: "Scenario") -> str:
    """Return the sample of a scenario in words, or the driver of an instrument that is not simulated."""
    section = scenario.afm_node
    driver = str(section.get("driver", "simulated"))
    if driver != "simulated":
        return f"at {driver}"
    environment = str(section.get("environment", "tip_sample"))
    own = section.get(environment)
    stiffness = own.get("stiffness_n_per_m") if isinstance(own, Mapping) else None
    words = environment if stiffness is None else f"{environment} {stiffness} N/m"
    sample = section.get("sample") or {}
    over = [str(sample[key]) for key in ("name", "map") if sample.get(key)] if isinstance(sample, Mapping) else []
    return f"{words} over {' of '.join(over)}" if over else words


def hand_in_words(scenario: "Scenario", origin: str) -> str:
    """Return the hand of a scenario in words: the device that a person uses, or the kind of simulated hand.

    Raises:
        ConfigError: The section of the hand is invalid; the message names the key.
    """
    # Imported here, because reading a kept summary does not need these slow imports.
    from telenano.sections.hand_section import recorded_hand
    from telenano.sections.operator_section import ForceProfileConfig, ImpedanceConfig

    operator, simulated = recorded_hand(scenario.haptic_node, origin)
    if not simulated:
        return f"at {scenario.haptic_node.get('driver')}"
    if isinstance(operator, ForceProfileConfig):
        return f"force_profile to {max(abs(point.force_n) for point in operator.points):g} N"
    return f"{operator.arm} arm" if isinstance(operator, ImpedanceConfig) else str(operator.kind)


class Session(Mapping[str, Column]):
    """A session, recorded or simulated: a mapping of columns of shape (n,), one value per sample of the hand.

    `units` and `descriptions` have an entry for each column. Two sessions are equal only if they are the same object.
    """

    __hash__ = object.__hash__

    def __eq__(self, other: object) -> bool:
        return self is other

    def __bool__(self) -> bool:
        # The default, the length of the mapping, would read the recording.
        return True

    @abstractmethod
    def __repr__(self) -> str:
        """Return the session in one line."""

    @property
    @abstractmethod
    def course(self) -> ColumnTable:
        """All columns as a table, which is read only once."""

    @property
    @abstractmethod
    def conditions(self) -> Conditions:
        """The settings: scenario, law and its parameters, delay, network, sample, instrument and hand."""

    @property
    @abstractmethod
    def measured_round_trip_ms(self) -> float | None:
        """Median of the link's delays there and back [ms], None if they were not recorded."""

    @property
    @abstractmethod
    def holds(self) -> "list[Hold]":
        """The holds of the hand, each with its verdict."""

    @property
    @abstractmethod
    def verdict(self) -> "Kind":
        """The verdict on the session: that of its worst hold, or guarded if the instrument's guard ended it."""

    @property
    @abstractmethod
    def reason(self) -> str:
        """The verdict in words; a guard that acted comes first, with its time and limit."""

    @property
    @abstractmethod
    def felt_stiffness(self) -> "FeltSession":
        """The felt and the true stiffness, or the reason why they are unknown."""

    @property
    @abstractmethod
    def channels(self) -> dict[str, tuple[str, ...]]:
        """The publishers of each channel that `table` can return."""

    @abstractmethod
    def table(self, channel: str, src: str | None = None) -> ColumnTable:
        """Return the messages of a channel as a table, in the frame of a site with z away from the sample."""

    @abstractmethod
    def _drawn(self) -> "tuple[SessionSeries, str]":
        """Return the series of the three panels of Fig. 12, and the title."""

    @property
    def units(self) -> dict[str, str]:
        """The unit of each column."""
        return self.course.units

    @property
    def descriptions(self) -> dict[str, str]:
        """The description of each column."""
        return self.course.descriptions

    # All other columns have numbers.
    @overload
    def __getitem__(  # type: ignore[overload-overlap]
        self, name: Literal["in_contact", "hand_following"]
    ) -> npt.NDArray[np.bool_]: ...

    @overload
    def __getitem__(self, name: str) -> npt.NDArray[np.float64]: ...

    def __getitem__(self, name: str) -> Column:
        """Return a column; KeyError names the column that was probably meant, and all columns."""
        return self.course[name]

    if not TYPE_CHECKING:
        # Hidden from type checkers, so that they report an unknown attribute.
        def __getattr__(self, name: str) -> Any:
            columns: Mapping[str, Any] = {}
            # Python and notebooks look up names that begin with _, which must not read a recording.
            if not name.startswith("_") and not hasattr(type(self), name):
                with suppress(TelenanoError):
                    columns = self.course
                if set_so := named_by(name, {one.name: "" for one in fields(Conditions)}):
                    text = f"{type(self).__name__!r} object has no attribute {name!r}: what was set is in"
                    raise AttributeError(f"{text} {', '.join(f'`.conditions.{one}`' for one in set_so)}")
            raise AttributeError(no_attribute(self, name, columns))

    def __array__(self, *_args: Any, **_options: Any) -> npt.NDArray[Any]:
        """Raise TypeError when NumPy or pandas converts a session: mixed columns of numbers and flags are no array."""
        raise TypeError("a session is columns by name and no array: [name] is one, and `to_pandas()` has all")

    def __iter__(self) -> Iterator[str]:
        return iter(self.course)

    def __len__(self) -> int:
        return len(self.course)

    def _ipython_key_completions_(self) -> list[str]:
        try:
            return list(self.course)
        except TelenanoError:
            # A session that cannot be read has no names to complete.
            return []

    def df(self, channel: str, src: str | None = None) -> "pandas.DataFrame":
        """Return `table` as a pandas DataFrame."""
        return self.table(channel, src).to_pandas()

    def to_pandas(self) -> "pandas.DataFrame":
        """Return the columns as a pandas DataFrame, with `units` in its attrs."""
        return self.course.to_pandas()

    def to_xarray(self) -> "xarray.Dataset":
        """Return the columns as an xarray Dataset over `time_s`."""
        return self.course.to_xarray()

    def plot(self, *columns: str) -> "Figure":
        """Draw columns over the time, one panel each; without arguments, the three panels of Fig. 12.

        Raises:
            ConfigError: matplotlib is not installed; the message names the package to add.
            KeyError: There is no such column; the message names the one that was probably meant.
        """
        required_module("matplotlib", "a picture of a session: matplotlib is not installed", "viz")
        from telenano.analysis.fig12 import draw_columns, draw_fig12

        if not columns:
            return draw_fig12(*self._drawn())
        drawn = {name: (self[name], self.units[name]) for name in columns}
        return draw_columns(self["time_s"], drawn, self.conditions.title())

    def _repr_html_(self) -> str:
        try:
            return self._html()
        except TelenanoError as error:
            return f"<p>{escape(repr(self))}<br>{escape(str(error))}</p>"

    def _html(self) -> str:
        verdict, held = self.verdict, self.holds
        colour = f"background:{VERDICT_COLOURS[verdict]};color:{'#fff' if verdict in _DARK else '#000'}"
        told = f"<b style='{colour};padding:0 .4em'>{escape(verdict.replace('_', ' '))}</b> {escape(self.reason)}"
        lines = ["<table>", f"<caption>{escape(self.conditions.title())}: {told}</caption>"]
        heads = ("hold (s)", "hand (N)", "verdict", "F_m / scaled F_s", "reason")
        lines.append("<tr>" + "".join(f"<th>{head}</th>" for head in heads) + "</tr>")
        for hold in held[:_HOLDS_SHOWN]:
            ratio = "–" if hold.hold_ratio is None else f"{hold.hold_ratio:.4g}"
            span = f"{hold.start_s:.2f} to {hold.end_s:.2f}"
            cells = (span, f"{hold.hand_force_n:.3g}", hold.verdict.replace("_", " "), ratio, hold.reason)
            lines.append("<tr>" + "".join(f"<td>{escape(cell)}</td>" for cell in cells) + "</tr>")
        if len(held) > _HOLDS_SHOWN:
            more = f"and {len(held) - _HOLDS_SHOWN} more holds, which <code>.holds</code> has"
            lines.append(f"<tr><td colspan='{len(heads)}'>{more}</td></tr>")
        return "\n".join([*lines, "</table>"])
