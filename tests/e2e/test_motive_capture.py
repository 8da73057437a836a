"""The real Motive capture played to the client in virtual time, and filtered as it arrives."""

from collections import Counter
from pathlib import Path

import numpy as np
import pytest

from benchmarks.motive_replay import Capture, load_capture
from steerd.car_model.params import DEFAULT_CAR
from steerd.estimator.config import FilterConfig
from steerd.estimator.sensors import make_pose
from steerd.estimator.state_filter import FilterState, make_state_filter, predict_to, step
from steerd.mocap_link import natnet
from steerd.mocap_link.frame import FrameConfig
from steerd.mocap_link.ingest import IngestConfig
from steerd.mocap_link.natnet_client import NatNetSource
from steerd.mocap_link.source import SourceState

ROOT = Path(__file__).resolve().parents[2]
FRAMES, IP, MS, START_NS = 518, "127.0.0.1", 1_000_000, 500_000_000


def answer(capture: Capture, data: bytes, t_ns: int) -> bytes | None:
    """What Motive said to such a request; its clock is set so that frames leave as stamped."""
    match natnet.decode(data, (3, 0)):
        case natnet.Bare.CONNECT:
            return capture.info_packet
        case natnet.Bare.REQUEST_MODEL:
            return capture.model_packet
        case natnet.Request(text="FrameRate"):
            return capture.rate_packet
        case natnet.EchoRequest(client_stamp=stamp):
            since = (t_ns - START_NS) * capture.info.clock_hz // 1_000_000_000
            return natnet.encode(natnet.EchoResponse(stamp, capture.first_ticks + since), (3, 0))
    return None


def play(capture: Capture):
    """Every sample of the capture, the source, and its states on the way."""
    source = NatNetSource("RaceQuad", IP, IngestConfig(frame=FrameConfig(up="y")))
    samples, states, first_ns = [], set(), capture.frames[0][0]
    frames = [(START_NS + t_ns - first_ns, data) for t_ns, data in capture.frames]
    for now in range(0, frames[-1][0] + 2 * MS, MS):
        for request in source.on_timer(now):
            reply = answer(capture, request, now + MS // 10)
            if reply is not None:
                source.on_datagram(reply, now + MS // 5, IP)
        while frames and frames[0][0] < now + MS:
            t_ns, data = frames.pop(0)
            samples += source.on_datagram(data, t_ns, IP, "data")
        states.add(source.status().state)
    return samples, source.status(), states


def test_the_capture_gives_a_filtered_track():
    path = ROOT.parent / "shared" / "spec" / "natnet-capture" / "traffic.pcapng"
    if not path.exists():
        pytest.skip("the Motive capture (../shared/spec/natnet-capture) is not here")
    capture = load_capture(path)
    assert capture.info == natnet.ServerInfo(  # there is garbage behind its name
        "Motive", (2, 1, 0, 0), (3, 0, 0, 0), 3_312_787, 1511, True, "239.255.42.99"
    )
    samples, status, states = play(capture)
    assert (status.server, status.bodies) == ("Motive NatNet 3.0", ("RaceQuad",))
    assert status.expected_rate_hz == pytest.approx(120.0)
    assert len(samples) == FRAMES
    accepted = [s for s in samples if s.rejected is None]
    assert len(accepted) >= 0.97 * FRAMES, Counter(s.rejected for s in samples)
    assert SourceState.OK in states
    span_s = (samples[-1].t_valid_ns - samples[0].t_valid_ns) * 1e-9
    frames = samples[-1].frame - samples[0].frame
    assert frames / span_s == pytest.approx(120.0, rel=0.002)
    latency = np.array([s.t_arrival_ns - s.t_valid_ns for s in accepted])
    assert 5e6 < np.median(latency) < 7e6  # 5.1 to 5.9 ms by Motive's own stamps
    stamps = np.array([(s.t_valid_ns, s.t_arrival_ns) for s in accepted[120:]])
    steady, late = np.std(np.diff(stamps, axis=0), axis=0) * 1e-6
    assert steady < 0.02 < 0.2 < late, "exposure is regular although arrival is not [ms]"
    # The body lay still: the filter says so, and how well it knows.
    xy = np.array([(s.x, s.y) for s in accepted])
    assert np.ptp(xy, axis=0).max() < 1e-4
    noise = FilterConfig(pose_position_sd=1e-4, pose_yaw_sd=1e-3)
    flt, state, nis, estimate = make_state_filter(DEFAULT_CAR, noise), FilterState(), [], None
    for s in accepted:
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
