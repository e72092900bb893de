"""Prepare and check an image: fonts are found and models compiled now, not at the first need; the view has its page."""

import sys

if __name__ == "__main__":
    if sys.argv[1] in ("session", "study"):
        from matplotlib import font_manager

        font_manager.fontManager.findfont("sans")
    if sys.argv[1] == "study":
        from telenano.doctor.report import compile_models

        compile_models(as_json=False)
    if sys.argv[1] == "viz_node":
        from services.viz_node.serve import page_folder

        if page_folder() is None:
            sys.exit("the wheel has no page of the view: npm could not build it, see above")
