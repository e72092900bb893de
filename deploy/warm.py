"""Fill the cache of an image: its node is run until it is ready, so that its steps are compiled, in each variant."""

import os
import subprocess
import sys
import tempfile
from pathlib import Path

from services import launcher

FILES = Path(launcher.__file__).parent
READY = '"text": "ready"'
# what a scenario can choose that is compiled on its own
SETTINGS = {
    "haptic_node": ["haptic_node.operator.kind=force_profile"],
    "controller": ["controller.law=virtual_impedance"],
    "afm_node": ["afm_node.environment=tip_sample", "afm_node.environment=spring"],
}


def run_until_ready(service: str, setting: str, sockets: str) -> None:
    """Start a node alone and end it as soon as it says that it is ready; SystemExit tells what it said instead."""
    files = ["--site-file", str(FILES / "sites/local.yaml"), "--scenario", str(FILES / "scenarios/fig12.yaml")]
    command = [sys.executable, "-m", f"services.{service}", *files, "--set", setting]
    environment = {**os.environ, "TELENANO_RUNTIME_DIR": sockets}
    told = []
    with subprocess.Popen(command, env=environment, stderr=subprocess.PIPE, text=True) as node:
        for line in node.stderr or ():
            told.append(line)
            if READY in line:
                node.terminate()
    if not any(READY in line for line in told):
        raise SystemExit(f"{service} with {setting} did not get ready:\n{''.join(told)}")


def find_fonts() -> None:
    """Have matplotlib look for fonts now: it would take the first figure seconds."""
    from matplotlib import font_manager

    font_manager.fontManager.findfont("sans")


if __name__ == "__main__":
    name = sys.argv[1]
    with tempfile.TemporaryDirectory() as folder:
        for variant in SETTINGS.get(name, ()):
            run_until_ready(name, variant, folder)
    if name in ("session", "study"):
        find_fonts()
