"""The lab profile with real zenoh sessions: certificates decide who commands and who reads."""

import select
import shutil

import pytest

from steerd.daemon.cli.main import run_cli
from steerd.steer_bus.lab import load_lab, make_tls_settings
from steerd.steer_bus.topics import BusError
from steerd.steer_bus.zenoh_bus import Profile, ZenohBus
from tests.contract.test_bus_contract import until
from tests.local_bus import is_heard
from tests.safety.live import free_endpoint

pytest.importorskip("cryptography")
STATE, ORDER = "steerd/car1/state", "steerd/car1/cmd/operator"
HEARD = f"{ORDER}/**"
SCHEMA, ALIVE = "steerd/car1/schema/x", "steerd/car1/alive"
POSE = "lab/pose/car1"
QUIET_S = 0.3


@pytest.fixture(scope="module")
def labs(tmp_path_factory):
    """Two labs at one address, made by two authorities with the same names."""
    root, port = tmp_path_factory.mktemp("labs"), free_endpoint().rpartition(":")[2]
    people = ["--operator", "desk", "--operator", "tablet", "--viewer", "screen"]
    for name in ("ours", "theirs"):
        where = [str(root / name), "--host", "127.0.0.1", "--port", port]
        assert run_cli(["keys", *where, *people]) == 0
    return root


@pytest.fixture(scope="module")
def hub(labs):
    lab = load_lab(labs / "ours" / "car1")
    with ZenohBus(Profile(True, lab.endpoint, lab, pose_key=POSE)) as bus:
        bus.declare_alive(ALIVE)
        bus.serve("steerd/car1/schema/**", lambda _: b"text")
        yield bus


def join(folder):
    lab = load_lab(folder)
    return ZenohBus(Profile(False, lab.endpoint, lab))


def orders(hub, sender, key):
    """How many of twenty orders arrive, from one who learns that somebody listens."""
    inbox = hub.subscribe(key if key == POSE else HEARD, 64)
    assert until(lambda: is_heard(sender, key))
    for _ in range(20):
        sender.publish(key, b"go")
    got = []
    until(lambda: got.extend(inbox.poll()) or len(got) == 20)
    return len(got)


def reads(hub, reader, key, sent=STATE):
    """Whether a reader of `key` hears what the hub sends under `sent`."""
    subscription = reader.subscribe(key, 64)
    marker = reader.subscribe("steerd/car1/tick", 64)
    heard, marked = [], []

    def publish():
        hub.publish(sent, b"state")
        hub.publish("steerd/car1/tick", b"mark")
        heard.extend(s.data for s in subscription.poll())
        marked.extend(marker.poll())
        return len(marked) >= 3

    assert until(publish)
    heard.extend(s.data for s in subscription.poll())
    return heard


def test_an_operator_commands_and_reads_and_a_viewer_reads_and_cannot_command(hub, labs):
    with join(labs / "ours" / "desk") as desk:
        assert orders(hub, desk, f"{ORDER}/desk") == 20
        assert orders(hub, desk, POSE) == 20
        assert reads(hub, desk, STATE)
        assert reads(hub, desk, "steerd/car1/*")
        assert until(lambda: desk.alive("steerd/*/alive")) == {ALIVE}
        assert desk.query(SCHEMA) == {SCHEMA: b"text"}
    with join(labs / "ours" / "screen") as screen:
        assert reads(hub, screen, STATE)
        assert reads(hub, screen, "steerd/car1/*")
        assert until(lambda: screen.alive("steerd/*/alive")) == {ALIVE}
        assert screen.query(SCHEMA) == {SCHEMA: b"text"}
        for key in (ORDER, f"{ORDER}/screen", f"{ORDER}/desk", "steerd/car1/cmd/drive", POSE):
            assert not is_heard(screen, key)
            assert orders_given_anyway(hub, screen, key) == 0


def orders_given_anyway(hub, sender, key):
    inbox = hub.subscribe(f"{key}/**", 64)
    select.select([], [], [], QUIET_S)
    for _ in range(20):
        sender.publish(key, b"go")
    select.select([], [], [], QUIET_S)
    got = inbox.poll()
    return len(got)


