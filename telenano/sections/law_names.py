"""The names of this project's laws that move the tip, in the order in which they are listed and drawn.

They have a module of their own, so that shell completion imports no law; a test compares them with the table of
`telenano.sections`. Adding a name changes the cells that `telenano study validate` draws from a seed.
"""

LAW_NAMES = ("virtual_impedance", "position_force", "wave", "passivity")
