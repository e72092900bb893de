"""`telenano scan`: take an image of a sample, in simulated time on this machine or with a running rig."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from telenano.cli import (
    EXIT_FAILED,
    JsonOption,
    Keys,
    SiteFileOption,
    Void,
    print_document,
    progress,
    report_errors,
    results_in,
    rules,
    say,
    validated,
    with_options,
)
from telenano.settings import DEFAULT_SITE_FILE, ScanSettings, flag_overrides, validate
from telenano.signals import finishing
from telenano.wire import ConfigError, RigError
from telenano_lab.microscopy.program_view import LIVE_RULES, AfmOption, LiveOption, decided_by_rig, follow_program
from telenano_lab.microscopy.row_levels import (
    LEVEL_RULES,
    AboveOption,
    AlignOption,
    BelowOption,
    Levels,
    aligned_image,
)
from telenano_lab.microscopy.sample_options import (
    ChannelOption,
    SampleOption,
    SampleSetOption,
    SampleSizeOption,
    sample_config,
)

if TYPE_CHECKING:
    from telenano.wire import Scalar
    from telenano_lab.microscopy.image_files import Image
    from telenano_lab.microscopy.simulated_image import SimulatedImage

# Fields of the model that have options of their own.
_OWN = {
    "mode": "--mode",
    "setpoint_n": "--setpoint",
    "setpoint_share": "--setpoint",
    "width_m": "--size",
    "depth_m": "--size",
}


@rules(
    *LIVE_RULES,
    *LEVEL_RULES,
    decided_by_rig("--sample, --channel, --set, --afm, --temperature, --noise-seed"),
    Void("--noise-seed", "which make a noise", unless="--temperature, --afm"),
    Keys("--temperature", "disturbances.thermal.temperature_k, disturbances.thermal.enabled", "--afm"),
    Keys("--noise-seed", "disturbances.seed", "--afm"),
)
@with_options(ScanSettings, _OWN)
def scan(
    out: Annotated[
        Path, typer.Option("--out", metavar="DIR", help="Folder for scan.gwy, scan.gsf, scan.png; packages add more.")
    ],
    given: dict[str, Any],
    name: SampleOption = "dots",
    size: SampleSizeOption = None,
    channel: ChannelOption = None,
    settings: SampleSetOption = None,
    asked_mode: Annotated[
        Literal["contact", "tapping"] | None,
        typer.Option(
            "--mode",
            help="contact: the force is held; tapping: the amplitude, for which a rig needs afm_node.model dynamic;"
            " default: tapping, with --live contact.",
        ),
    ] = None,
    setpoint: Annotated[
        float | None,
        typer.Option("--setpoint", metavar="X", help="Share of the amplitude, or force [nN] in contact; 0.8 or 5."),
    ] = None,
    temperature: Annotated[
        float, typer.Option("--temperature", metavar="K", help="Temperature of the thermal noise [K]; 0: none.")
    ] = 0.0,
    seed: Annotated[int, typer.Option("--noise-seed", min=0, metavar="N", help="Seed of the thermal noise.")] = 0,
    align: AlignOption = None,
    above: AboveOption = None,
    below: BelowOption = None,
    afm: AfmOption = None,
    live: LiveOption = False,
    site_file: SiteFileOption = DEFAULT_SITE_FILE,
    as_json: JsonOption = False,
) -> None:
    """Image a sample and write .gwy, .gsf and PNG; Ctrl-C and SIGTERM end the image and keep the lines so far."""
    with report_errors(as_json):
        mode = asked_mode or ("contact" if live else "tapping")
        # A running rig has a mode of its own, which only a person changes.
        given |= {"mode": asked_mode} if asked_mode else {}
        if setpoint is not None:
            given |= {"setpoint_share": setpoint} if mode == "tapping" else {"setpoint_n": setpoint * 1e-9}
        levels = Levels(align, above, below)
        if live and size is not None:
            given |= {"width_m": size * 1e-9, "depth_m": size * 1e-9}
        wanted = validated(ScanSettings, given, _OWN)
        if live:
            _scan_live(out, site_file, wanted, given, levels, as_json=as_json)
            return
        from telenano.sections import AfmConfig
        from telenano_lab.microscopy.image_output import write_images
        from telenano_lab.microscopy.simulated_image import take_image

        sample = sample_config(name, size, channel, settings)
        model = "dynamic" if mode == "tapping" else "quasi_static"
        keys_of_afm = [f"model={model}", f"disturbances.seed={seed}"]
        if temperature:
            keys_of_afm += ["disturbances.thermal.enabled=true", f"disturbances.thermal.temperature_k={temperature}"]
        section = flag_overrides([*keys_of_afm, *(afm or ())])
        # The instrument checks the sample as well, for example that its base clears the features on it.
        section["sample"] = sample.model_dump(mode="json", exclude_unset=True)
        config = validate(AfmConfig, section, "--afm")
        keys: dict[str, Scalar] = {"scan.mode": mode, **{f"scan.{key}": value for key, value in given.items()}}
        with finishing() as finish, results_in(out) as folder:
            with progress("lines", wanted.lines, shown=not as_json, counted=True) as show:

                def advanced(n: int, of: int) -> bool:
                    if n == of:
                        finish()
                    show(n)
                    return True

                image = take_image(config, keys, advanced)
            finish()
            is_reported = _say_if_interrupted(finish.exit_code, image.lines.partial)
            images = _aligned(_images(image), levels)
            files = write_images(folder, images, mode, sample=sample.name)
    document: dict[str, Any] = {
        "sample": sample.name,
        "mode": mode,
        "lines": image.lines.finished,
        "pixels": wanted.pixels,
        "simulated_s": image.simulated_s,
        "rms_error_m": image.rms_error_m,
        "correlation": image.correlation,
        "files": [str(out / name) for name in files],
    }
    if image.lines.partial:
        document["partial"] = image.lines.partial
    if images["height"].log:
        document["steps"] = list(images["height"].log)
    print_document(document, str(out), as_json=as_json)
    _exit_if_interrupted(finish.exit_code, is_reported, image.lines.partial)


def _scan_live(
    out: Path,
    site_file: Path,
    settings: ScanSettings,
    given: "dict[str, Scalar]",
    levels: Levels,
    *,
    as_json: bool,
) -> None:
    """Take an image with a running rig and write its lines, even if it ended early."""
    from telenano_lab.microscopy.image_files import LiveImage, images_of_lines
    from telenano_lab.microscopy.image_output import write_images

    image = LiveImage()
    # The rig decides the values that were not given.
    parameters: dict[str, Scalar] = {"program": "scan", **{f"scan.{name}": value for name, value in given.items()}}
    failure: RigError | KeyboardInterrupt | None = None
    is_reported, files, steps = False, list[str](), list[str]()
    with finishing() as finish, results_in(out) as folder:
        try:
            report = follow_program(site_file, parameters, image, as_json=as_json, on_end=finish)
        except (RigError, KeyboardInterrupt) as error:
            # Lines received before the instrument fell silent, or before a second signal, are kept as well.
            failure = error
        finish()
        if count := image.finished:
            is_reported = _say_if_interrupted(finish.exit_code, image.partial)
            images = _aligned(images_of_lines(image, count), levels)
            steps = list(images["height"].log)
            files = write_images(folder, images, settings.mode, "the running rig")
    if failure is not None:
        raise RigError(f"{failure or 'interrupted'}; {out} has {count} lines") if count else failure
    document = {"mode": settings.mode, "state": report.state, "lines": count, "pixels": settings.pixels,
                "text": report.text, "files": [str(out / name) for name in files]}  # fmt: skip
    if image.partial:
        document["partial"] = image.partial
    if steps:
        document["steps"] = steps
    print_document(document, str(out), as_json=as_json)
    # An image that has not begun does not know its number of lines.
    _exit_if_interrupted(finish.exit_code, is_reported, image.partial if count else "no lines")
    if report.state != "finished":
        raise typer.Exit(EXIT_FAILED)


def _aligned(images: "dict[str, Image]", levels: Levels) -> "dict[str, Image]":
    """Return channels with aligned rows of the heights; print why if a channel cannot be aligned, and keep it."""
    done = dict(images)
    for name in ("height", "retrace"):
        try:
            done[name] = aligned_image(images[name], levels.method, levels.above_nm, levels.below_nm)
        except ConfigError as error:
            # A limit that is too narrow must not lose an image of a real tip.
            say(f"the rows of {name} are left as they are: {error}")
    return done


def _say_if_interrupted(code: int, partial: str) -> bool:
    """Print how much is kept of an image that a signal ended; return whether one did."""
    if code:
        say(f"interrupted: {partial or 'all lines'} are kept")
    return bool(code)


def _exit_if_interrupted(code: int, is_reported: bool, partial: str) -> None:
    """Exit with the code of a signal that ended the image or came while it was written."""
    if code:
        if not is_reported:
            _say_if_interrupted(code, partial)
        raise typer.Exit(code)


def _images(image: "SimulatedImage") -> "dict[str, Image]":
    """Return the channels of an image at the level of the truth, and the surface that the tip sees."""
    from telenano_lab.microscopy.image_files import Image, images_of_lines

    lines, count = image.lines, image.lines.finished
    images = images_of_lines(lines, count)
    level_m, depth_m = float(image.truth_m[:count].mean()), lines.depth_m * count / len(lines.trace_m)
    for name in ("height", "retrace"):
        images[name] = images[name]._replace(values=images[name].values + level_m)
    title = "Surface as the tip sees it"
    images["truth"] = Image(title, "m", image.truth_m[:count], lines.width_m, depth_m, lines.partial)
    return images
