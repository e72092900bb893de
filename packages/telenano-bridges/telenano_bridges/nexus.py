"""Writes images and sessions as NeXus files, after the application definition NXafm (https://www.nexusformat.org).

NXafm describes rasters, and force against distance at one point. A session of remote touch is the latter, with the hand
in groups NXdata of its own: names and units are those of the field, z is positive away from the sample in both. Data
that NXafm requires but the recording lacks, such as the user, read `not recorded`. Scenario, site and versions are in
`/entry/telenano`.
"""

import json
from collections.abc import Iterable, Iterator, Mapping
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, NamedTuple

import h5py
import numpy as np
from telenano_lab.microscopy.image_files import Image, ImageFacts, LiveImage, images_of_lines

from telenano.files import atomic_file
from telenano.recording import CopyResult, Recording, Selection, Timeline, last_force_profile
from telenano.sections import AfmConfig
from telenano.settings import LoadedScenario, validate
from telenano.wire import AfmScanline, ConfigError, RecordingError

# The version of the NeXus definitions that the files follow.
DEFINITION = "2026.01"
_UNKNOWN = "not recorded"
_CHANNELS = ("afm/state", "haptic/state", "afm/scanline")


class Field(NamedTuple):
    """Values with unit (empty for none) and a description."""

    values: Any
    unit: str = ""
    about: str = ""


class Plot(NamedTuple):
    """A group NXdata: its title, the names of its signal and its axes (slowest first), and all fields by name."""

    title: str
    signal: str
    axes: tuple[str, ...]
    fields: Mapping[str, Field]


class Facts(NamedTuple):
    """Metadata of a measurement; times are ISO 8601, empty if they are not known.

    raster: columns, rows, width and depth [m] of an image; ramp: points, lowest and highest base [m] of a session.
    """

    title: str
    mode: str
    instrument: str
    version: str
    sample: str = ""
    cantilever: Mapping[str, Field] = {}
    began: str = ""
    ended: str = ""
    raster: tuple[int, int, float, float] | None = None
    ramp: tuple[int, float, float] | None = None
    notes: Mapping[str, str] = {}


def write_images(path: Path, images: Mapping[str, Image], about: ImageFacts) -> None:
    """Write the channels of an image, by name, as a NeXus file."""
    first = next(iter(images.values()))
    rows, columns_ = first.values.shape
    raster = (columns_, rows, first.width_m, first.depth_m)
    mode = f"{about.mode} mode"
    facts = Facts(first.caption, mode, about.instrument, about.version, about.sample, raster=raster)
    write(path, facts, {name: _plot_of(image) for name, image in images.items()})


def export_session(recording: Recording, target: Path, selection: Selection) -> CopyResult:
    """Write tip, hand and images of a recording as a NeXus file, which gets its name only when it is complete.

    Raises:
        RecordingError: The selection has no channel of tip, hand or images.
        OSError: The file exists, or cannot be written.
    """
    wanted = {channel.channel_topic: channel.src for channel in recording.channels if selection(channel)}
    origin_ns = _origin_ns(recording)
    plots, ramp = dict(_courses(recording, wanted, origin_ns)), None
    count = sum(len(plots[name].fields["time"].values) for name in ("tip", "hand") if name in plots)
    images = list(_images(recording)) if "afm/scanline" in wanted else []
    for number, image in enumerate(images, start=1):
        count += 2 * image.finished
        plots |= {
            f"image_{number}_{name}": _plot_of(one) for name, one in images_of_lines(image, image.finished).items()
        }
    if not plots:
        names_shown = ", ".join(sorted({channel.channel_topic for channel in recording.channels})) or "none"
        raise RecordingError(
            f"{recording.path}: a NeXus file needs {', '.join(_CHANNELS)}; its channels are {names_shown}"
        )
    if "tip" in plots:
        base = plots["tip"].fields["base_position"].values
        ramp = (len(base), float(base.min()), float(base.max()))
    raster = None
    if images:
        rows, pixels = images[0].trace_m.shape
        raster = (pixels, rows, images[0].width_m, images[0].depth_m)
    is_tapping = any(np.isfinite(image.amplitude_m).any() for image in images)
    facts = _facts_of(recording, "tapping mode" if is_tapping else "contact mode")
    with atomic_file(target, replace=False) as part:
        write(part, facts._replace(raster=raster, ramp=ramp), plots)
    return CopyResult(path=str(target), messages=count)


