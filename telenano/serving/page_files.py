"""Where the files of the page are: what it was built from, and what its panels share with pages of others."""

import importlib.util
from pathlib import Path

from telenano.wire.nodes import VIEW, module_of, name_of


def page_folder() -> Path:
    """Return the folder of the page's files, as in `page_folder() / "gallery" / "gallery.css"`.

    Raises:
        FileNotFoundError: The process of the page is not installed.
    """
    module = module_of(name_of(VIEW))
    found = importlib.util.find_spec(module)
    if found is None or found.origin is None:
        raise FileNotFoundError(f"there is no {module}, which has the files of the page")
    return Path(found.origin).parent / "web"
