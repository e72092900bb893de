"""What a session is for a program, recorded or simulated: conditions, verdict, holds, columns, tables, a picture.

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

# What every session has, with unit and text.
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
# An HTML form lists so many holds, which leaves it within 20 lines.
_HOLDS_SHOWN = 10
# On these colours of a verdict white can be read.
_DARK = ("diverged", "contact_lost", "guarded", "cannot_say")


@dataclass(frozen=True)
class Conditions:
    """What was set for a session, as a figure has to state it; what was measured is in `Session` and its summary.

    law: those in force one after the other, joined by `then`; parameters: of the law that the scenario names;
    round_trip_ms: the fixed delays of both ways of the link together [ms], without what a network adds to them;
    link_profile: the name of the network; sample and hand: in words; changed: what was set while the session ran.
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
        """Return the words of a title."""
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
        """Return them as columns of a table without the parameters of the law; the changes are one text."""
        own = {name: value for name, value in asdict(self).items() if name != "parameters"}
        return {**own, "changed": "; ".join(self.changed)}


def sample_in_words(scenario: "Scenario") -> str:
    """Return what the tip meets, by the scenario: the instrument's driver, or the sample and what lies on it."""
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
    """Return who presses, by the scenario: a person at a device, or the simulated hand and what it does.

    Raises:
        ConfigError: The hand cannot be read; the message names the key.
    """
    # A kept summary is read without these, whose import takes longer.
    from telenano.sections.hand_section import recorded_hand
    from telenano.sections.operator_section import ForceProfileConfig, ImpedanceConfig

    operator, simulated = recorded_hand(scenario.haptic_node, origin)
    if not simulated:
        return f"at {scenario.haptic_node.get('driver')}"
    if isinstance(operator, ForceProfileConfig):
        return f"force_profile to {max(abs(point.force_n) for point in operator.points):g} N"
    return f"{operator.arm} arm" if isinstance(operator, ImpedanceConfig) else str(operator.kind)


class Session(Mapping[str, Column]):
    """A session, recorded or simulated: a mapping of columns of shape (n,), one value a sample of the hand.

    `units` and `descriptions` have an entry for each column. Two sessions are equal if they are one object.
    """

    __hash__ = object.__hash__

    def __eq__(self, other: object) -> bool:
        return self is other

    def __bool__(self) -> bool:
        # the length of a mapping would read a recording
        return True

    @abstractmethod
    def __repr__(self) -> str:
        """Return what it is, in a line."""

    @property
    @abstractmethod
    def course(self) -> ColumnTable:
        """All columns as a table, which is read once."""

    @property
    @abstractmethod
    def conditions(self) -> Conditions:
        """What was set: scenario, law and its parameters, delay, line, sample, instrument and hand."""

    @property
    @abstractmethod
    def measured_round_trip_ms(self) -> float | None:
        """Median of what the link took there and back [ms], None where nothing was recorded of it."""

    @property
    @abstractmethod
    def holds(self) -> "list[Hold]":
        """The holds of the hand, each judged."""

    @property
    @abstractmethod
    def verdict(self) -> "Kind":
        """What became of the session: that of its worst hold, or guarded where the instrument's guard ended it."""

    @property
    @abstractmethod
    def reason(self) -> str:
        """The verdict in words; a guard that acted comes first, with its time and limit."""

    @property
    @abstractmethod
    def felt_stiffness(self) -> "FeltSession":
        """What the hand felt of the stiffness that is there, or why that cannot be known."""

    @property
    @abstractmethod
    def channels(self) -> dict[str, tuple[str, ...]]:
        """The publishers of each channel that `table` gives."""

    @abstractmethod
    def table(self, channel: str, src: str | None = None) -> ColumnTable:
        """Return the messages of a channel, in the frame of a site, z away from the sample."""

    @abstractmethod
    def _drawn(self) -> "tuple[SessionSeries, str]":
        """Return what the three panels of Fig. 12 show, and the title."""

    @property
    def units(self) -> dict[str, str]:
        """The unit of each column."""
        return self.course.units

    @property
    def descriptions(self) -> dict[str, str]:
        """What each column is, in words."""
        return self.course.descriptions

    # a column that is not known by its name has numbers
    @overload
    def __getitem__(  # type: ignore[overload-overlap]
        self, name: Literal["in_contact", "hand_following"]
    ) -> npt.NDArray[np.bool_]: ...

    @overload
    def __getitem__(self, name: str) -> npt.NDArray[np.float64]: ...

    def __getitem__(self, name: str) -> Column:
        """Return a column; KeyError names the one that was probably meant, and those that there are."""
        return self.course[name]

    if not TYPE_CHECKING:
        # To a checker of types a name that is not here is none.
        def __getattr__(self, name: str) -> Any:
            columns: Mapping[str, Any] = {}
            # What begins with _ is asked by the language and by notebooks, which takes no reading of a recording.
            if not name.startswith("_") and not hasattr(type(self), name):
                with suppress(TelenanoError):
                    columns = self.course
                if set_so := named_by(name, {one.name: "" for one in fields(Conditions)}):
                    text = f"{type(self).__name__!r} object has no attribute {name!r}: what was set is in"
                    raise AttributeError(f"{text} {', '.join(f'`.conditions.{one}`' for one in set_so)}")
            raise AttributeError(no_attribute(self, name, columns))

    def __array__(self, *_args: Any, **_options: Any) -> npt.NDArray[Any]:
        """Raise TypeError, because columns of numbers and of truth values are no array; NumPy and pandas ask for it."""
        raise TypeError("a session is columns by name and no array: [name] is one, and `to_pandas()` has all")

    def __iter__(self) -> Iterator[str]:
        return iter(self.course)

    def __len__(self) -> int:
        return len(self.course)

    def _ipython_key_completions_(self) -> list[str]:
        try:
            return list(self.course)
        except TelenanoError:
            # what cannot be read has nothing to complete
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
        """Draw columns over the time, a panel each; without any the three panels of Fig. 12.

        Raises:
            ConfigError: matplotlib is not installed; the message says what adds it.
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
