"""A reader of one's own for files of instruments: which functions read them, called in a child process with limits."""

from services.runtime.untrusted.file_readers import FileReader as FileReader
from services.runtime.untrusted.limited_child import Limits as Limits
from services.runtime.untrusted.limited_child import limits_for as limits_for
from services.runtime.untrusted.limited_child import read_in_child as read_in_child
from services.signals import children as children
from telenano.presets.regular_files import open_regular as open_regular
from telenano.presets.regular_files import read_regular as read_regular