def write(path: Path, facts: Facts, plots: Mapping[str, Plot]) -> None:
    """Write a NeXus file of one entry."""
    with h5py.File(path, "w") as file:
        file.attrs.update({"NX_class": "NXroot", "default": "entry", "creator": "telenano"})
        entry = _group(file, "entry", "NXentry", title=facts.title, experiment_technique="AFM", scan_mode=facts.mode)
        # Readers recognise a group of the class NXdata by this beginning of its name.
        entry.attrs["default"] = f"data_{next(iter(plots))}"
        entry["definition"] = "NXafm"
        entry["definition"].attrs["version"] = DEFINITION
        for name, value in (("start_time", facts.began), ("end_time", facts.ended)):
            if value:
                entry[name] = value
        process = _group(entry, "process", "NXprocess", program="telenano")
        process["program"].attrs.update({"version": facts.version, "program_url": _UNKNOWN})
        _group(entry, "user", "NXuser", name=_UNKNOWN)
        _group(entry, "sample", "NXsample", name=facts.sample or _UNKNOWN)
        frame = _group(entry, "scanner_frame", "NXcoordinate_system", origin="undeflected piezo position",
                       type="cartesian", z_direction="from sample towards probe", depends_on=".")  # fmt: skip
        for number, axis in enumerate("xyz"):
            frame[axis] = np.eye(3)[number]
        _instrument(entry, facts)
        for name, plot in plots.items():
            data = _group(entry, f"data_{name}", "NXdata", title=plot.title, **plot.fields)
            data.attrs["signal"] = plot.signal
            data.attrs["axes"] = list(plot.axes)
            for place, axis in enumerate(plot.axes):
                data.attrs[f"{axis}_indices"] = place
        notes = _group(entry, "telenano", "NXcollection")
        for name, text in facts.notes.items():
            notes[name.replace("/", "_")] = text


def _instrument(entry: Any, facts: Facts) -> None:
    instrument = _group(entry, "instrument", "NXinstrument")
    _group(instrument, "hardware", "NXfabrication", name=facts.instrument, vendor=_UNKNOWN)
    _group(instrument, "software", "NXfabrication", name="telenano", vendor="telenano", model=facts.version)
    if facts.cantilever:
        cantilever = _group(instrument, "cantilever", "NXspm_cantilever")
        _group(cantilever, "cantilever_config", "NXspm_cantilever_config", **facts.cantilever)
    control = _group(_group(instrument, "scan_environment", "NXenvironment"), "scan_control", "NXspm_scan_control")
    region = _group(control, "scan_region", "NXspm_scan_region")
    if facts.raster is not None:
        pixels, rows, width, depth = facts.raster
        control["scan_type"] = "mesh"
        sizes = {"step_size_x": Field(width / pixels, "m"), "step_size_y": Field(depth / rows, "m")}
        _fields(region, {"scan_range_x": Field(width, "m"), "scan_range_y": Field(depth, "m")})
        _group(control, "mesh_scan", "NXspm_scan_pattern", scan_points_x=pixels, scan_points_y=rows, **sizes)
    if facts.ramp is not None:
        points, low, high = facts.ramp
        _fields(region, {"scan_start_z": Field(low, "m"), "scan_end_z": Field(high, "m")})
        place = {"scan_points_x": 1, "scan_points_y": 1, "scan_points_z": points}
        _group(control, "point_force_scan", "NXspm_scan_pattern", **place)
        if facts.raster is None:
            control["scan_type"] = "linear"


def _group(parent: Any, label: str, kind: str, /, **fields: Any) -> Any:
    group = parent.create_group(label)
    group.attrs["NX_class"] = kind
    _fields(group, fields)
    return group


def _fields(group: Any, fields: Mapping[str, Any]) -> None:
    for name, value in fields.items():
        values, unit, about = value if isinstance(value, Field) else (value, "", "")
        # A scalar cannot be compressed.
        group.create_dataset(name, data=values, **({"compression": "gzip"} if np.ndim(values) else {}))
        group[name].attrs.update({key: text for key, text in (("units", unit), ("long_name", about)) if text})


def _plot_of(image: Image) -> Plot:
    """Return the plot of a channel of an image over the middles of its pixels; y rises with the row."""
    rows, pixels = image.values.shape
    across = (np.arange(pixels) + 0.5) * image.width_m / pixels
    along = (np.arange(rows) + 0.5) * image.depth_m / rows
    fields = {
        "data": Field(np.asarray(image.values, dtype=np.float64), image.unit, image.caption),
        "y": Field(along, "m", "y, slow axis"),
        "x": Field(across, "m", "x, fast axis"),
    }
    return Plot(image.caption, "data", ("y", "x"), fields)


def _origin_ns(recording: Recording) -> int:
    """Return the time at which the operator's force profile last began [ns]; without one, the recording's beginning."""
    if any(channel.channel_topic == "haptic/state" for channel in recording.channels):
        hand = recording.columns("haptic/state", ("session_s", "t_ns"))
        running = last_force_profile(hand["session_s"], hand["t_ns"])
        if running.size > 1:
            first = running[0]
            return int(hand["t_ns"][first] - round(hand["session_s"][first] * 1e9))
    return int(recording.span_ns[0])


