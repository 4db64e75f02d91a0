"""A certificate for a server on the local network, made on the spot, and its fingerprint.

Browsers give a page the camera only over HTTPS, and no certificate authority signs addresses of a local network. The
key stays in the state folder, readable by its owner alone, so that a browser that trusts the certificate once keeps
trusting it. The certificate is made again shortly before it expires, and when an address is new.
"""

import datetime
import logging
import ssl
from collections.abc import Iterable
from ipaddress import ip_address
from pathlib import Path
from typing import Final

from cryptography import x509
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID

from roomlight.errors import OutputError, ServerError
from roomlight.files import write_durable

_log = logging.getLogger("roomlight.server")
KEY, CERTIFICATE = "lan-key.pem", "lan-certificate.pem"
DAYS: Final = 397
"""Longest life of a certificate that browsers accept (CA/Browser Forum, ballot SC31)."""
RENEWAL_DAYS: Final = 30
_RULES: Final = {
    "KEY_VALUES_MISMATCH": "the key does not belong to the file's first certificate; the server's own must come first, "
    "then the one that signed it",
    "EE_KEY_TOO_SMALL": "the key of the certificate is too short; RSA needs 2,048 bits",
}
"""What must hold, by OpenSSL's reason."""
_SKEW: Final = datetime.timedelta(days=1)  # a phone's clock may be behind


def write_private(file: Path, data: bytes) -> None:
    """Write a file that only its owner can read, whole or not at all; its folder is made if it is missing.

    Raises:
        ServerError: The folder cannot be made or written.
    """
    try:
        file.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
        write_durable(file, data)
    except (OSError, OutputError) as error:
        raise ServerError(f"{error}; choose another folder with state_dir") from error


def ensure_certificate(
    folder: Path, names: Iterable[str], *, now: datetime.datetime | None = None
) -> tuple[Path, Path]:
    """Return the files of a certificate for these names and addresses, and of its key; make them if necessary.

    Raises:
        ServerError: A file in the folder is damaged or cannot be written.
    """
    now = now or datetime.datetime.now(datetime.UTC)
    wanted = list(dict.fromkeys(names))
    key_file, certificate_file = folder / KEY, folder / CERTIFICATE
    key = _read_key(key_file)
    if key is None:
        key = ec.generate_private_key(ec.SECP256R1())
        unencrypted = serialization.NoEncryption()
        pem = key.private_bytes(serialization.Encoding.PEM, serialization.PrivateFormat.PKCS8, unencrypted)
        write_private(key_file, pem)
    elif key_file.stat().st_mode & 0o077:
        key_file.chmod(0o600)
    if not _is_usable(certificate_file, key, wanted, now):
        certificate = _signed(key, wanted, now)
        write_private(certificate_file, certificate.public_bytes(serialization.Encoding.PEM))
    return certificate_file, key_file


def _read_key(file: Path) -> ec.EllipticCurvePrivateKey | None:
    try:
        key = serialization.load_pem_private_key(file.read_bytes(), password=None)
    except (FileNotFoundError, NotADirectoryError):
        return None
    except (OSError, ValueError, TypeError) as error:
        raise ServerError(f"{file}: is not a readable private key ({error}); delete it to make a new one") from error
    if not isinstance(key, ec.EllipticCurvePrivateKey):
        raise ServerError(f"{file}: is not an elliptic-curve key; delete it to make a new one")
    return key


def _is_usable(file: Path, key: ec.EllipticCurvePrivateKey, names: list[str], now: datetime.datetime) -> bool:
    try:
        certificate = x509.load_pem_x509_certificate(file.read_bytes())
        stated = certificate.extensions.get_extension_for_class(x509.SubjectAlternativeName).value
    except (OSError, ValueError, x509.ExtensionNotFound):
        return False
    lasts = certificate.not_valid_after_utc - now > datetime.timedelta(days=RENEWAL_DAYS)
    began = certificate.not_valid_before_utc <= now
    same_key = certificate.public_key() == key.public_key()
    return lasts and began and same_key and {_general_name(name) for name in names} <= set(stated)


def _signed(key: ec.EllipticCurvePrivateKey, names: list[str], now: datetime.datetime) -> x509.Certificate:
    subject = x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, "RoomLight on the local network")])
    usage = x509.KeyUsage(
        digital_signature=True,
        **dict.fromkeys(
            (
                *("content_commitment", "key_encipherment", "data_encipherment", "key_agreement", "key_cert_sign"),
                *("crl_sign", "encipher_only", "decipher_only"),
            ),
            False,
        ),
    )
    return (
        x509.CertificateBuilder()
        .subject_name(subject)
        .issuer_name(subject)
        .public_key(key.public_key())
        .serial_number(x509.random_serial_number())
        .not_valid_before(now - _SKEW)
        .not_valid_after(now - _SKEW + datetime.timedelta(days=DAYS))
        .add_extension(x509.SubjectAlternativeName([_general_name(name) for name in names]), critical=False)
        .add_extension(x509.BasicConstraints(ca=False, path_length=None), critical=True)
        .add_extension(usage, critical=True)
        .add_extension(x509.ExtendedKeyUsage([ExtendedKeyUsageOID.SERVER_AUTH]), critical=False)
        .sign(key, hashes.SHA256())
    )


def _general_name(name: str) -> x509.GeneralName:
    try:
        return x509.IPAddress(ip_address(name))
    except ValueError:
        return x509.DNSName(name)


def fingerprint(certificate: Path) -> str:
    """Return the SHA-256 of the first certificate of a PEM file, as browsers show it.

    Raises:
        ServerError: The file is not a certificate.
    """
    try:
        first = x509.load_pem_x509_certificate(certificate.read_bytes())
    except (OSError, ValueError) as error:
        raise ServerError(f"tls_cert: {certificate} is not a readable certificate ({error})") from error
    return first.fingerprint(hashes.SHA256()).hex(":").upper()


def warn_if_expired(certificate: Path) -> None:
    """Log a warning if a certificate has expired, or is not valid yet."""
    try:
        first = x509.load_pem_x509_certificate(certificate.read_bytes())
    except ValueError:  # of a kind that OpenSSL alone reads, such as TRUSTED CERTIFICATE
        return
    began, ends = first.not_valid_before_utc, first.not_valid_after_utc
    if not began <= datetime.datetime.now(datetime.UTC) <= ends:
        valid = {"file": str(certificate), "valid_from": began.isoformat(), "valid_to": ends.isoformat()}
        _log.warning("the certificate is not valid now: clients will refuse it; renew it", extra=valid)


def check_certificate(certificate: Path, key: Path | None) -> None:
    """Check that a server can use a certificate with its key.

    Raises:
        ServerError: A file is missing or damaged, or they do not belong together.
    """
    try:
        ssl.create_default_context(ssl.Purpose.CLIENT_AUTH).load_cert_chain(certificate, key, password="")
    except (OSError, ValueError) as error:  # SSLError is an OSError
        reason = getattr(error, "reason", None) or getattr(error, "strerror", None) or error
        if key is None:
            files = f"tls_cert {certificate} without a tls_key"
            rule = "give the key with --tls-key; or the PEM file must have the key too, not encrypted"
        else:
            files = f"tls_cert {certificate} with tls_key {key}"
            rule = "both must be PEM files, the key not encrypted"
        raise ServerError(f"{files}: cannot be used ({reason}); {_RULES.get(str(reason), rule)}") from error
