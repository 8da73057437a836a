"""Two network namespaces: a car's gateway in one, a stranger in the other, a cable between.

Run as a script in a network namespace of its own (`unshare -Urn`); it makes the second one itself.
Prints as JSON what the stranger delivered to the core's socket and what it read.
"""

import json
import select
import socket
import subprocess
import sys
import time
from pathlib import Path

import zenoh  # noqa: TID251

from steerd.daemon.process.gateway import Gateway
from steerd.steer_bus import messages as m
from steerd.steer_bus import topics
from steerd.steer_bus.codec import encode
from steerd.steer_bus.lab import load_lab
from steerd.steer_bus.topics import BusError, make_key
from steerd.steer_bus.zenoh_bus import Profile, ZenohBus

CAR, PORT, ORDERS = "10.9.0.1", 7447, 50
ORDER = encode(
    m.OperatorRequest(m.make_header(0, m.BODY), 1, 1, 1, int(m.RequestKind.START), "stranger")
)
COMMAND = encode(m.DriveCommand(m.make_header(0, m.BODY), 1, 1, 0, 1, 100, 0.0, 1.0))


def pause(seconds):
    select.select([], [], [], seconds)


def serve(what, labs):
    """The car's namespace: a gateway, the other namespace, and both counts."""
    lab = load_lab(labs / "ours" / "car1") if what == "lab" else None
    endpoint = f"tcp/127.0.0.1:{PORT}" if what == "loopback" else f"tcp/{CAR}:{PORT}"
    endpoint = lab.endpoint if lab else endpoint
    ip("link set lo up")
    command = ["unshare", "-n", sys.executable, __file__, "stranger", what, str(labs)]
    stranger = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    assert stranger.stdout.readline() == "there\n"
    ip(f"link add name car type veth peer name out netns {stranger.pid}")
    ip(f"addr add {CAR}/24 dev car")
    ip("link set car up")
    profile = Profile(True, endpoint, lab, insecure_lan=what == "plain")
    theirs, core = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    theirs.setblocking(False)
    core.setblocking(False)
    delivered = 0
    with ZenohBus(profile) as bus:
        gateway = Gateway(bus, "car1", None)
        stranger.stdin.write("go\n")
        stranger.stdin.close()
        while stranger.poll() is None:
            bus.publish(make_key("car1", topics.STATE), b"secret")
            gateway.forward_requests(theirs)
            while select.select([core], [], [], 0)[0]:
                core.recv(65536)
                delivered += 1
            pause(0.01)
        open_sockets = list_listening()
    read = json.loads(stranger.stdout.read())
    print(json.dumps({"delivered": delivered, "read": read, "listening": open_sockets}))


def ip(arguments):
    subprocess.run(["ip", *arguments.split()], check=True)


def list_listening():
    """What this namespace listens on: address:port of TCP, and of any UDP socket."""
    found = []
    for proto in ("tcp", "tcp6", "udp", "udp6"):
        for line in Path(f"/proc/net/{proto}").read_text().splitlines()[1:]:
            _, local, _, state = line.split()[:4]
            if proto.startswith("udp") or state == "0A":
                host, port = local.split(":")
                address = socket.inet_ntoa(bytes.fromhex(host)[::-1]) if len(host) == 8 else host
                found.append(f"{proto}/{address}:{int(port, 16)}")
    return found


def be_stranger(what, labs):
    """The other namespace: all that one can try, then what each way read."""
    print("there", flush=True)
    sys.stdin.readline()
    ip("link set lo up")
    ip("addr add 10.9.0.2/24 dev out")
    ip("link set out up")
    wait_for_cable()
    read = {"plain": by_profile(Profile(False, f"tcp/{CAR}:{PORT}"))}
    if what != "plain":  # where one answer says that the others could have come
        read["scouting"] = by_scouting()
        read["no certificate"] = by_profile(Profile(False, f"tls/{CAR}:{PORT}"))
        read["foreign operator"] = by_folder(labs / "theirs" / "desk")
    if what == "lab":
        read["viewer"] = by_folder(labs / "ours" / "screen")
    print(json.dumps(read), flush=True)


def wait_for_cable():
    end = time.monotonic() + 5.0
    while time.monotonic() < end:
        shown = subprocess.run(["ip", "link", "show", "out"], capture_output=True, text=True)
        if "LOWER_UP" in shown.stdout:
            return
        pause(0.05)


def by_scouting():
    """zenoh as it comes, which finds and links whatever answers."""
    got = []
    with zenoh.open(zenoh.Config()) as session:
        held = session.declare_subscriber("**", lambda sample: got.append(str(sample.key_expr)))
        end = time.monotonic() + 1.5
        while time.monotonic() < end:
            session.put(make_key("car1", topics.OPERATOR), ORDER)
            session.put(make_key("car1", topics.DRIVE), COMMAND)
            pause(0.02)
        held.undeclare()
    return sum(key.endswith("/state") for key in got)


def by_folder(folder):
    lab = load_lab(folder)
    return by_profile(Profile(False, lab.endpoint, lab))


def by_profile(profile):
    try:
        bus = ZenohBus(profile)
    except BusError:
        return 0
    got = 0
    with bus:
        every = [bus.subscribe(key, 1000) for key in ("steerd/car1/*", "steerd/**")]
        for _ in range(ORDERS):
            bus.publish(make_key("car1", topics.OPERATOR, bus.who), ORDER)
            bus.publish(make_key("car1", topics.DRIVE, bus.who), COMMAND)
            pause(0.01)
        for subscription in every:
            got += sum(sample.data == b"secret" for sample in subscription.poll())
    return got


if __name__ == "__main__":
    role, what, labs = sys.argv[1:]
    (serve if role == "car" else be_stranger)(what, Path(labs))
