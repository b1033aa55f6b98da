"""Where the page is served, and who may open it."""

import re
import ssl
from dataclasses import dataclass
from ipaddress import ip_address

from omniman_ros.core.errors import ParameterError
from omniman_ros.core.parameters import parameter
from omniman_ros.core.validated import Validated

#: Characters and lengths that a token may have: those that an address can contain as they are
TOKEN = re.compile(r"[A-Za-z0-9_-]{8,200}")


def is_loopback(host: str) -> bool:
    """Return whether an address or a name can only be reached from this machine."""
    if host.lower() == "localhost":
        return True
    try:
        return ip_address(host).is_loopback
    except ValueError:
        return False


@dataclass(frozen=True, kw_only=True)
class PageAccess(Validated):
    """Address of the page, its token, and the files that encrypt it."""

    host: str = parameter(
        "127.0.0.1",
        "Address to serve the page on; with one that others can reach, the page asks for a token.",
        read_only=True,
    )
    port: int = parameter(
        8080,
        "Port of the page; if it is in use, the next free one is used.",
        low=1,
        high=65535,
        read_only=True,
    )
    token: str = parameter(
        "",
        "Token that the page asks for; empty: a random one, or none if only this machine can "
        "reach the page.",
        read_only=True,
    )
    tls_certificate: str = parameter(
        "", "File with the certificate (PEM) for https; empty: http.", read_only=True
    )
    tls_key: str = parameter("", "File with the key of the certificate (PEM).", read_only=True)

    def __post_init__(self) -> None:
        """Compare the parameters with each other.

        Raises:
            ParameterError: The token cannot be part of an address, or one of the files is missing.
        """
        super().__post_init__()
        if self.token and not TOKEN.fullmatch(self.token):
            raise ParameterError("token", "...", f"must match {TOKEN.pattern}")
        if bool(self.tls_certificate) != bool(self.tls_key):
            label = "tls_key" if self.tls_certificate else "tls_certificate"
            raise ParameterError(label, "", "is needed, too: certificate and key go together")

    @property
    def needs_token(self) -> bool:
        """Whether the page asks for a token."""
        return bool(self.token) or not is_loopback(self.host)

    def tls(self) -> ssl.SSLContext | None:
        """Return what encrypts connections, or None; useless files raise a ParameterError."""
        if not self.tls_certificate:
            return None
        context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
        try:
            context.load_cert_chain(self.tls_certificate, self.tls_key)
        except OSError as error:  # ssl.SSLError is one
            files = f"{self.tls_certificate}, {self.tls_key}"
            raise ParameterError("tls_certificate", files, f"cannot be used: {error}") from error
        return context
