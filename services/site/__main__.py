"""Run the nodes of a site that the launcher joins in one process."""

import gc

if __name__ == "__main__":
    # The imports make nothing that could be collected, and to look for it takes an eighth of their time.
    gc.disable()

import sys

from telenano.runtime.site.site_process import run_site

if __name__ == "__main__":
    sys.exit(run_site())
