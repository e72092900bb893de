"""How what is missing is installed: by the extra of this distribution that has it, from where it was installed."""

import re

DISTRIBUTION = "telenano"
# distributions whose module has another name
_DISTRIBUTIONS = {
    "google": "protobuf",
    "mcap_ros2": "mcap-ros2-support",
    "serial": "pyserial",
    "yaml": "pyyaml",
    "zenoh_ros2_sdk": "zenoh-ros2-sdk",
    "zmq": "pyzmq",
}
_REQUIREMENT = re.compile(r"^([A-Za-z0-9._-]+)(?:\[[^]]*\])?[^;]*(?:;.*extra == ['\"]([^'\"]+)['\"].*)?$")


def how_to_install(extra: str) -> str:
    """Return the command that adds an extra to this installation, such as `pip install '/a/telenano.whl[view]'`."""
    editable, source = _source()
    return f"pip install {'-e ' if editable else ''}'{source}[{extra}]'"


def extra_of(module: str) -> str:
    """Return the smallest extra that a module comes with, `rig`, which has all that a rig uses, where none names it."""
    top = module.partition(".")[0]
    wanted = _normal(_DISTRIBUTIONS.get(top, top))
    sizes: dict[str, int] = {}
    having: list[str] = []
    for line in _required():
        found = _REQUIREMENT.match(line)
        if found is None or found[2] is None:
            continue
        sizes[found[2]] = sizes.get(found[2], 0) + 1
        if _normal(found[1]) == wanted:
            having.append(found[2])
    # of two that bring the same the shorter name is the plainer one
    return min(having, key=lambda extra: (sizes[extra], len(extra), extra), default="rig")


def missing(module: str) -> str:
    """Return that a package is missing and what adds it: `scipy is not installed: pip install 'telenano[studies]'`."""
    top = module.partition(".")[0]
    return f"{top} is not installed: {how_to_install(extra_of(top))}"


def _required() -> list[str]:
    from importlib import metadata

    try:
        return metadata.requires(DISTRIBUTION) or []
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


def _normal(name: str) -> str:
    return re.sub(r"[-_.]+", "-", name).lower()
