"""Commands that install a missing package: the extra of this distribution that contains it, from the same source."""

import re
import sys
from pathlib import Path

DISTRIBUTION = "telenano"
# The other distributions of the project.
OWN_PACKAGES = ("telenano-bridges", "telenano-devices", "telenano-lab", "telenano-laws", "telenano-wide-area")
# Distributions whose name differs from that of their module.
_DISTRIBUTIONS = {"serial": "pyserial", "yaml": "pyyaml", "zmq": "pyzmq"}
_EXTRA = re.compile(r"extra == ['\"]([^'\"]+)['\"]")


def how_to_install(extra: str) -> str:
    """Return the command that adds an extra to this installation, such as `pip install '/a/telenano.whl[view]'`."""
    editable, source = _source()
    return f"pip install {'-e ' if editable else ''}'{source}[{extra}]'"


def how_to_add_package(package: str) -> str:
    """Return the command that adds a package of the project, from the checkout or as a wheel of the release.

    Args:
        package: The name of a distribution, with an extra if needed, such as `telenano-lab[experiments]`.
    """
    from importlib.metadata import version

    editable, source = _source()
    if editable and Path(sys.prefix) == Path(source, ".venv"):
        return f"make -C '{source}' setup"
    if editable:
        return f"pip install -e '{source}/packages/{package}'"
    # A file instead of a name, because the index may have a foreign package of that name.
    name, bracket, extra = package.partition("[")
    wheel = f"{name.replace('-', '_')}-{version(DISTRIBUTION)}-py3-none-any.whl{bracket}{extra}"
    return f"pip install '{wheel}'" if bracket else f"pip install {wheel}"


def extra_of(module: str) -> str:
    """Return the smallest extra that contains a module; `rig`, which has all that a rig needs, if none names it."""
    return _extra_in(DISTRIBUTION, module) or "rig"


def _extra_in(distribution: str, module: str) -> str:
    """Return the smallest extra of a distribution that contains a module; empty if none names it."""
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
    # Of two extras of the same size, prefer the shorter name.
    return min(having, key=lambda extra: (sizes[extra], len(extra), extra), default="")


def extra_in(marker: object) -> str:
    """Return the extra that the marker of a requirement names; empty if it names none."""
    match = _EXTRA.search(str(marker))
    return match[1] if match else ""


def missing(module: str) -> str:
    """Return the error text for a missing module: `scipy is not installed: pip install 'telenano[studies]'`."""
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
    """Return whether this installation is editable, and the argument that pip had: a folder, a wheel or a name."""
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
