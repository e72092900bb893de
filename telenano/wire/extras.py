"""How what is missing is installed: by the extra of this distribution that has it, from where it was installed."""

import re
import sys
from pathlib import Path

DISTRIBUTION = "telenano"
# the distributions of the project beside it
OWN_PACKAGES = ("telenano-bridges", "telenano-devices", "telenano-lab", "telenano-laws", "telenano-wide-area")
# These distributions have another name than their module.
_DISTRIBUTIONS = {"serial": "pyserial", "yaml": "pyyaml", "zmq": "pyzmq"}
_EXTRA = re.compile(r"extra == ['\"]([^'\"]+)['\"]")


def how_to_install(extra: str) -> str:
    """Return the command that adds an extra to this installation, such as `pip install '/a/telenano.whl[view]'`."""
    editable, source = _source()
    return f"pip install {'-e ' if editable else ''}'{source}[{extra}]'"


def how_to_add_package(package: str) -> str:
    """Return the command that adds a package of the project: to a checkout, or as a wheel of the release.

    Args:
        package: The name of a distribution, with an extra where one is needed, such as `telenano-lab[experiments]`.
    """
    from importlib.metadata import version

    editable, source = _source()
    if editable and Path(sys.prefix) == Path(source, ".venv"):
        return f"make -C '{source}' setup"
    if editable:
        return f"pip install -e '{source}/packages/{package}'"
    # A file and no name, because the index may have a stranger's package of that name.
    name, bracket, extra = package.partition("[")
    wheel = f"{name.replace('-', '_')}-{version(DISTRIBUTION)}-py3-none-any.whl{bracket}{extra}"
    return f"pip install '{wheel}'" if bracket else f"pip install {wheel}"


def extra_of(module: str) -> str:
    """Return the smallest extra that a module comes with, `rig`, which has all that a rig uses, where none names it."""
    return _extra_in(DISTRIBUTION, module) or "rig"


def _extra_in(distribution: str, module: str) -> str:
    """Return the smallest extra of a distribution that a module comes with; empty where none names it."""
    from packaging.requirements import Requirement
    from packaging.utils import canonicalize_name

    top = module.partition(".")[0]
    wanted = canonicalize_name(_DISTRIBUTIONS.get(top, top))
    sizes: dict[str, int] = {}
    having: list[str] = []
    for requirement in map(Requirement, _required(distribution)):
        extra = extra_in(requirement.marker)
        if not extra:
            continue
        sizes[extra] = sizes.get(extra, 0) + 1
        if canonicalize_name(requirement.name) == wanted:
            having.append(extra)
    # Of two that bring the same the shorter name is the plainer one.
    return min(having, key=lambda extra: (sizes[extra], len(extra), extra), default="")


def extra_in(marker: object) -> str:
    """Return the extra that the marker of a requirement names, empty where it names none."""
    match = _EXTRA.search(str(marker))
    return match[1] if match else ""


def missing(module: str) -> str:
    """Return that a package is missing and what adds it: `scipy is not installed: pip install 'telenano[studies]'`."""
    top = module.partition(".")[0]
    if not _extra_in(DISTRIBUTION, top):
        for package in OWN_PACKAGES:
            if extra := _extra_in(package, top):
                return f"{top} is not installed: {how_to_add_package(f'{package}[{extra}]')}"
    return f"{top} is not installed: {how_to_install(extra_of(top))}"


def _required(distribution: str) -> list[str]:
    from importlib import metadata

    try:
        return metadata.requires(distribution) or []
    except metadata.PackageNotFoundError:
        return []


def _source() -> tuple[bool, str]:
    """Return whether this installation is a checkout in use, and what pip was given: a folder, a wheel or a name."""
    import json
    from importlib import metadata
    from urllib.parse import unquote, urlsplit

    try:
        text = metadata.distribution(DISTRIBUTION).read_text("direct_url.json")
    except metadata.PackageNotFoundError:
        return False, DISTRIBUTION
    origin = json.loads(text) if text else {}
    address = urlsplit(str(origin.get("url", "")))
    if address.scheme == "file":
        return bool(origin.get("dir_info", {}).get("editable")), unquote(address.path)
    return False, str(origin.get("url") or DISTRIBUTION)
