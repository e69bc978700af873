"""Where the page is found: the address that a tablet is sent to, its secret token, and the QR code that carries both."""

import io
import ipaddress
import re
import secrets
import socket
from dataclasses import dataclass
from pathlib import Path

from drivers.errors import DeviceNotFoundError, DeviceProtocolError

DEFAULT_PORT = 8443
TOKEN_FILE = "token"
TOKEN_BYTES = 12
ADDRESS = re.compile(r"(?:(?P<scheme>https?)://)?(?P<host>\[[0-9a-fA-F:.]+\]|[^:/\[\]]*)(?::(?P<port>\d+))?/?")


@dataclass(frozen=True, slots=True)
class PageAddress:
    """Where the server listens: an IP address of this machine, a port (0: any free one), with TLS or without."""

    host: str
    port: int
    secure: bool

    @property
    def is_loopback(self) -> bool:
        """Whether only this machine itself can reach the page."""
        return ipaddress.ip_address(self.host).is_loopback

    def netloc(self) -> str:
        """Return ``host:port`` as it stands in a URL and in a browser's Host header."""
        host = f"[{self.host}]" if ":" in self.host else self.host
        standard = self.port == (443 if self.secure else 80)
        return host if standard else f"{host}:{self.port}"

    def origin(self) -> str:
        """Return the origin that a browser gives to the page."""
        return f"{'https' if self.secure else 'http'}://{self.netloc()}"

    def url(self, token: str) -> str:
        """Return the page's whole address."""
        return f"{self.origin()}/?token={token}"


def parse_address(text: str) -> PageAddress:
    """Read ``[http://|https://][HOST][:PORT]``; without a host, this machine's address in the local network.

    Without a scheme TLS is used but for the machine itself, which a browser trusts without.
    """
    found = ADDRESS.fullmatch(text.strip())
    port = int(found["port"]) if found and found["port"] else DEFAULT_PORT
    if found is None or port > 65535:
        raise DeviceProtocolError(
            f"display: {text!r} is no address of the page; write browser:HOST:PORT, such as browser:192.168.1.5:8443"
        )
    host = found["host"].strip("[]") or local_network_address()
    if host == "localhost":
        host = "127.0.0.1"
    try:
        loopback = ipaddress.ip_address(host).is_loopback
    except ValueError:
        raise DeviceProtocolError(
            f"display: {host!r} is no IP address; give one of this machine, or leave it out to have it found"
        ) from None
    secure = found["scheme"] == "https" if found["scheme"] else not loopback
    return PageAddress(host, port, secure)


def local_network_address() -> str:
    """Return this machine's address in its local network; no packet is sent to find it."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        try:
            # Connecting a datagram socket only chooses the route; 192.0.2.1 is reserved for documentation (RFC 5737).
            probe.connect(("192.0.2.1", 9))
            return str(probe.getsockname()[0])
        except OSError:
            raise DeviceNotFoundError(
                "display: this machine is in no network that a tablet could share; connect it, or give its address"
            ) from None


def is_local(peer: str) -> bool:
    """Whether a caller's IP address belongs to this machine or a private network."""
    try:
        address = ipaddress.ip_address(peer.split("%")[0])
    except ValueError:
        return False
    mapped = getattr(address, "ipv4_mapped", None)
    address = mapped or address
    return address.is_private or address.is_loopback or address.is_link_local


def keep_token(folder: Path) -> str:
    """Return the token of this folder, made on first use.

    It is kept so that a tablet that already stands in the tank finds the next command again by itself. Delete the file
    for a new one.
    """
    path = folder / TOKEN_FILE
    try:
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        if path.exists() and re.fullmatch(r"[A-Za-z0-9_-]{16,}", token := path.read_text("ascii").strip()):
            return token
        token = secrets.token_urlsafe(TOKEN_BYTES)
        path.touch(mode=0o600)
        path.chmod(0o600)
        path.write_text(token + "\n", encoding="ascii")
    except (OSError, UnicodeDecodeError) as error:
        raise DeviceProtocolError(f"display: {path}: the page's token cannot be kept here ({error})") from None
    return token


def qr_code(url: str) -> str:
    """Return ``url`` as a QR code drawn with the letters of a terminal."""
    try:
        import segno  # here: only a rig with a page needs it
    except ImportError:
        return "(install the package segno to see this address as a QR code: pip install segno)"
    drawn = io.StringIO()
    segno.make(url, error="m").terminal(drawn, compact=True)
    return drawn.getvalue()
