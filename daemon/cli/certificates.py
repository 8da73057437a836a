"""A lab's own certificate authority, and certificates for a car and for people.

X.509 with P-256 keys. A folder for each participant holds all that its machine needs; the
authority's private key stays in `authority/`, on a machine that neither car nor operators use.
"""

import ipaddress
import os
import re
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from pathlib import Path

from cryptography import x509
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID

from steerd.daemon.common.errors import ExitCode, SteerdError
from steerd.steer_bus.atomic_file import write_atomically

AUTHORITY = "authority"
_PRIVATE = 0o600  # only the owner reads and writes
_NAME = re.compile(r"[a-zA-Z0-9_.-]{1,60}")
_SKEW = timedelta(days=1)
"""Certificates are valid from this long ago, for machines whose clock is behind."""


@dataclass(frozen=True)
class Issuer:
    """A certificate authority: its certificate and private key."""

    certificate: x509.Certificate
    key: ec.EllipticCurvePrivateKey


def check_name(name: str) -> str:
    """Return a common name that is also valid as a folder's name.

    Raises:
        SteerdError: it is not valid, or is the authority's.
    """
    if not _NAME.fullmatch(name) or name.startswith(".") or name == AUTHORITY:
        hint = f"1 to 60 of letters, digits and _ . -, not starting with a dot, not {AUTHORITY}"
        raise SteerdError(f"{name!r} is not a valid name for a certificate", hint, ExitCode.USAGE)
    return name


def make_authority(folder: Path, car: str, now: datetime, years: float) -> Issuer:
    """Make the lab's authority in `folder/authority`.

    Raises:
        SteerdError: there is already one.
    """
    key = ec.generate_private_key(ec.SECP256R1())
    name = _common_name(f"steerd lab of {car}")
    sign = x509.KeyUsage(False, False, False, False, False, True, True, False, False)
    builder = (
        _builder(name, name, key, now, years)
        .add_extension(x509.BasicConstraints(ca=True, path_length=0), critical=True)
        .add_extension(sign, critical=True)
        .add_extension(x509.SubjectKeyIdentifier.from_public_key(key.public_key()), critical=False)
    )
    issuer = Issuer(builder.sign(key, hashes.SHA256()), key)
    place = _new_folder(folder / AUTHORITY)
    write_private(place / "ca.pem", _pem(issuer.certificate))
    write_private(place / "ca.key", _key_pem(key))
    return issuer


def load_authority(folder: Path) -> Issuer:
    """Read the authority that `make_authority` wrote.

    Raises:
        SteerdError: it is not there or not readable.
    """
    place = folder / AUTHORITY
    try:
        certificate = x509.load_pem_x509_certificate((place / "ca.pem").read_bytes())
        key = serialization.load_pem_private_key((place / "ca.key").read_bytes(), password=None)
    except (OSError, ValueError) as error:
        hint = "name the folder in which steerd keys made the lab"
        raise SteerdError(f"{place}: {error}", hint, ExitCode.UNREADABLE) from None
    if not isinstance(key, ec.EllipticCurvePrivateKey):
        raise SteerdError(f"{place / 'ca.key'} was not made by steerd keys", "", ExitCode.INVALID)
    return Issuer(certificate, key)


def issue(
    folder: Path, issuer: Issuer, name: str, host: str | None, now: datetime, years: float
) -> Path:
    """Make the folder of one participant: `ca.pem`, `cert.pem`, `key.pem`.

    Args:
        folder: the lab's folder.
        issuer: the authority.
        name: the common name.
        host: the address at which others connect, or None for a client.
        now: the time of day.
        years: validity, at most the authority's.

    Raises:
        SteerdError: its folder exists already.
    """
    key = ec.generate_private_key(ec.SECP256R1())
    sign = x509.KeyUsage(True, False, False, False, False, False, False, False, False)
    purpose = ExtendedKeyUsageOID.SERVER_AUTH if host else ExtendedKeyUsageOID.CLIENT_AUTH
    authority = x509.AuthorityKeyIdentifier.from_issuer_public_key(issuer.key.public_key())
    builder = (
        _builder(_common_name(name), issuer.certificate.subject, key, now, years)
        .add_extension(x509.BasicConstraints(ca=False, path_length=None), critical=True)
        .add_extension(sign, critical=True)
        .add_extension(x509.ExtendedKeyUsage([purpose]), critical=False)
        .add_extension(authority, critical=False)
    )
    if host:
        named = x509.SubjectAlternativeName([_general_name(host)])
        builder = builder.add_extension(named, critical=False)
    place = _new_folder(folder / name)
    write_private(place / "ca.pem", _pem(issuer.certificate))
    write_private(place / "cert.pem", _pem(builder.sign(issuer.key, hashes.SHA256())))
    write_private(place / "key.pem", _key_pem(key))
    return place


def write_private(path: Path, data: bytes, *, new: bool = True) -> None:
    """Write a file that only its owner may read; if `new`, it must not exist.

    Raises:
        SteerdError: it exists, or cannot be written.
    """
    with _making(path):
        if not new:
            write_atomically(path, data, _PRIVATE)
            return
        flags = os.O_WRONLY | os.O_CREAT | os.O_EXCL
        file = os.fdopen(os.open(path, flags, _PRIVATE), "wb")
        try:
            with file:
                file.write(data)
        except OSError:
            path.unlink()  # half a key helps nobody
            raise


def _new_folder(path: Path) -> Path:
    with _making(path):
        path.mkdir(mode=0o700, parents=True)
    return path


@contextmanager
def _making(path: Path) -> Iterator[None]:
    try:
        yield
    except FileExistsError:
        what = f"{path} already exists and is not changed"
        hint = "choose another folder or name, or delete it if nobody uses it any more"
        raise SteerdError(what, hint, ExitCode.UNREADABLE) from None
    except OSError as error:
        raise SteerdError(f"{path}: {error.strerror}", "", ExitCode.UNREADABLE) from None


def _builder(
    subject: x509.Name,
    issuer: x509.Name,
    key: ec.EllipticCurvePrivateKey,
    now: datetime,
    years: float,
) -> x509.CertificateBuilder:
    return (
        x509.CertificateBuilder()
        .subject_name(subject)
        .issuer_name(issuer)
        .public_key(key.public_key())
        .serial_number(x509.random_serial_number())
        .not_valid_before(now.astimezone(UTC) - _SKEW)
        .not_valid_after(now.astimezone(UTC) + timedelta(days=365.25 * years))
    )


def _common_name(name: str) -> x509.Name:
    return x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, name)])


def _general_name(host: str) -> x509.GeneralName:
    try:
        return x509.IPAddress(ipaddress.ip_address(host.strip("[]")))
    except ValueError:
        return x509.DNSName(host)


def _pem(certificate: x509.Certificate) -> bytes:
    return certificate.public_bytes(serialization.Encoding.PEM)


def _key_pem(key: ec.EllipticCurvePrivateKey) -> bytes:
    return key.private_bytes(
        serialization.Encoding.PEM, serialization.PrivateFormat.PKCS8, serialization.NoEncryption()
    )
