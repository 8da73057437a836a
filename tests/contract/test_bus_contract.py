"""One suite for every bus: two participants that cannot distinguish one from the other."""

import contextlib
import select
import subprocess
import sys
import time
from functools import partial

import pytest

from steerd.steer_bus.codec import MAX_BYTES
from steerd.steer_bus.topics import BusError
from steerd.steer_bus.zenoh_bus import Profile, ZenohBus, make_settings
from tests.local_bus import LocalBus, LocalHub, is_heard
from tests.safety.live import free_endpoint

STATE = "steerd/car1/state"
OPEN = {"access_control/enabled": False}
"""A hub at which whoever dials in may say and hear all, as the contract asks of both sides."""
DEADLINE_S = 30.0


def until(condition, seconds=DEADLINE_S):
    """Wait for something another thread brings about, at most so long."""
    end = time.monotonic() + seconds
    while not (found := condition()) and time.monotonic() < end:
        select.select([], [], [], 0.002)
    return found


@contextlib.contextmanager
def local_pair():
    hub = LocalHub()
    pair = LocalBus(hub), LocalBus(hub)
    yield pair
    for bus in pair:
        bus.close()


@contextlib.contextmanager
def zenoh_pair(first, second):
    """Two of a hub (0) and its two spokes."""
    endpoint = free_endpoint()
    profiles = (Profile(True, endpoint, settings=OPEN), *[Profile(False, endpoint)] * 2)
    with contextlib.ExitStack() as stack:
        buses = [stack.enter_context(ZenohBus(profile)) for profile in profiles]
        yield buses[first], buses[second]


@pytest.fixture(
    params=[local_pair, partial(zenoh_pair, 0, 1), partial(zenoh_pair, 1, 2)],
    ids=["local", "hub and spoke", "spokes"],
)
def pair(request):
    with request.param() as made:
        yield made


def collect(subscription, count):
    taken = []
    until(lambda: taken.extend(subscription.poll()) or len(taken) >= count)
    return taken


def test_a_message_arrives_once_in_order(pair):
    sender, receiver = pair
    subscription = receiver.subscribe(STATE, depth=10)
    assert until(lambda: is_heard(sender, STATE))
    for i in range(5):
        sender.publish(STATE, bytes([i]))
    taken = collect(subscription, 5)
    assert [s.data for s in taken] == [bytes([i]) for i in range(5)]
    assert ([s.seq for s in taken], {s.key for s in taken}) == ([1, 2, 3, 4, 5], {STATE})
    assert [len(sender) for sender in {s.sender for s in taken}] == [16]
    assert subscription.poll() == []


def test_a_ring_keeps_the_newest(pair):
    sender, receiver = pair
    ring = receiver.subscribe(STATE)
    marker = receiver.subscribe("steerd/car1/marker")
    assert until(lambda: is_heard(sender, STATE))
    assert until(lambda: is_heard(sender, "steerd/car1/marker"))
    for i in range(8):
        sender.publish(STATE, bytes([i]))
    sender.publish("steerd/car1/marker", b"")
    collect(marker, 1)
    assert [s.data for s in collect(ring, 1)][-1] == b"\7"
    assert len(ring.poll()) == 0


def test_wildcards_receive_and_never_send(pair):
    sender, receiver = pair
    every_car = receiver.subscribe("steerd/*/state", depth=4)
    everything = receiver.subscribe("steerd/**", depth=4)
    assert until(lambda: is_heard(sender, STATE))
    assert until(lambda: is_heard(sender, "steerd/car2/cmd/drive"))
    sender.publish(STATE, b"a")
    sender.publish("steerd/car2/cmd/drive", b"b")
    assert {s.key for s in collect(everything, 2)} == {STATE, "steerd/car2/cmd/drive"}
    assert [s.data for s in collect(every_car, 1)] == [b"a"]
    for key in ("steerd/*/state", "steerd/**", "", "/a", "a/", "a//b", "a?b", "a#", "$*"):
        with pytest.raises(BusError):
            sender.publish(key, b"")


def test_what_is_not_kept_displaces_nothing(pair):
    sender, receiver = pair
    ring = receiver.subscribe(STATE, 2, lambda data: len(data) == 1)
    assert until(lambda: is_heard(sender, STATE))
    for data in (b"a", b"b", *[b"no"] * 50, b"c"):
        sender.publish(STATE, data)
    taken = []
    until(lambda: taken.extend(ring.poll()) or b"c" in {s.data for s in taken})
    assert b"no" not in {s.data for s in taken}


def test_a_message_at_the_limit_passes_and_a_longer_one_is_refused(pair):
    sender, receiver = pair
    subscription = receiver.subscribe(STATE)
    assert until(lambda: is_heard(sender, STATE))
    sender.publish(STATE, bytes(MAX_BYTES))
    assert [len(s.data) for s in collect(subscription, 1)] == [MAX_BYTES]
    with pytest.raises(BusError, match="exceeds"):
        sender.publish(STATE, bytes(MAX_BYTES + 1))


