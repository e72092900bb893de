"""The names of this project's laws that move the tip, in the order in which they are listed and drawn.

They stand by themselves, so that the shell's completion need not import a law; a test compares them with the table of
`telenano.sections`. A name that is added makes other cells of a seed that `telenano study validate` draws.
"""

LAW_NAMES = ("virtual_impedance", "position_force", "wave", "passivity")
