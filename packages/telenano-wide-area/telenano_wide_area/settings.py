"""Settings of the datagrams in section `link` of a site file."""

from typing import Literal

from pydantic import Field

from telenano.settings import Settings


class DatagramSettings(Settings):
    """Transport between two machines for topics of which a reader wants only the newest message."""

    transport: Literal["auto", "datagram", "stream"] = Field(
        default="auto",
        description="datagram: over UDP; stream: over the TCP connections, as everything else; auto: over UDP, and "
        "over TCP while no datagram arrives",
    )
    port: int | None = Field(
        default=None, ge=1, le=65535, description="UDP port at the master; that of delay_node@slave, if not given"
    )
    repeats: int | None = Field(
        default=None,
        ge=0,
        le=4,
        description="Older samples that each datagram repeats; chosen by the observed loss, if not given",
    )
    play_out: bool = Field(
        default=False,
        description="Hold arriving samples to a delay that hardly varies, for laws that want one; every sample is "
        "then older",
    )
    direct: bool = Field(
        default=True,
        description="With a relay: try to reach the other site without it, so that each site learns the other's "
        "address; otherwise all datagrams go through the relay",
    )
    budget_kbit_per_s: float = Field(
        default=6000.0, ge=100.0, le=1e6, description="Greatest rate of each end's datagrams, headers included [kbit/s]"
    )
