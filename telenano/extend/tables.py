"""Text tables of other programs, with the units that their heads give, for a package that reads them."""

from recording.text_tables import Column as Column
from recording.text_tables import TextTable as TextTable
from recording.text_tables import as_number as as_number
from recording.text_tables import decoded as decoded
from recording.text_tables import parse_table as parse_table
from recording.text_tables import read_table as read_table
from recording.units import Unit as Unit
from recording.units import unit_of as unit_of
