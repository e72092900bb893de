"""The command line: parsing, printing, completion, exit codes."""

from typing import TYPE_CHECKING

from telenano.faces import face

if TYPE_CHECKING:
    from telenano.cli.model_options import validated as validated
    from telenano.cli.model_options import with_options as with_options
    from telenano.cli.sample_options import AfmOption as AfmOption
    from telenano.cli.sample_options import ChannelOption as ChannelOption
    from telenano.cli.sample_options import results_in as results_in
else:
    __getattr__, __dir__ = face(__name__)
