"""Text of others on a terminal: titles, names and errors of files, packages and messages are shown, never obeyed.

A terminal takes some characters for orders: to colour, to erase or overwrite a line, to set its title, to answer with
what it is sent. Characters that turn the direction of writing show a text in another order than it has.
"""

import re

# C0 but tabulator and line feed, DEL and C1; marks of direction; what separates lines besides a line feed
_ORDERS = re.compile("[\x00-\x08\x0b-\x1f\x7f-\x9f\u061c\u200e\u200f\u2028-\u202e\u2066-\u2069]")


def printable(text: str) -> str:
    """Return a text with each character that a terminal would obey written out as its number."""
    return _ORDERS.sub(lambda found: found[0].encode("unicode_escape").decode(), text)
