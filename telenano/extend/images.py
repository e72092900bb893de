"""Images of one's own as files, written whole into a folder, and a format of one's own for the images of others."""

from analysis.image_files import Image, ImageFacts, images_of_lines
from services.console.live_program import LiveImage
from telenano.cli.commands.scan import write_images
from telenano.cli.sample_options import results_in

__all__ = ["Image", "ImageFacts", "LiveImage", "images_of_lines", "results_in", "write_images"]
