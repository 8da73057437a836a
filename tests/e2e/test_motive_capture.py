"""The real Motive capture through the client, the gates and the filter, in its own time."""

from pathlib import Path

import numpy as np
import pytest

from steerd.car_model.params import DEFAULT_CAR
from steerd.estimator.config import FilterConfig
from steerd.estimator.sensors import make_pose
from steerd.estimator.state_filter import FilterState, make_state_filter, predict_to, step
from steerd.mocap_link import natnet
from steerd.mocap_link.frame import FrameConfig
from steerd.mocap_link.ingest import IngestConfig
from steerd.mocap_link.natnet_client import NatNetSource
from tests.unit.mocap_link.conftest import read_pcapng

CAPTURE = Path(__file__).resolve().parents[3] / "shared/spec/natnet-capture/traffic.pcapng"
FRAMES = 518
CONFIG = IngestConfig(frame=FrameConfig(up="y"))
pytestmark = pytest.mark.skipif(
    not CAPTURE.exists(), reason="the Motive capture (../shared/spec/natnet-capture) is not here"
)


def test_the_capture_gives_a_filtered_track() -> None:
    datagrams = list(read_pcapng(CAPTURE.read_bytes()))
    frames = [d for d in datagrams if natnet.peek_id(d.data) == natnet.FRAME_ID]
    server, to = frames[0].source[0], frames[0].destination
    source, samples = NatNetSource("RaceQuad", server, CONFIG), []
    for d in datagrams:
        source.on_timer(d.t_ns)
        which = "data" if d.destination == to else "command"
        samples += source.on_datagram(d.data, d.t_ns, d.source[0], which)
    status = source.status()
    assert (status.server, status.bodies) == ("Motive NatNet 3.0", ("RaceQuad",))
    assert len(frames) == FRAMES
    accepted = [s for s in samples if s.rejected is None]
    assert len(accepted) >= 0.97 * FRAMES, status.counts
    span_s = (samples[-1].t_valid_ns - samples[0].t_valid_ns) * 1e-9
    assert (samples[-1].frame - samples[0].frame) / span_s == pytest.approx(120.0, rel=0.002)
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
    assert estimate is not None
    assert estimate.health.pose.refused == 0
    assert estimate.health.sound
    assert np.nanpercentile(nis, 99) < 16.3  # chi-square of 3 degrees at 99.9 %
    assert max(estimate.sd.x, estimate.sd.y) < 0.002
    assert (estimate.state.x, estimate.state.y) == pytest.approx(tuple(xy.mean(axis=0)), abs=1e-3)
    assert abs(estimate.state.speed) < 0.02
