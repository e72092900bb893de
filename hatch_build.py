"""The wheel has the page of the view in it, where it can be built; without it `telenano view` says what is missing."""

import runpy
from pathlib import Path
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface


class PageHook(BuildHookInterface[Any]):
    """Build the page before the wheel; an editable installation has it built by `make page`."""

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        script = Path(self.root) / "services" / "viz_node" / "build_page.py"
        if version != "editable" and script.is_file():
            built = runpy.run_path(str(script))["main"]() == 0
            if not built:
                self.app.display_warning("the wheel is built without the page of `telenano view`")
