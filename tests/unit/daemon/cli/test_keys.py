"""`steerd keys`: what it makes, what it refuses, what it says."""

import stat
import sys

import pytest

from steerd.daemon.cli.main import run_cli
from steerd.daemon.common.errors import ExitCode
from steerd.steer_bus.lab import load_lab

pytest.importorskip("cryptography")
from cryptography import x509
from cryptography.hazmat.primitives.serialization import load_pem_private_key
from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID


def keys(folder, *arguments):
    return run_cli(["keys", str(folder), *arguments])


@pytest.fixture
def lab(tmp_path):
    folder = tmp_path / "lab"
    people = ["--operator", "desk", "--operator", "tablet", "--viewer", "screen"]
    assert keys(folder, "--host", "192.168.1.20", "--years", "2", *people) == ExitCode.OK
    return folder


def files(folder):
    return {p.relative_to(folder): p.read_bytes() for p in folder.rglob("*") if p.is_file()}


def certificate(folder):
    return x509.load_pem_x509_certificate((folder / "cert.pem").read_bytes())


def test_each_folder_is_all_that_its_machine_needs_and_its_owner_alone_may_read_it(lab):
    for path in lab.rglob("*"):
        mode = stat.S_IMODE(path.stat().st_mode)
        assert mode == (0o600 if path.is_file() else 0o700)
    for name in ("car1", "desk", "tablet", "screen"):
        loaded = load_lab(lab / name)
        assert (loaded.car, loaded.endpoint) == ("car1", "tls/192.168.1.20:7447")
        assert (loaded.operators, loaded.viewers) == (("desk", "tablet"), ("screen",))
        assert not (lab / name / "ca.key").exists()


def test_certificates_name_their_holder_and_are_the_authority_s(lab):
    authority = x509.load_pem_x509_certificate((lab / "authority" / "ca.pem").read_bytes())
    limits = authority.extensions.get_extension_for_class(x509.BasicConstraints).value
    assert (limits.ca, limits.path_length) == (True, 0)
    for name in ("car1", "desk", "tablet", "screen"):
        found = certificate(lab / name)
        found.verify_directly_issued_by(authority)
        names = found.subject.get_attributes_for_oid(NameOID.COMMON_NAME)
        assert [each.value for each in names] == [name]
        key = load_pem_private_key((lab / name / "key.pem").read_bytes(), None)
        assert key.public_key() == found.public_key()
        assert not found.extensions.get_extension_for_class(x509.BasicConstraints).value.ca
        usage = found.extensions.get_extension_for_class(x509.ExtendedKeyUsage).value
        server = name == "car1"
        purpose = ExtendedKeyUsageOID.SERVER_AUTH if server else ExtendedKeyUsageOID.CLIENT_AUTH
        assert list(usage) == [purpose]


@pytest.mark.parametrize(("host", "endpoint", "kind"), [
    ("192.168.1.20", "tls/192.168.1.20:7000", x509.IPAddress),
    ("fd00::5", "tls/[fd00::5]:7000", x509.IPAddress),
    ("car.lab", "tls/car.lab:7000", x509.DNSName),
])  # fmt: skip
def test_a_new_lab_has_an_operator_and_its_car_s_certificate_the_address(
    tmp_path, cli, host, endpoint, kind
):
    said = cli("keys", tmp_path, "--host", host, "--port", 7000, "--car", "blue").out
    assert "steerd run --lab blue" in said
    assert "steerd start --lab operator" in said
    lab = load_lab(tmp_path / "blue")
    assert (lab.endpoint, lab.operators) == (endpoint, ("operator",))
    found = certificate(tmp_path / "blue")
    names = found.extensions.get_extension_for_class(x509.SubjectAlternativeName).value
    assert [str(value) for value in names.get_values_for_type(kind)] == [host]


def test_people_are_added_and_the_car_s_list_is_new(lab):
    before = files(lab)
    assert keys(lab, "--operator", "ann", "--viewer", "tv") == ExitCode.OK
    after = load_lab(lab / "car1")
    assert (after.operators, after.viewers) == (("desk", "tablet", "ann"), ("screen", "tv"))
    assert load_lab(lab / "ann").operators == after.operators
    changed = {p for p, data in files(lab).items() if before.get(p, data) != data}
    assert {str(p) for p in changed} == {"authority/lab.toml", "car1/lab.toml"}


@pytest.mark.parametrize("arguments", [
    ("--host", "10.0.0.9"), ("--host", "10.0.0.9", "--operator", "new"), ("--operator", "desk"),
    ("--viewer", "desk"), ("--operator", "car1"), ("--operator", "new", "--viewer", "new"),
    ("--operator", "authority"), ("--operator", "../up"), ("--operator", ".hidden"),
    ("--operator", ""), ("--operator", "a" * 61), (), ("--operator", "new", "--years", "0"),
    ("--operator", "new", "--years", "nan"), ("--operator", "new", "--port", "70000"),
])  # fmt: skip
def test_what_is_there_stays_as_it_is(lab, arguments, capsys):
    before = files(lab)
    assert keys(lab, *arguments) not in (ExitCode.OK, ExitCode.INTERNAL)
    assert files(lab) == before
    assert capsys.readouterr().err.startswith("steerd: ")


@pytest.mark.parametrize("damage", [b"", b"-----BEGIN PRIVATE KEY-----\nAAAA\n", None])
def test_a_damaged_authority_is_named_and_no_folder_is_overwritten(lab, damage, capsys):
    if damage is None:
        (lab / "new").mkdir()
    else:
        (lab / "authority" / "ca.key").write_bytes(damage)
    assert keys(lab, "--operator", "new") == ExitCode.UNREADABLE
    assert ("new" if damage is None else "authority") in capsys.readouterr().err
    assert not list((lab / "new").glob("*"))


def test_without_the_library_it_says_where_to_get_it(tmp_path, monkeypatch, capsys):
    monkeypatch.setitem(sys.modules, "cryptography", None)
    monkeypatch.delitem(sys.modules, "steerd.daemon.cli.certificates", raising=False)
    assert keys(tmp_path / "lab", "--host", "10.0.0.2") == ExitCode.UNREADABLE
    assert "pip install cryptography" in capsys.readouterr().err


@pytest.mark.parametrize(("arguments", "said"), [
    (("--name", "car2"), "are for 'car1', not 'car2'"),
    (("--listen", "tcp/10.0.0.5:7447"), "--lab uses TLS"),
])  # fmt: skip
def test_run_refuses_what_does_not_fit(lab, arguments, said, cli):
    assert said in cli("run", "--sim", "--lab", lab / "car1", *arguments, code=ExitCode.USAGE).err


def test_dialling_where_nobody_is_names_the_lab(lab, tmp_path, cli):
    where = ["--connect", "tls/127.0.0.1:9", "--lab", str(lab / "desk")]
    assert "of the same lab" in cli("status", *where, code=ExitCode.UNREACHABLE).err
