"""Text tables of other programs, with the units that their heads give, for a package that reads them."""

from telenano.files.text_tables import Column as Column
from telenano.files.text_tables import TextTable as TextTable
from telenano.files.text_tables import as_number as as_number
from telenano.files.text_tables import decoded as decoded
from telenano.files.text_tables import parse_table as parse_table
from telenano.files.text_tables import read_table as read_table
from telenano.files.units import Unit as Unit
from telenano.files.units import unit_of as unit_of
