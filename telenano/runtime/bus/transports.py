"""Transports between two machines beside TCP, from packages: entry points `telenano.transports` (docs/extending/io.md).

A site file names one in `link.transport`. Two names belong to telenano itself: `stream`, everything over TCP; and
`auto`, the transport that KNOWN_TRANSPORT names if it is installed, else TCP.
"""

from collections.abc import Mapping
from typing import Any, ClassVar

from telenano.settings import plugins
from telenano.settings.config import Settings, validate
from telenano.settings.known_packages import KNOWN_PACKAGES, KNOWN_TRANSPORT
from telenano.wire.errors import ConfigError, known_names
from telenano.wire.extras import how_to_add_package

# `named` returns the transport of KNOWN_TRANSPORT for both names.
STREAM = "stream"
AUTO = "auto"


class SiteFileTransport:
    """The declarations of a transport that reading a site file needs; `telenano.runtime.LinkTransport` adds its work.

    Attributes:
        settings: The model of the section `link` of a site file: `transport`, and the keys of this transport.
        reaches_relay: Whether it runs beside the nodes of a site whose site file has a `relay`.
        fetches: Whether it sends the recording of the slave's site, and fetches it at the master's.
    """

    settings: ClassVar[type[Settings]]
    reaches_relay: ClassVar[bool] = False
    fetches: ClassVar[bool] = False


def named(name: str) -> SiteFileTransport:
    """Return the transport with a name; `auto` and `stream` stand for KNOWN_TRANSPORT.

    Raises:
        ConfigError: There is no such transport. The error names the package to install, or the fault of an installed
            one.
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

    A section that needs only TCP passes without looking up a transport.

    Raises:
        ConfigError: The transport is not installed, supports no relay, or refuses the keys.
    """
    if not relayed and not keys and transport in (AUTO, STREAM):
        return
    asks = "relay" if relayed else f"link.{next(iter(keys), 'transport')}"
    try:
        transport_named = named(transport)
    except ConfigError as error:
        raise ConfigError(f"{origin}: {asks}: {error}") from error
    if relayed and not transport_named.reaches_relay:
        raise ConfigError(f"{origin}: relay: the transport {transport!r} cannot use a relay")
    validate(transport_named.settings, {"transport": transport, **keys}, origin, "link")


def fetching() -> SiteFileTransport | None:
    """Return an installed transport that fetches the other site's recording, KNOWN_TRANSPORT first, or None."""
    for name in sorted(plugins.installed("transports"), key=lambda name: (name != KNOWN_TRANSPORT, name)):
        row = plugins.load("transports", _checked, taken=(AUTO, STREAM), only=name).found.get(name)
        if row is not None and row.fetches:
            return row
    return None


def _checked(_: str, value: Any) -> SiteFileTransport:
    if not isinstance(value, SiteFileTransport):
        raise TypeError(f"is a {type(value).__name__}, must be a LinkTransport")
    return value
