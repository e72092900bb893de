"""Recordings and images of telenano as NeXus files."""
