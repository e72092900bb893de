"""Interfaces for packages that extend telenano, one module for each kind of extension.

`telenano new law NAME` creates such a package; docs/extending.md explains each kind.
"""
