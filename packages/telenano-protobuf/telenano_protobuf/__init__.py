"""Recordings of telenano as MCAP with protobuf."""
