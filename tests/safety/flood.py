"""A stranger's process that floods bus keys with garbage: `flood.py ENDPOINT RATE KEY…`.

Says `flooding` once it sends, and how many messages a second it sent when its standard input ends.
It knows nothing of steerd.
"""

import json
import select
import sys
import time

import numpy as np
import zenoh  # noqa: TID251

SEED, LONGEST, PAUSE_S = 20, 90, 0.001


def main(endpoint: str, rate: float, keys: list[str]) -> None:
    config = zenoh.Config()
    for name, value in (
        ("mode", "client"),
        ("connect/endpoints", [endpoint]),
        ("scouting/multicast/enabled", False),
    ):
        config.insert_json5(name, json.dumps(value))
    chance = np.random.default_rng(SEED)
    junk = [chance.bytes(int(chance.integers(LONGEST))) for _ in range(257)]
    with zenoh.open(config) as session:
        senders = [
            session.declare_publisher(
                key,
                priority=zenoh.Priority.REAL_TIME,
                congestion_control=zenoh.CongestionControl.BLOCK,
            )
            for key in keys
        ]
        print("flooding", flush=True)
        began, sent = time.monotonic(), 0
        while not select.select([sys.stdin], [], [], PAUSE_S)[0]:
            for number in range(sent, round((time.monotonic() - began) * rate)):
                senders[number % len(senders)].put(junk[number % len(junk)])
                sent = number + 1
        print(round(sent / (time.monotonic() - began)), flush=True)


if __name__ == "__main__":
    main(sys.argv[1], float(sys.argv[2]), sys.argv[3:])
