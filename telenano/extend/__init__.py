"""What a package that extends telenano imports, one module a kind.

`telenano new law NAME` makes such a package; docs/extending.md explains each kind.
"""