def test_liveliness_follows_the_token_and_ends_with_the_bus(pair):
    car, viewer = pair
    car.declare_alive("steerd/car1/alive")
    assert until(lambda: viewer.alive("steerd/*/alive")) == {"steerd/car1/alive"}
    assert viewer.alive("steerd/car2/alive") == frozenset()
    car.close()
    assert until(lambda: not viewer.alive("steerd/*/alive"))


def test_queries_are_answered_by_key(pair):
    car, viewer = pair
    known = {"steerd/car1/param/rate": b"200"}
    car.serve("steerd/car1/param/**", known.get)
    assert until(lambda: viewer.query("steerd/car1/param/rate")) == known
    assert viewer.query("steerd/car1/param/none") == {}
    assert viewer.query("steerd/car2/param/rate") == {}


def test_a_closed_bus_says_so_and_closes_twice(pair):
    bus = pair[1]
    bus.close()
    bus.close()
    for call in (lambda: bus.publish(STATE, b""), lambda: bus.subscribe(STATE),
                 lambda: bus.declare_alive("a"), lambda: bus.query("a")):  # fmt: skip
        with pytest.raises(BusError, match="closed"):
            call()


@pytest.mark.parametrize(("endpoint", "refused"), [
    ("tcp/127.0.0.1:7447", False), ("tcp/localhost:7447", False), ("tcp/[::1]:7447", False),
    ("tcp/127.9.9.9:1", False), ("tls/10.0.0.5:7447", True), ("quic/10.0.0.5:7447", True),
    ("unixsock-stream//run/z.sock", False), ("tcp/10.0.0.5:7447", True),
    ("tcp/0.0.0.0:7447", True), ("tcp/[::]:7447", True), ("udp/host:7447", True),
    ("tcp/example.org:1", True),
])  # fmt: skip
def test_a_plain_hub_listens_on_loopback_only(endpoint, refused):
    if refused:
        with pytest.raises(BusError, match="insecure-lan"):
            make_settings(Profile(hub=True, endpoint=endpoint))
    profile = Profile(hub=True, endpoint=endpoint, insecure_lan=refused)
    assert make_settings(profile)["listen/endpoints"] == [endpoint]


def test_nothing_is_scouted_and_a_spoke_never_listens():
    settings = make_settings(Profile(False, "tcp/127.0.0.1:7447"))
    assert settings["listen/endpoints"] == []
    assert settings["scouting/multicast/enabled"] is False
    assert settings["scouting/gossip/enabled"] is False


def test_what_keeps_zenoh_from_starting_is_said():
    endpoint = free_endpoint()
    with pytest.raises(BusError, match="is steerd running"):
        ZenohBus(Profile(hub=False, endpoint=endpoint))
    with ZenohBus(Profile(hub=True, endpoint=endpoint)), pytest.raises(BusError, match="in use"):
        ZenohBus(Profile(hub=True, endpoint=endpoint))
    with pytest.raises(BusError, match="does not start"):
        ZenohBus(Profile(hub=True, endpoint=endpoint, settings={"no/such": 1}))


def test_at_a_plain_hub_nobody_hears_requests_or_speaks_as_the_car():
    """The lease ids in requests are secrets; of the car only its own gateway speaks."""
    endpoint = free_endpoint()
    requests = "steerd/car1/cmd/operator"
    with (
        ZenohBus(Profile(True, endpoint)) as hub,
        ZenohBus(Profile(False, endpoint)) as operator,
        ZenohBus(Profile(False, endpoint)) as stranger,
    ):
        spied, heard = stranger.subscribe("**", 64), hub.subscribe(f"{requests}/**", 64)
        forged = operator.subscribe("steerd/car1/*", 64)
        assert until(lambda: is_heard(operator, requests))
        operator.publish(requests, b"secret")
        stranger.publish(STATE, b"forged")
        stranger.publish("steerd/car1/in/pose", b"pose")
        hub.publish(STATE, b"true")
        assert [s.data for s in collect(heard, 1)] == [b"secret"]
        assert [s.data for s in collect(forged, 1)] == [b"true"]
        hub.publish(STATE, b"last")
        own = {b"forged", b"pose"}
        rest = []
        until(lambda: rest.extend(spied.poll()) or (rest and rest[-1].data == b"last"))
        assert {s.data for s in rest} - own == {b"true", b"last"}


SHORT = {"transport/link/tx/lease": 300}  # after how long a silent peer counts as dead [ms]
HOLDER = f"""
import sys
from steerd.steer_bus.zenoh_bus import Profile, ZenohBus
bus = ZenohBus(Profile(hub=False, endpoint=sys.argv[1], settings={SHORT}))
bus.declare_alive("steerd/car1/alive")
print("up", flush=True)
sys.stdin.read()
"""


def test_a_killed_process_is_soon_not_alive():
    endpoint = free_endpoint()
    with ZenohBus(Profile(hub=True, endpoint=endpoint, settings=SHORT)) as hub:
        command = [sys.executable, "-c", HOLDER, endpoint]
        with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as process:
            process.stdout.readline()
            assert until(lambda: hub.alive("steerd/*/alive"))
            process.kill()
            assert until(lambda: not hub.alive("steerd/*/alive"))
