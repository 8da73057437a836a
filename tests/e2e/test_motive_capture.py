"""The real Motive capture, sent by another process at its recorded pace, filtered as it arrives."""

import os
import re
import select
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from steerd.car_model.params import DEFAULT_CAR
from steerd.estimator.config import FilterConfig
from steerd.estimator.sensors import make_pose
from steerd.estimator.state_filter import FilterState, make_state_filter, predict_to, step
from steerd.mocap_link.ingest import IngestConfig
from steerd.mocap_link.mocap_url import parse_mocap_url
from steerd.mocap_link.sockets import make_receiver
from steerd.mocap_link.source import SourceState

ROOT = Path(__file__).resolve().parents[2]
FRAMES = 518
pytestmark = pytest.mark.realtime


@pytest.fixture
def motive():
    """The address of a Motive that plays the capture, and its process."""
    capture = ROOT.parent / "shared" / "spec" / "natnet-capture" / "traffic.pcapng"
    if not capture.exists():
        pytest.skip("the Motive capture (../shared/spec/natnet-capture) is not here")
    argv = [sys.executable, "benchmarks/motive_replay.py", str(capture), "--delay", "0.5"]
    process = subprocess.Popen(argv, cwd=ROOT, stdout=subprocess.PIPE, text=True)
    said = process.stdout.readline()
    found = re.match(rf"{FRAMES} frames: (natnet://\S+)", said)
    assert found, said
    yield found[1], process
    process.kill()
    process.wait()
    process.stdout.close()


def receive(url, process):
    """Every sample until the sender has ended, and the source's last status."""
    receiver = make_receiver(parse_mocap_url(url), IngestConfig())
    end_fd = os.pidfd_open(process.pid)
    deadline = time.monotonic() + 30.0
    samples, states, ended = [], [], False
    while not ended:
        assert time.monotonic() < deadline
        fds = receiver.fds()
        ready = select.select([*fds, end_fd], [], [], 0.01)[0]
        ended = end_fd in ready
        for fd in fds:
            samples += receiver.read_ready(fd)
        receiver.on_timer(time.monotonic_ns())
        states.append(receiver.status().state)
    status = receiver.status()
    receiver.close()
    os.close(end_fd)
    return samples, status, states


def test_the_capture_gives_a_filtered_track(motive):
    samples, status, states = receive(*motive)
    assert status.server == "Motive NatNet 3.0"
    assert status.bodies == ("RaceQuad",)
    assert status.expected_rate_hz == pytest.approx(120.0)
    assert len(samples) + status.counts["backlog_dropped"] == FRAMES
    judged = {k: n for k, n in status.counts.items() if k in {s.rejected for s in samples}}
    accepted = [s for s in samples if s.rejected is None]
    assert status.counts["accepted"] == len(accepted)
    assert sum(judged.values()) == len(samples) - len(accepted)
    assert len(accepted) >= 0.97 * FRAMES, judged
    assert SourceState.OK in states
    span_s = (samples[-1].t_valid_ns - samples[0].t_valid_ns) * 1e-9
    frames = samples[-1].frame - samples[0].frame
    assert frames / span_s == pytest.approx(120.0, rel=0.002)
    latency = np.array([s.t_arrival_ns - s.t_valid_ns for s in accepted])
    assert 5e6 < np.median(latency) < 15e6  # 5.1 to 5.9 ms by Motive's own stamps, and the network
    check_track(accepted)


def check_track(samples):
    """The body lay still: the filter says so, and how well it knows."""
    xy = np.array([(s.x, s.y) for s in samples])
    assert np.ptp(xy, axis=0).max() < 1e-4
    noise = FilterConfig(pose_position_sd=1e-4, pose_yaw_sd=1e-3)
    flt, state, nis, estimate = make_state_filter(DEFAULT_CAR, noise), FilterState(), [], None
    for s in samples:
        pose = make_pose(s.t_valid_ns, s.x, s.y, s.yaw)
        state = step(flt, state, s.t_arrival_ns, (pose,))
        estimate = predict_to(flt, state, s.t_arrival_ns)
        if estimate is not None:
            nis.append(estimate.health.pose.nis)  # NaN at the first
    assert estimate.health.pose.refused == 0
    assert estimate.health.sound
    assert np.nanpercentile(nis, 99) < 16.3  # chi-square of 3 degrees at 99.9 %
    assert max(estimate.sd.x, estimate.sd.y) < 0.002
    assert estimate.state.x == pytest.approx(xy[:, 0].mean(), abs=1e-3)
    assert estimate.state.y == pytest.approx(xy[:, 1].mean(), abs=1e-3)
    assert abs(estimate.state.speed) < 0.02