def test_no_operator_speaks_in_another_s_name(hub, labs):
    with join(labs / "ours" / "desk") as desk, join(labs / "ours" / "tablet") as tablet:
        spied = tablet.subscribe("steerd/car1/**", 64)
        assert orders(hub, desk, f"{ORDER}/desk") == 20
        assert spied.poll() == [], "nor hears what it says"
        for key in (ORDER, f"{ORDER}/desk", f"{ORDER}/tablet/desk"):
            assert orders_given_anyway(hub, tablet, key) == 0


def test_a_viewer_sees_no_orders_and_nobody_fakes_the_car(hub, labs):
    folder = labs / "ours"
    with join(folder / "screen") as screen, join(folder / "desk") as desk:
        assert set(reads(hub, screen, "steerd/car1/**", sent=ORDER)) == {b"mark"}
        inbox = desk.subscribe(STATE, 64)
        assert orders_given_anyway(hub, screen, STATE) == 0
        with join(folder / "tablet") as tablet:
            assert orders_given_anyway(hub, tablet, STATE) == 0
        assert inbox.poll() == []


def test_who_asks_for_everything_gets_nothing(hub, labs):
    """One who also asks for what is allowed would hear it twice: so the greedy one asks alone."""
    with join(labs / "ours" / "screen") as greedy, join(labs / "ours" / "desk") as desk:
        every = [greedy.subscribe(key, 64) for key in ("**", "steerd/**", "steerd/*/state")]
        assert reads(hub, desk, STATE)
        assert [subscription.poll() for subscription in every] == [[], [], []]


def test_no_certificate_another_authority_and_plain_text_are_refused(hub, labs):
    ours = load_lab(labs / "ours" / "desk")
    settings = make_tls_settings(ours, hub=False)
    nameless = {key: value for key, value in settings.items() if "connect_" not in key}
    stranger = load_lab(labs / "theirs" / "desk")
    foreign = make_tls_settings(stranger, hub=False)
    trusting = {**foreign, "transport/link/tls/root_ca_certificate": str(ours.folder / "ca.pem")}
    plain = ours.endpoint.replace("tls/", "tcp/")
    for profile in (
        Profile(False, ours.endpoint),
        Profile(False, ours.endpoint, settings=nameless),
        Profile(False, ours.endpoint, settings=foreign),
        Profile(False, ours.endpoint, settings=trusting),
        Profile(False, plain),
        Profile(False, ours.endpoint.replace("127.0.0.1", "localhost"), ours),  # not certified
    ):
        with pytest.raises(BusError, match="nobody listens"):
            ZenohBus(profile)


def test_a_hub_of_another_lab_is_not_believed(labs):
    """Who stands in for the car gets no orders: the dialler checks the hub's certificate too."""
    theirs = load_lab(labs / "theirs" / "car1")
    endpoint = free_endpoint().replace("tcp", "tls")
    ours = load_lab(labs / "ours" / "desk")
    with ZenohBus(Profile(True, endpoint, theirs)), pytest.raises(BusError):
        ZenohBus(Profile(False, endpoint, ours))


def test_who_is_taken_out_of_the_list_is_out(labs, tmp_path):
    car = shutil.copytree(labs / "ours" / "car1", tmp_path / "car1")
    roster = (car / "lab.toml").read_text()
    (car / "lab.toml").write_text(roster.replace('"desk", ', ""))
    endpoint = free_endpoint().replace("tcp", "tls")
    lab = load_lab(car)
    with (
        ZenohBus(Profile(True, endpoint, lab)) as hub,
        ZenohBus(Profile(False, endpoint, load_lab(labs / "ours" / "desk"))) as desk,
        ZenohBus(Profile(False, endpoint, load_lab(labs / "ours" / "tablet"))) as tablet,
    ):
        assert orders(hub, tablet, f"{ORDER}/tablet") == 20
        assert orders_given_anyway(hub, desk, f"{ORDER}/desk") == 0
        inbox = desk.subscribe("steerd/car1/*", 64)
        assert reads(hub, tablet, STATE)
        assert inbox.poll() == []
