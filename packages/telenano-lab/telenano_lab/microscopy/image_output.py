"""Write the files of an image into a folder, in the built-in formats and in those of installed packages."""

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
        images: The channels by name; `height` is required.
        mode: contact or tapping.
        instrument: Name of the instrument that took the image.
        sample: The sample, if known.
    """
    from telenano.recording import IMAGE_ENTRY, versions
    from telenano_lab.microscopy.image_files import write_gsf, write_gwy, write_png

    write_gsf(out / "scan.gsf", images["height"])
    write_gwy(out / "scan.gwy", images)
    write_png(out / "scan.png", images)
    files = ["scan.gwy", "scan.gsf", "scan.png"]
    versions_here = versions()
    facts = ImageFacts(
        mode, instrument, f"{versions_here['package telenano']}, commit {versions_here['commit']}", sample
    )
    own = [IMAGE_ENTRY + file.removeprefix("scan.") for file in files]
    for name in (name for name in installed("exports") if name.startswith(IMAGE_ENTRY)):
        path = out / f"scan.{name.removeprefix(IMAGE_ENTRY)}"
        loaded = load("exports", taken=own, only=name)
        problem = loaded.problems.get(name, "")
        # A failure in a package must not lose an image that cannot be taken again.
        try:
            if not problem:
                with code_of(installed("exports")[name].package):
                    loaded.found[name](path, images, facts)
                files.append(path.name)
        except TelenanoError as error:
            path.unlink(missing_ok=True)
            problem = str(error)
        if problem:
            say(f"{path.name} was not written: {problem}")
    return files
