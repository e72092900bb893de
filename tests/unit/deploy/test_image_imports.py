"""The container of a node imports neither the writer of recordings nor what draws and studies."""

import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[3]
_ABSENT = (
    "mcap zstandard rich typer matplotlib scipy numba pandas h5py pyarrow dask control starlette uvicorn websockets"
)
_IMPORTS = f"""
import sys
for name in "{_ABSENT}".split():
    sys.modules[name] = None
sys.path.insert(0, "deploy")
import entrypoint
# each container runs it before its program, which imports these again
assert "numpy" not in sys.modules and "zmq" not in sys.modules
for node in ("controller", "afm_node", "haptic_node", "delay_node"):
    __import__(f"services.{{node}}.__main__")
"""


# a driver is imported by its node; the wire of a device that takes a force in the servo's process
_DRIVERS = """
import telenano_devices.gwyscope.gwyscope_driver, telenano_devices.nanonis.nanonis_driver
import telenano_devices.force_dimension.dhd, telenano_devices.haply.haply, telenano_devices.touch.hd
"""


@pytest.mark.check("takes 1.2 s")
def test_the_nodes_their_drivers_and_their_entry_point_import_only_what_a_loop_needs() -> None:
    done = subprocess.run([sys.executable, "-c", _IMPORTS + _DRIVERS], cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
