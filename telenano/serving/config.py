"""Settings of the page's server."""

from pathlib import Path
from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field

from telenano.files.held_files import standing
from telenano.serving.access import LOOPBACK, Access, tokens_given
from telenano.serving.connections import Listener
from telenano.serving.serve import Tls, bind, checked_tls
from telenano.settings.option import Option


class ViewConfig(BaseModel):
    """Settings of the page's server: address and permitted readers. Tokens are in the environment: files are kept."""

    model_config = ConfigDict(frozen=True, strict=True, extra="forbid")

    host: Annotated[str, Option(("--host",), "ADDRESS")] = Field(
        default=LOOPBACK, description="Address to bind; beyond this machine it needs a certificate"
    )
    port: Annotated[int, Field(ge=0, le=65535)] | None = Field(
        default=None, description="Port to bind; none = 8650, or any free one"
    )
    certificate_file: Annotated[str | None, Option(("--certificate",), "FILE")] = Field(
        default=None, description="Certificate of the server (PEM)"
    )
    key_file: Annotated[str | None, Option(("--key",), "FILE")] = Field(
        default=None, description="Key of the certificate (PEM)"
    )
    names: Annotated[tuple[str, ...], Option(("--name",), "HOST", read=tuple, many=True)] = Field(
        default=(), description="Further names of the server, the first one in addresses (repeatable)"
    )
    allow: Annotated[tuple[str, ...], Option(("--allow",), "NETWORK", read=tuple, many=True)] = Field(
        default=(), description="Further networks that may connect, such as 10.0.0.0/24 (repeatable)"
    )

    @property
    def name(self) -> str:
        """The name of the server in its addresses; empty to use the bound address."""
        return next(iter(self.names), "")

    def tls(self) -> Tls | None:
        """Return the TLS files, None without TLS; raise ConfigError if one is missing or the host requires them."""
        files = [None if text is None else standing(Path(text)) for text in (self.certificate_file, self.key_file)]
        return checked_tls(self.host, *files)

    def access(self) -> Access:
        """Return the access rules of the page, with the tokens of the environment or new ones."""
        return Access.made(names=[self.host, *self.names], allow=self.allow, **tokens_given())

    def bind(self) -> Listener:
        """Bind the address and return the listener; raise EndpointError if that fails."""
        return bind(self.host, self.port)
