"""The panel of particles on the page of a rig: their believed places, their targets, and who pushes them."""

from pathlib import Path

from telenano.serving import Panel

PANEL = Panel("particles", "Particles", "dock", Path(__file__).with_name("web") / "panel.js")
