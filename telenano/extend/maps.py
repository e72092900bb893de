"""Recorded maps that a rig feels: what a map is, whether it can be felt, and its file."""

from telenano.afm.sample.force_map import MEMBERS as MEMBERS
from telenano.afm.sample.force_map import SI_UNITS as SI_UNITS
from telenano.afm.sample.force_map import UNITS as UNITS
from telenano.afm.sample.force_map import Array as Array
from telenano.afm.sample.force_map import ForceMap as ForceMap
from telenano.afm.sample.force_map import MapError as MapError
from telenano.afm.sample.force_map import checked_map as checked_map
from telenano.afm.sample.force_map import gates as gates
from telenano.afm.sample.force_map import read_members as read_members
from telenano.afm.sample.force_map import write_map as write_map
