"""A certificate made by this machine for itself, so that the page is a secure context and may keep the tablet awake.

Browsers grant ``navigator.wakeLock`` only to pages over HTTPS. The certificate is an authority for this machine's own
addresses and nothing else (name constraints), so that a tablet can be told to trust it without trusting this machine for
the rest of the internet.
"""

import shutil
import ssl
import subprocess
from pathlib import Path

from drivers.errors import DeviceNotFoundError, DeviceProtocolError

# Longer than 825 days is refused by Apple's devices.
VALID_DAYS = 820
RENEW_BEFORE_S = 30 * 24 * 3600
KEY_FILE = "key.pem"
CERTIFICATE_FILE = "certificate.pem"
OPENSSL_TIMEOUT_S = 30.0


def server_context(folder: Path, host: str) -> ssl.SSLContext:
    """Return the TLS settings of a server at IP address ``host``; the certificate is made when the folder has none for it."""
    certificate, key = folder / CERTIFICATE_FILE, folder / KEY_FILE
    if not (key.exists() and certificate.exists() and _is_good(certificate, host)):
        _make(folder, host)
    context = ssl.create_default_context(ssl.Purpose.CLIENT_AUTH)
    try:
        context.load_cert_chain(certificate, key)
    except (OSError, ssl.SSLError):
        raise DeviceProtocolError(
            f"display: the certificate in {folder} cannot be used; delete {KEY_FILE} and {CERTIFICATE_FILE} there"
        ) from None
    return context


def certificate_der(folder: Path) -> bytes:
    """Return the certificate as a browser installs it."""
    return ssl.PEM_cert_to_DER_cert((folder / CERTIFICATE_FILE).read_text("ascii"))


def _is_good(certificate: Path, host: str) -> bool:
    """Whether the certificate is for ``host`` and stays valid for a while."""
    lasts = _openssl("x509", "-in", str(certificate), "-noout", "-checkend", str(RENEW_BEFORE_S))
    names = _openssl("x509", "-in", str(certificate), "-noout", "-checkip", host)
    return lasts.returncode == 0 and "does match" in names.stdout


def _make(folder: Path, host: str) -> None:
    try:
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        key = folder / KEY_FILE
        key.touch(mode=0o600)
        key.chmod(0o600)
    except OSError as error:
        raise DeviceProtocolError(f"display: {folder}: the certificate cannot be kept here ({error})") from None
    mask = "255.255.255.255" if ":" not in host else ":".join(["ffff"] * 8)
    made = _openssl(
        *("req", "-x509", "-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:prime256v1", "-nodes", "-sha256"),
        *("-days", str(VALID_DAYS), "-subj", "/CN=Stripe player of the scanner"),
        *("-addext", f"subjectAltName=IP:{host}", "-addext", "extendedKeyUsage=serverAuth"),
        *("-addext", f"nameConstraints=critical,permitted;IP:{host}/{mask},permitted;DNS:stripe-player.invalid"),
        *("-keyout", str(key), "-out", str(folder / CERTIFICATE_FILE)),
    )
    if made.returncode != 0:
        reason = (made.stderr.strip().splitlines() or ["no reason given"])[-1]
        raise DeviceProtocolError(
            f"display: openssl could not make a certificate ({reason}); give the page's address with http:// instead"
        )


def _openssl(*arguments: str) -> subprocess.CompletedProcess[str]:
    program = shutil.which("openssl")
    if program is None:
        raise DeviceNotFoundError(
            "display: the program openssl, which makes the page's certificate, is not installed; on Debian: apt-get "
            "install openssl; or give the page's address with http:// (then the tablet's Auto-Lock must be off)"
        )
    try:
        return subprocess.run(
            [program, *arguments], capture_output=True, text=True, timeout=OPENSSL_TIMEOUT_S, check=False
        )
    except subprocess.TimeoutExpired:
        raise DeviceProtocolError(
            f"display: openssl gave no answer within {OPENSSL_TIMEOUT_S:g} s; try again, or use http://"
        ) from None
