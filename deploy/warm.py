"""Fill the cache of an image: matplotlib looks for fonts now, because it would take the first figure seconds."""

import sys

if __name__ == "__main__":
    if sys.argv[1] in ("session", "study"):
        from matplotlib import font_manager

        font_manager.fontManager.findfont("sans")
