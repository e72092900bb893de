"""Images of your own as files, written whole into a folder, and a format of your own for the images of others."""

from pathlib import Path

import typer

from telenano.settings import fault_of_package, load
from telenano_microscopy.image_files import Image, ImageFacts


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
    from telenano.recording import versions
    from telenano_microscopy.image_files import write_gsf, write_gwy, write_png

    write_gsf(out / "scan.gsf", images["height"])
    write_gwy(out / "scan.gwy", images)
    write_png(out / "scan.png", images)
    files, own = ["scan.gwy", "scan.gsf", "scan.png"], ("gwy", "gsf", "png")
    versions_here = versions()
    facts = ImageFacts(
        mode, instrument, f"{versions_here['package telenano']}, commit {versions_here['commit']}", sample
    )
    formats = load("images", taken=own)
    for name, write in formats.found.items():
        path = out / f"scan.{name}"
        # An image that cannot be taken again is not lost by the code of a package.
        try:
            write(path, images, facts)
            files.append(path.name)
        except Exception as error:  # noqa: BLE001
            path.unlink(missing_ok=True)
            formats.problems[name] = fault_of_package(error) or str(error)
    for name, problem in formats.problems.items():
        typer.echo(f"telenano: scan.{name} was not written: {problem}", err=True)
    return files
