"""Path of the scenario `assembly`."""

from pathlib import Path

SCENARIO = Path(__file__).with_name("assembly.yaml")
