"""Times the parts of a hop in each node of the loop; Python imports this at its start if PYTHONPATH has this folder.

`loop.py` sets PYTHONPATH for its traced rigs, and the processes of the rig inherit it.
"""

import atexit
import sys
from pathlib import Path

_TRACED = ("services.haptic_node", "services.controller", "services.delay_node", "services.afm_node")

if "services.site" in sys.orig_argv:
    sys.path.insert(0, str(Path(__file__).parents[1]))
    import site_trace

    atexit.register(site_trace.install())
elif (node := next((name for name in _TRACED if name in sys.orig_argv), "")) and "--site" in sys.orig_argv:
    sys.path.insert(0, str(Path(__file__).parents[1]))
    import hop_trace

    from telenano.runtime.loop.log import StructuredLog

    site = sys.orig_argv[sys.orig_argv.index("--site") + 1]
    atexit.register(hop_trace.install(StructuredLog(f"{node.rpartition('.')[2]}@{site}")))
