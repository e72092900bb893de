"""A reader of one's own for files of instruments: which functions read them, called in a child process with limits."""

from telenano.files.limited_child import Limits as Limits
from telenano.files.limited_child import limits_for as limits_for
from telenano.files.limited_child import read_in_child as read_in_child
from telenano.files.regular_files import open_regular as open_regular
from telenano.files.regular_files import read_regular as read_regular
from telenano.settings.file_readers import FileReader as FileReader
from telenano.signals import children as children
