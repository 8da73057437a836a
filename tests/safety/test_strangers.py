"""A stranger on another machine of the network commands nothing and reads nothing."""

import json
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from steerd.daemon.cli.main import run_cli

pytest.importorskip("cryptography")
pytestmark = pytest.mark.timeout(120)
SCRIPT = Path(__file__).parent / "strangers.py"
HOST = "10.9.0.1"


@pytest.fixture(scope="module", autouse=True)
def namespaces():
    """Skips, saying why, where no network namespace may be made."""
    for tool in ("unshare", "ip"):
        if shutil.which(tool) is None:
            pytest.skip(f"no {tool} on this machine: network namespaces are not tested")
    tried = "ip link add name va type veth peer name vb && unshare -n true"
    done = subprocess.run(["unshare", "-Urn", "sh", "-c", tried], capture_output=True, text=True)
    if done.returncode:
        why = done.stderr.strip() or "no reason given"
        pytest.skip(f"network namespaces are not allowed here: {why}")


@pytest.fixture(scope="module")
def labs(tmp_path_factory):
    root = tmp_path_factory.mktemp("labs")
    for whose in ("ours", "theirs"):
        options = ["--operator", "desk", "--viewer", "screen"]
        assert run_cli(["keys", str(root / whose), "--host", HOST, *options]) == 0
    return root


def try_it(what, labs):
    command = ["unshare", "-Urn", sys.executable, str(SCRIPT), "car", what, str(labs)]
    done = subprocess.run(command, capture_output=True, text=True, cwd=SCRIPT.parents[2])
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


@pytest.mark.parametrize(("what", "address"), [("loopback", "127.0.0.1"), ("lab", HOST)])
def test_a_stranger_delivers_nothing_and_reads_nothing(labs, what, address):
    got = try_it(what, labs)
    viewed = got["read"].pop("viewer", 0)
    assert (viewed > 0) is (what == "lab"), "a viewer's certificate reads"
    assert got["delivered"] == 0
    assert set(got["read"].values()) == {0}
    assert got["listening"] == [f"tcp/{address}:7447"]


def test_without_any_of_it_the_stranger_drives(labs):
    """What these tests would see if nothing protected the car: they can fail."""
    got = try_it("plain", labs)
    assert got["delivered"] > 50
    assert got["read"]["plain"] > 0
