"""The lab profile: one participant's certificates, and who may do what at a car's hub.

A folder made by ``steerd keys`` holds ``ca.pem``, ``cert.pem``, ``key.pem`` and ``lab.toml``. Both
ends of a connection show a certificate of the lab's own authority (mutual TLS); the hub then
allows by the certificate's common name: operators command and read, viewers read, others nothing.
An operator's requests go under keys that end with the own name, so that the car knows who sent one.
"""

# Why: docs/decisions/safety.md#d25

import ipaddress
import stat
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from steerd.steer_bus.topics import ALIVE, EXTERNAL_POSE, ROOT, TOPICS, BusError, make_key
from steerd.toml_text import load_toml

DEFAULT_PORT = 7447
_TLS = "transport/link/tls/"
_FILES = ("ca.pem", "cert.pem", "key.pem")


@dataclass(frozen=True, slots=True)
class Lab:
    """What a participant's folder says."""

    folder: Path  # where its certificate and key lie
    car: str  # the car's name, which is the common name of the hub's certificate
    endpoint: str  # where the hub listens and everybody dials, such as ``tls/192.168.1.20:7447``
    operators: tuple[str, ...] = ()  # common names that may command and read
    viewers: tuple[str, ...] = ()  # common names that may read
    name: str = ""  # this participant's common name


def is_private(host: str) -> bool:
    """Whether only this machine reaches a host."""
    try:
        return host == "localhost" or ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False


def load_lab(folder: Path) -> Lab:
    """Read a participant's folder.

    Raises:
        BusError: if something is missing or odd in it, or others may read its private key.
    """
    missing = [name for name in (*_FILES, "lab.toml") if not (folder / name).is_file()]
    if missing:
        raise BusError(f"{folder} has no {', '.join(missing)}: make such a folder with steerd keys")
    if stat.S_IMODE((folder / "key.pem").stat().st_mode) & 0o077:
        raise BusError(f"others can read the private key: chmod 600 {folder / 'key.pem'}")
    lab = read_members(folder)
    if not lab.endpoint.startswith("tls/"):
        raise BusError(f"{folder / 'lab.toml'}: endpoint {lab.endpoint!r} is not tls/HOST:PORT")
    return lab


def read_members(folder: Path) -> Lab:
    """What the `lab.toml` of a folder says.

    Raises:
        BusError: it cannot be read, or something is missing or odd in it.
    """
    try:
        table = load_toml(folder / "lab.toml")
        own = table["car"], table["endpoint"], table.get("name", folder.name)
        car, endpoint, name = map(_text, own)
        operators, viewers = (tuple(map(_text, table[key])) for key in ("operators", "viewers"))
        return Lab(folder, car, endpoint, operators, viewers, name)
    except (OSError, ValueError, TypeError, KeyError) as error:
        why = getattr(error, "strerror", None) or error
        raise BusError(f"{folder / 'lab.toml'}: {why}") from None


def make_tls_settings(lab: Lab, *, hub: bool) -> dict[str, Any]:
    """Make the zenoh settings of mutual TLS for a hub or for who dials it."""
    side = "listen" if hub else "connect"
    return {
        f"{_TLS}root_ca_certificate": str(lab.folder / "ca.pem"),
        f"{_TLS}{side}_certificate": str(lab.folder / "cert.pem"),
        f"{_TLS}{side}_private_key": str(lab.folder / "key.pem"),
        f"{_TLS}enable_mtls": True,
        f"{_TLS}verify_name_on_connect": True,
        f"{_TLS}close_link_on_expiration": True,
    }


def make_access_settings(lab: Lab, pose_key: str | None = None) -> dict[str, Any]:
    """Make the hub's access control: all is denied but what is listed here.

    A rule must include the whole key expression that is requested: a subscriber on ``**`` gets
    nothing, one on ``steerd/<car>/**`` gets what the car publishes, and no commands. Operators may
    publish poses under the car's own key and under ``pose_key``.
    """
    named = [t for t in TOPICS if t.direction == "in" and t is not EXTERNAL_POSE]
    poses = [make_key(lab.car, EXTERNAL_POSE), *([pose_key] if pose_key else [])]
    queried = [f"{ROOT}/*/alive", make_key(lab.car, ALIVE), make_key(lab.car, "schema/**")]
    published = [make_key(lab.car, "*"), make_key(lab.car, "schema/**")]
    heard = [*poses, *(make_key(lab.car, topic, "**") for topic in named)]
    rules = [
        _rule("listen", "ingress", ["declare_subscriber"], [f"{ROOT}/{lab.car}/**"]),
        _rule("query", "ingress", _QUERYING, queried),
        _rule("publish", "egress", _PUBLISHING, published),
        _rule("expect", "egress", ["declare_subscriber"], heard),
    ]
    reading = ["listen", "query", "publish"]
    viewers = {"id": "viewers", "cert_common_names": [*lab.viewers]}
    roles: list[_Role] = [(viewers, reading)] if lab.viewers else []
    for name in lab.operators:
        own = [*poses, *(make_key(lab.car, topic, name) for topic in named)]
        rules.append(_rule(f"command as {name}", "ingress", ["put"], own))
        subject = {"id": name, "cert_common_names": [name]}
        roles.append((subject, [*reading, "expect", f"command as {name}"]))
    return _access("deny", rules, roles)


def make_plain_access() -> dict[str, Any]:
    """Make the access control of a hub without certificates, on loopback.

    All is allowed but two things: to hear requests, whose lease ids are secrets, and to speak under
    the keys of a car, whose gateway is the hub itself.
    """
    spoken = [f"{ROOT}/*/{t.name}" for t in TOPICS if t.direction == "out"]
    rules = [
        _rule("requests", "egress", ["put"], [f"{ROOT}/*/cmd/**"], "deny"),
        _rule("forged", "ingress", ["put"], spoken, "deny"),
    ]
    return _access("allow", rules, [({"id": "everybody"}, ["requests", "forged"])])


_Role = tuple[dict[str, Any], list[str]]
"""Who has it: its id, and common names of certificates but for everybody. The ids of its rules."""


def _access(default: str, rules: list[dict[str, Any]], roles: Sequence[_Role]) -> dict[str, Any]:
    return {
        "access_control": {
            "enabled": True,
            "default_permission": default,
            "rules": rules,
            "subjects": [subject for subject, _ in roles],
            "policies": [{"rules": given, "subjects": [who["id"]]} for who, given in roles],
        }
    }


_QUERYING = ["query", "liveliness_query", "declare_liveliness_subscriber"]
_PUBLISHING = ["put", "reply", "liveliness_token", "declare_queryable"]


def _rule(
    name: str, flow: str, messages: list[str], keys: Iterable[str], permission: str = "allow"
) -> dict[str, Any]:
    return {
        "id": name, "messages": messages, "flows": [flow], "permission": permission,
        "key_exprs": list(keys),
    }  # fmt: skip


def _text(value: object) -> str:
    if not isinstance(value, str) or not value:
        raise ValueError(f"{value!r} is no name")
    return value
