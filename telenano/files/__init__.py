"""Files of people and other programs: reading within limits, and writing that is complete or leaves no trace."""

from typing import TYPE_CHECKING

from telenano.lazy_exports import face

if TYPE_CHECKING:
    from telenano.files.atomic_files import atomic_file as atomic_file
    from telenano.files.atomic_files import changed as changed
    from telenano.files.atomic_files import locked as locked
    from telenano.files.atomic_files import whole_folder as whole_folder
    from telenano.files.column_roles import role_of as role_of
    from telenano.files.curve_parts import Part as Part
    from telenano.files.curve_parts import orientation_of as orientation_of
    from telenano.files.curve_parts import parts_of as parts_of
    from telenano.files.limited_child import Limits as Limits
    from telenano.files.limited_child import read_in_child as read_in_child
    from telenano.files.regular_files import is_own as is_own
    from telenano.files.regular_files import open_regular as open_regular
    from telenano.files.regular_files import read_regular as read_regular
    from telenano.files.text_tables import Column as Column
    from telenano.files.text_tables import TextTable as TextTable
    from telenano.files.text_tables import as_number as as_number
    from telenano.files.text_tables import decoded as decoded
    from telenano.files.units import unit_of as unit_of
else:
    __getattr__, __dir__ = face(__name__)
