"""Settings of the datagrams in section `link` of a site file."""

from typing import Literal

from pydantic import Field

from telenano.settings import Settings


class DatagramSettings(Settings):
    """How what a reader wants the newest of crosses between two machines."""

    transport: Literal["auto", "datagram", "stream"] = Field(
        default="auto",
        description="datagram: over UDP; stream: over the TCP connections, as everything else; auto: over UDP, and "
        "over TCP while no datagram arrives",
    )
    port: int | None = Field(
        default=None, ge=1, le=65535, description="UDP port at the master; that of delay_node@slave, if not given"
    )
    repeats: int | None = Field(
        default=None, ge=0, le=4, description="Older samples that each datagram repeats; by the loss seen, if not given"
    )
    play_out: bool = Field(
        default=False,
        description="Hold what arrives to a delay that hardly varies, for laws that want one; every sample is older",
    )
    direct: bool = Field(
        default=True,
        description="With a relay: try to reach the other site past it, whose address each site then learns; else all "
        "datagrams go through the relay",
    )
    budget_kbit_per_s: float = Field(
        default=6000.0, ge=100.0, le=1e6, description="Greatest rate of each end's datagrams, headers included [kbit/s]"
    )
