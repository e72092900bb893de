"""A reader of one's own for files of instruments: which functions read them, called in a child process with limits."""

from presets.regular_files import open_regular
from services.runtime.untrusted.file_readers import FileReader
from services.runtime.untrusted.limited_child import Limits, limits_for, read_in_child

__all__ = ["FileReader", "Limits", "limits_for", "open_regular", "read_in_child"]
