"""Images of one's own as files: Gwyddion, GSF, NeXus and PNG, written whole into a folder."""

from analysis.image_files import Image
from telenano.cli.commands.scan import write_images
from telenano.cli.sample_options import results_in

__all__ = ["Image", "results_in", "write_images"]
