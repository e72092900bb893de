"""Files that people and other programs write: read within limits, and written whole or not at all."""

from typing import TYPE_CHECKING

from telenano.faces import face

if TYPE_CHECKING:
    from telenano.files.regular_files import is_own as is_own
    from telenano.files.regular_files import is_own_path as is_own_path
    from telenano.files.whole_files import locked as locked
    from telenano.files.whole_files import whole_file as whole_file
    from telenano.files.whole_files import whole_results as whole_results
else:
    __getattr__, __dir__ = face(__name__)
