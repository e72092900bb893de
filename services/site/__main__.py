"""Run the nodes of a site that the launcher joins in one process."""

import gc

if __name__ == "__main__":
    # The imports make no garbage, and the collector would take an eighth of their time to look for it.
    gc.disable()

import sys

from telenano.runtime.site.site_process import run_site

if __name__ == "__main__":
    sys.exit(run_site())
