"""The check of `telenano doctor` on the relay between two sites that can only dial out."""

import importlib.util
from typing import TYPE_CHECKING

from proto.errors import ConfigError
from proto.extras import how_to_install
from telenano.doctor.checks import Finding

if TYPE_CHECKING:
    from services.runtime.bus.address_book import AddressBook
    from services.runtime.security.keyring import Keyring

_NAME = "relay"


def check_relay(book: "AddressBook", machine: str, keyring: "Keyring") -> list[Finding]:
    """Check whether the relay of a site file is reached and lets a machine in; nothing where there is none."""
    if book.relay is None:
        return []
    if importlib.util.find_spec("cryptography") is None:
        return [Finding(_NAME, "problem", "cryptography is not installed", f"run `{how_to_install('relay')}`")]
    from services.relay.channel import Gone
    from services.relay.look import look_at_relay, seen_by_relay
    from services.runtime.relay.protocol import raw_key, split_host_port
    from services.runtime.security.access_control import AccessControl, relay_key

    try:
        access = AccessControl(machine, keyring, requires_keys=True)
        public = raw_key(relay_key(access))
    except ConfigError as error:
        return [Finding(_NAME, "problem", str(error), "correct it with `telenano keys`")]
    host, port = split_host_port(book.relay)
    assert access.own is not None
    try:
        said = look_at_relay(host, port, access.own, public)
    except Gone as error:
        advice = "start `telenano relay` there; let this machine dial its TCP port; compare its key with the one here"
        reason = str(error) or type(error).__name__
        return [
            Finding(_NAME, "problem", f"{book.relay} does not answer as the relay whose key is here: {reason}", advice)
        ]
    if "refused" in said:
        found = f"{book.relay} refuses the key of {machine}: {said['refused']}"
        return [Finding(_NAME, "problem", found, str(said.get("text")))]
    there = "; the other site is there" if said.get("present") else ""
    found = f"{book.relay} is reached by TCP and knows this machine as {said.get('name')}{there}"
    seen = seen_by_relay(host, port, access.own, public)
    if seen is None:
        advice = f"let this machine send to UDP port {port} of {host}; until then everything crosses over TCP"
        return [Finding(_NAME, "warning", f"{found}; its UDP port does not answer", advice)]
    return [Finding(_NAME, "ok", f"{found}; by UDP it sees it as {seen[0]} port {seen[1]}")]
