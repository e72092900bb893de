"""Fill the cache of an image: matplotlib searches for fonts now, which would delay the first figure by seconds."""

import sys

if __name__ == "__main__":
    if sys.argv[1] in ("session", "study"):
        from matplotlib import font_manager

        font_manager.fontManager.findfont("sans")
