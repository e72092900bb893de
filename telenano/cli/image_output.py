"""Images of one's own as files, written whole into a folder, and a format of one's own for the images of others."""

from pathlib import Path

import typer

from telenano.analysis.image_files import Image, ImageFacts
from telenano.settings import plugins


def write_images(
    out: Path, images: dict[str, Image], mode: str, instrument: str = "simulated AFM", *, sample: str = ""
) -> list[str]:
    """Write the files of an image into a folder and return their names.

    Args:
        out: The folder.
        images: The channels; the height is `height`.
        mode: contact or tapping.
        instrument: What took the image.
        sample: The sample, where it is known.
    """
    from telenano.analysis.image_files import write_gsf, write_gwy, write_png
    from telenano.recording.provenance import versions

    write_gsf(out / "scan.gsf", images["height"])
    write_gwy(out / "scan.gwy", images)
    write_png(out / "scan.png", images)
    files, own = ["scan.gwy", "scan.gsf", "scan.png"], ("gwy", "gsf", "png")
    versions_here = versions()
    facts = ImageFacts(
        mode, instrument, f"{versions_here['package telenano']}, commit {versions_here['commit']}", sample
    )
    formats = plugins.load("images", plugins.function_of, own)
    for name, write in formats.found.items():
        path = out / f"scan.{name}"
        # An image that cannot be taken again is not lost by the code of a package.
        try:
            write(path, images, facts)
            files.append(path.name)
        except Exception as error:  # noqa: BLE001
            path.unlink(missing_ok=True)
            formats.problems[name] = plugins.fault_of_package(error) or str(error)
    for name, problem in formats.problems.items():
        typer.echo(f"telenano: scan.{name} was not written: {problem}", err=True)
    return files