def _courses(recording: Recording, wanted: Mapping[str, str], origin_ns: int) -> Iterator[tuple[str, Plot]]:
    """Yield the plots of tip, force against distance, and hand, on the clock of the session."""
    timeline = Timeline(recording)

    def read(channel: str, *names: str) -> dict[str, Any]:
        table = recording.columns(channel, ("publish_ns", "log_ns", *names))
        times_ns = timeline.times_ns(wanted[channel], table["publish_ns"], table.pop("log_ns"))
        table["time"] = 1e-9 * (times_ns - origin_ns)
        return table

    clock = "Time since the start of the operator's force profile"
    if "afm/state" in wanted:
        tip = read(
            "afm/state", "tip_force_n.2", "base_position_m.2", "deflection_m", "separation_m", "separation_valid"
        )
        apart = np.where(tip["separation_valid"], tip["separation_m"], np.nan)
        fields = {
            "time": Field(tip["time"], "s", clock),
            "tip_force": Field(tip["tip_force_n.2"], "N", "Force on the tip by the sample, repulsive is positive"),
            "base_position": Field(
                tip["base_position_m.2"], "m", "Position of the base, positive away from the sample"
            ),
            "deflection": Field(tip["deflection_m"], "m", "Deflection, positive away from the sample"),
            "separation": Field(apart, "m", "Distance of tip and sample, NaN where it is not known"),
        }
        yield "tip", Plot("Force on the tip over time", "tip_force", ("time",), fields)
        if np.isfinite(apart).any():
            curve = {name: fields[name] for name in ("separation", "tip_force", "time")}
            yield "force_distance", Plot("Force against distance", "tip_force", ("separation",), curve)
    if "haptic/state" in wanted:
        hand = read("haptic/state", "operator_force_n.2", "position_m.2")
        yield "hand", Plot("Force of the hand over time", "operator_force", ("time",), {
            "time": Field(hand["time"], "s", clock),
            "operator_force": Field(hand["operator_force_n.2"], "N", "Force of the hand, away from the sample"),
            "hand_position": Field(hand["position_m.2"], "m", "Position of the hand, positive away from the sample"),
        })  # fmt: skip


def _images(recording: Recording) -> Iterator[LiveImage]:
    """Yield the images of a recording that have a complete line."""
    lines = (message.decode() for message in recording.messages(("afm/scanline",)))
    for image in _each_image(line for line in lines if isinstance(line, AfmScanline)):
        if image.finished:
            yield image


def _each_image(lines: Iterable[AfmScanline]) -> Iterator[LiveImage]:
    image = LiveImage()
    for line in lines:
        # The first line, trace, begins another image.
        if line.line == 0 and line.direction == "trace" and image.trace_m.size:
            yield image
            image = LiveImage()
        image.add(line)
    yield image


def _facts_of(recording: Recording, mode: str) -> Facts:
    versions = recording.metadata.get("versions", {})
    notes = {name: data.decode(errors="replace") for name, data in recording.attachments.items()}
    notes |= {f"{name}.json": json.dumps(facts, ensure_ascii=False) for name, facts in recording.metadata.items()}
    version = f"{versions.get('package telenano', _UNKNOWN)}, commit {versions.get('commit', _UNKNOWN)}"
    began, ended = (datetime.fromtimestamp(at_ns / 1e9, UTC).isoformat() for at_ns in recording.span_ns)
    facts = Facts(
        f"{recording.path.stem}: a session of remote touch", mode, _UNKNOWN, version, began=began, ended=ended
    )
    try:
        scenario = LoadedScenario.attached(recording.path, recording.attachments).scenario
        afm = validate(AfmConfig, scenario.afm_node, str(recording.path), "afm_node")
    except (ConfigError, RecordingError):
        # A recording without its scenario, or with one of a package that is not installed, still has its values.
        return facts._replace(notes=notes)
    lever = {
        "spring_constant": Field(afm.cantilever.stiffness_n_per_m, "N/m"),
        "resonance_frequency": Field(afm.cantilever.resonance_hz, "Hz"),
    }
    sample = afm.environment if afm.sample is None else afm.sample.map or afm.sample.name
    return facts._replace(
        title=f"{scenario.name}: a session of remote touch",
        instrument=f"AFM, driver {afm.driver}",
        sample=sample,
        # The cantilever of a real instrument is in its own calibration.
        cantilever=lever if afm.driver == "simulated" else {},
        notes=notes,
    )
