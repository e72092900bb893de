"""Images of your own as files, written whole into a folder, and a format of your own for the images of others."""

from pathlib import Path

from telenano.cli import say
from telenano.settings import code_of, installed, load
from telenano.wire import TelenanoError
from telenano_lab.microscopy.image_files import Image, ImageFacts


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
    from telenano_lab.microscopy.image_files import write_gsf, write_gwy, write_png

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
            with code_of(installed("images")[name].package):
                write(path, images, facts)
            files.append(path.name)
        except TelenanoError as error:
            path.unlink(missing_ok=True)
            formats.problems[name] = str(error)
    for name, problem in formats.problems.items():
        say(f"scan.{name} was not written: {problem}")
    return files
