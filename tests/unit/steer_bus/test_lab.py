"""A participant's folder, and the rules that a hub derives from it."""

from dataclasses import replace
from pathlib import Path

import pytest

from steerd.steer_bus.lab import Lab, load_lab, make_access_settings
from steerd.steer_bus.topics import BusError
from steerd.steer_bus.zenoh_bus import Profile, make_settings

ENDPOINT = "tls/10.0.0.5:7447"
GOOD = f'car = "car1"\nendpoint = "{ENDPOINT}"\noperators = ["desk"]\nviewers = ["screen"]\n'
LAB = Lab(Path("/lab/car1"), "car1", ENDPOINT, ("desk",), ("screen",))


@pytest.fixture
def folder(tmp_path):
    for name in ("ca.pem", "cert.pem", "key.pem"):
        (tmp_path / name).write_text("x")
    (tmp_path / "key.pem").chmod(0o600)
    (tmp_path / "lab.toml").write_text(GOOD)
    return tmp_path


def test_a_folder_is_read(folder):
    assert load_lab(folder) == Lab(folder, "car1", ENDPOINT, ("desk",), ("screen",), folder.name)
    (folder / "lab.toml").write_text(GOOD + 'name = "desk"\n')
    assert load_lab(folder).name == "desk"


@pytest.mark.parametrize("name", ["ca.pem", "cert.pem", "key.pem", "lab.toml"])
def test_a_missing_file_is_named(folder, name):
    (folder / name).unlink()
    with pytest.raises(BusError, match=f"has no {name}: make"):
        load_lab(folder)


@pytest.mark.parametrize("mode", [0o640, 0o604, 0o620])
def test_a_key_that_others_can_read_is_refused(folder, mode):
    (folder / "key.pem").chmod(mode)
    with pytest.raises(BusError, match="chmod 600"):
        load_lab(folder)


@pytest.mark.parametrize("text", [
    "", "car = ", GOOD.replace("car1", ""), GOOD.replace('"desk"', "3"),
    GOOD.replace('["screen"]', "7"), GOOD.replace("tls/", "tcp/"), "\x00", GOOD * 2, "\xff\xfe",
])  # fmt: skip
def test_an_odd_list_is_refused_by_name(folder, text):
    (folder / "lab.toml").write_bytes(text.encode("latin-1"))
    with pytest.raises(BusError, match=r"lab\.toml"):
        load_lab(folder)


def test_a_viewer_may_send_nothing_an_operator_requests_only_and_nobodys_role_is_left_out():
    access = make_access_settings(LAB, "lab/pose/car1")["access_control"]

    def may_put(role):
        policy = next(p for p in access["policies"] if p["subjects"] == [role])
        rules = [rule for rule in access["rules"] if rule["id"] in policy["rules"]]
        sent = [r for r in rules if r["flows"] == ["ingress"] and "put" in r["messages"]]
        return {key for r in sent for key in r["key_exprs"]}

    assert may_put("viewers") == set()
    requests = ("drive", "heartbeat", "operator", "parameters", "stop")
    poses = {"steerd/car1/in/pose", "lab/pose/car1"}
    assert may_put("desk") == poses | {f"steerd/car1/cmd/{each}/desk" for each in requests}
    access = make_access_settings(Lab(Path("x"), "car1", ENDPOINT, ("desk",)))["access_control"]
    assert [s["id"] for s in access["subjects"]] == ["desk"]
    assert [p["subjects"] for p in access["policies"]] == [["desk"]]


def test_profiles():
    assert make_settings(Profile(True, ENDPOINT, LAB))["transport/link/protocols"] == ["tls"]
    assert make_settings(Profile(False, ENDPOINT, LAB))["listen/endpoints"] == []
    spoke, desk = make_settings(Profile(False, ENDPOINT)), replace(LAB, name="desk")
    assert not [key for key in spoke if "tls" in key or "access" in key]
    assert [Profile(hub, ENDPOINT, desk).who for hub in (False, True)] == ["desk", ""]
    for insecure_lan in (False, True):
        with pytest.raises(BusError, match="--lab"):
            make_settings(Profile(True, "tcp/10.0.0.5:1", LAB, insecure_lan))
    with pytest.raises(BusError, match="--lab"):
        make_settings(Profile(True, ENDPOINT, settings={"transport/link/tls/enable_mtls": False}))
