"""The folder of doubles for a script of this folder that a person starts: pytest has it from its settings."""

import sys
from pathlib import Path

sys.path.append(str(Path(__file__).parents[1] / "doubles"))
