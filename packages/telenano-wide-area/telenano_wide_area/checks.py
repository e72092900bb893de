"""The check of this package for `telenano doctor`."""

from telenano.extend.checks import Finding
from telenano_wide_area.datagram.sealing import KeyPair, Opener, Sealer


def check_datagrams() -> list[Finding]:
    """Seal a datagram at one end and open it at the other, with keys that both ends agree on; return the finding."""
    near, far = KeyPair(), KeyPair()
    try:
        sealer = Sealer(near.agree(far.public, is_master=True)[0])
        opener = Opener(far.agree(near.public, is_master=False)[1], now_ns=0)
        opener.open(sealer.seal(b"sample"), now_ns=0)
    except Exception as error:  # noqa: BLE001
        # A build of the library without the cipher raises an error of its own.
        advice = "install another build of `cryptography`, or give `link: {transport: stream}` in the site file"
        return [Finding("datagrams", "problem", f"{type(error).__name__}: {error}", advice)]
    return [Finding("datagrams", "ok", "the link's datagrams can be sealed and opened")]
