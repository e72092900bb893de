"""Ways between two machines beside TCP, which packages bring: entry points `telenano.transports` (docs/extending.md).

A site file names one in `link.transport`. Two names are of telenano itself: `stream`, everything over TCP; and `auto`,
the transport that KNOWN_TRANSPORT names, where it is installed, and TCP where it is not.
"""

import importlib
from collections.abc import Mapping
from typing import Any, NamedTuple

from telenano.settings import plugins
from telenano.settings.config import Settings, validate
from telenano.settings.known_packages import KNOWN_PACKAGES, KNOWN_TRANSPORT
from telenano.wire.errors import ConfigError, known_names
from telenano.wire.extras import how_to_add_package

STREAM, AUTO = "stream", "auto"


class LinkTransport(NamedTuple):
    """What an entry of the kind `transports` is; every process of two machines may read it, and so it loads nothing.

    Such as `TRANSPORT = LinkTransport(MySettings, ends="my_package.ends:open_ends")`. What is named as `module:name` is
    imported where it is used.

    Attributes:
        settings: The model of the section `link` of a site file: `transport`, and the keys of this transport.
        ends: Opens an end, in the two processes that the link ends in (`telenano.runtime.OpenEnds`).
        beside: A module that is run with `--site SITE --site-file FILE` beside the nodes of each site where the site
            file has a relay; empty where the transport knows none.
        sender: Sends the recording of the slave's site (`telenano.runtime.SendsPieces`); empty for none.
        fetch: Fetches it at the master's (`telenano.runtime.FetchRecording`); empty for none.
    """

    settings: type[Settings]
    ends: str
    beside: str = ""
    sender: str = ""
    fetch: str = ""


def named(name: str) -> LinkTransport:
    """Return the transport of a name, `auto` and `stream` being the one that is known; ConfigError where there is none.

    The error names the package to install, or what is wrong with one that is installed.
    """
    entry = KNOWN_TRANSPORT if name in (AUTO, STREAM) else name
    loaded = plugins.load("transports", _checked, taken=(AUTO, STREAM), only=entry)
    if entry in loaded.found:
        return loaded.found[entry]
    if entry in loaded.problems:
        raise ConfigError(loaded.problems[entry])
    if package := KNOWN_PACKAGES.get(f"transport {entry}"):
        raise ConfigError(f"the transport {entry!r} is in the package {package}: {how_to_add_package(package)}")
    names = (AUTO, STREAM, KNOWN_TRANSPORT, *plugins.installed("transports"))
    raise ConfigError(f"no such transport {entry!r}, {known_names(entry, dict.fromkeys(names))}")


def check_link(transport: str, keys: Mapping[str, Any], origin: str, *, relayed: bool) -> None:
    """Check the section `link` of a site file by the model of its transport.

    Nothing is looked up for a section that TCP alone can satisfy.

    Raises:
        ConfigError: The transport is not installed, knows no relay, or refuses the keys.
    """
    if not relayed and not keys and transport in (AUTO, STREAM):
        return
    asks = "relay" if relayed else f"link.{next(iter(keys), 'transport')}"
    try:
        transport_named = named(transport)
    except ConfigError as error:
        raise ConfigError(f"{origin}: {asks}: {error}") from error
    if relayed and not transport_named.beside:
        raise ConfigError(f"{origin}: relay: the transport {transport!r} reaches no relay")
    validate(transport_named.settings, {"transport": transport, **keys}, origin, "link")


def fetching() -> LinkTransport:
    """Return the installed transport that fetches the other site's recording, the known one first.

    Without any it is one that has neither `sender` nor `fetch`.
    """
    for name in sorted(plugins.installed("transports"), key=lambda name: (name != KNOWN_TRANSPORT, name)):
        row = plugins.load("transports", _checked, taken=(AUTO, STREAM), only=name).found.get(name)
        if row is not None and row.fetch:
            return row
    return LinkTransport(Settings, ends="")


def imported(target: str) -> Any:
    """Return what `module:name` names."""
    module, _, name = target.partition(":")
    return getattr(importlib.import_module(module), name)


def _checked(_: str, value: Any) -> LinkTransport:
    if not isinstance(value, LinkTransport):
        raise TypeError(f"is a {type(value).__name__}, must be a LinkTransport")
    return value
