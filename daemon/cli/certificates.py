"""A lab's own certificate authority, and certificates for a car and for people.

X.509 with P-256 keys. A folder for each participant holds all that its machine needs; the
authority's private key stays in `authority/`, on a machine that neither car nor operators use.
"""

import ipaddress
import json
import re
from collections.abc import Mapping
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import NamedTuple

from cryptography import x509
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID

from steerd.daemon.common.errors import ExitCode, SteerdError, UsageError, refusing
from steerd.steer_bus.atomic_file import write_atomically
from steerd.steer_bus.clock import MonotonicClock
from steerd.steer_bus.lab import Lab, read_members
from steerd.steer_bus.topics import BusError

AUTHORITY = "authority"
_PRIVATE = 0o600  # only the owner reads and writes
_NAME = re.compile(r"[a-zA-Z0-9_.-]{1,60}")
_SKEW = timedelta(days=1)  # certificates are valid from this long ago: clocks may be behind
_PEM = serialization.Encoding.PEM


class Issuer(NamedTuple):
    """A certificate authority; of what it makes, for itself too, `years` says how long it holds."""

    certificate: x509.Certificate
    key: ec.EllipticCurvePrivateKey
    years: float


def load_members(folder: Path) -> Lab:
    """The lab of a folder, as its authority knows it; a SteerdError where there is none."""
    try:
        return read_members(folder / AUTHORITY)
    except BusError as error:
        hint = "steerd keys DIR --host ADDRESS makes a lab"
        raise SteerdError(str(error), hint, ExitCode.UNREADABLE) from None


def add_members(folder: Path, old: Lab, lab: Lab, years: float, host: str | None) -> None:
    """Make folders for new people, who stand last in `lab`, and write the members into each folder.

    Of a lab that begins, `host` is the car's address: its authority and its car are made too. A
    SteerdError where a name cannot be used, or a folder or file is there already.
    """
    added = (*lab.operators[len(old.operators) :], *lab.viewers[len(old.viewers) :])
    known = {old.car, *old.operators, *old.viewers}
    for name in added:  # before anything is written
        if not _NAME.fullmatch(name) or name.startswith(".") or name == AUTHORITY:
            hint = f"1 to 60 of letters, digits and _ . -, not starting with a dot, not {AUTHORITY}"
            raise UsageError(f"{name!r} is not a valid name for a certificate", hint)
        if name in known:
            hint = "choose another name; a certificate is never replaced"
            raise UsageError(f"{name!r} exists already", hint)
        known.add(name)
    if host is None:
        issuer = _load_authority(folder / AUTHORITY, years)
    else:
        issuer = _make_authority(folder / AUTHORITY, lab.car, years)
        _issue(folder, issuer, lab.car, host)
    for name in added:
        _issue(folder, issuer, name, None)
    text = "# Made by steerd keys. The car admits only the names in its copy of this list.\n"
    for key in ("car", "endpoint", "operators", "viewers"):
        text += f"{key} = {json.dumps(getattr(lab, key))}\n"
    for name in (*added, AUTHORITY, lab.car):
        if (folder / name).is_dir():
            _write(folder / name / "lab.toml", f"{text}name = {json.dumps(name)}\n".encode())


def _make_authority(place: Path, car: str, years: float) -> Issuer:
    key = ec.generate_private_key(ec.SECP256R1())
    extensions = {
        x509.BasicConstraints(ca=True, path_length=0): True,
        x509.KeyUsage(False, False, False, False, False, True, True, False, False): True,
        x509.SubjectKeyIdentifier.from_public_key(key.public_key()): False,
    }
    certificate = _certify(f"steerd lab of {car}", key, years, extensions)
    _write_folder(place, {"ca.pem": certificate.public_bytes(_PEM), "ca.key": _encode(key)})
    return Issuer(certificate, key, years)


def _load_authority(place: Path, years: float) -> Issuer:
    try:
        certificate = x509.load_pem_x509_certificate((place / "ca.pem").read_bytes())
        key = serialization.load_pem_private_key((place / "ca.key").read_bytes(), password=None)
    except (OSError, ValueError) as error:
        hint = "name the folder in which steerd keys made the lab"
        raise SteerdError(f"{place}: {error}", hint, ExitCode.UNREADABLE) from None
    if not isinstance(key, ec.EllipticCurvePrivateKey):
        raise SteerdError(f"{place / 'ca.key'} was not made by steerd keys")
    return Issuer(certificate, key, years)


def _issue(folder: Path, issuer: Issuer, name: str, host: str | None) -> None:
    """Make the folder of one participant; `host` is where others connect, None for a client."""
    key = ec.generate_private_key(ec.SECP256R1())
    purpose = ExtendedKeyUsageOID.SERVER_AUTH if host else ExtendedKeyUsageOID.CLIENT_AUTH
    extensions: dict[x509.ExtensionType, bool] = {
        x509.BasicConstraints(ca=False, path_length=None): True,
        x509.KeyUsage(True, False, False, False, False, False, False, False, False): True,
        x509.ExtendedKeyUsage([purpose]): False,
        x509.AuthorityKeyIdentifier.from_issuer_public_key(issuer.key.public_key()): False,
    }
    if host:
        try:
            place: x509.GeneralName = x509.IPAddress(ipaddress.ip_address(host.strip("[]")))
        except ValueError:
            place = x509.DNSName(host)
        extensions[x509.SubjectAlternativeName([place])] = False
    certificate = _certify(name, key, issuer.years, extensions, issuer)
    _write_folder(folder / name, {
        "ca.pem": issuer.certificate.public_bytes(_PEM),
        "cert.pem": certificate.public_bytes(_PEM),
        "key.pem": _encode(key),
    })  # fmt: skip


def _certify(
    name: str,
    key: ec.EllipticCurvePrivateKey,
    years: float,
    extensions: Mapping[x509.ExtensionType, bool],
    issuer: Issuer | None = None,
) -> x509.Certificate:
    """A certificate by the issuer or by itself; of each extension, whether it is critical."""
    now = datetime.fromtimestamp(MonotonicClock().realtime_ns() * 1e-9, UTC)
    subject = x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, name)])
    builder = (
        x509.CertificateBuilder()
        .subject_name(subject)
        .issuer_name(issuer.certificate.subject if issuer else subject)
        .public_key(key.public_key())
        .serial_number(x509.random_serial_number())
        .not_valid_before(now - _SKEW)
        .not_valid_after(now + timedelta(days=365.25 * years))
    )
    for extension, critical in extensions.items():
        builder = builder.add_extension(extension, critical)
    return builder.sign(issuer.key if issuer else key, hashes.SHA256())


def _encode(key: ec.EllipticCurvePrivateKey) -> bytes:
    return key.private_bytes(_PEM, serialization.PrivateFormat.PKCS8, serialization.NoEncryption())


def _write_folder(path: Path, files: Mapping[str, bytes]) -> None:
    """Make a folder, which must not exist, with files that only its owner may read."""
    if path.exists():
        hint = "choose another folder or name, or delete it if nobody uses it any more"
        raise SteerdError(f"{path} already exists and is not changed", hint, ExitCode.UNREADABLE)
    with refusing(f"{path}: "):
        path.mkdir(mode=0o700, parents=True)
    for name, data in files.items():
        _write(path / name, data)


def _write(path: Path, data: bytes) -> None:
    """Write a file that only its owner may read."""
    with refusing(f"{path}: "):
        write_atomically(path, data, _PRIVATE)
