"""`steerd watch` beside a running car."""

import signal

import pytest

pytestmark = [pytest.mark.realtime, pytest.mark.timeout(240)]


def test_a_running_car_is_watched_and_a_wrong_name_is_reported(steerd, tmp_path):
    run = steerd(
        "run", "--sim", "--auto-arm", "--path", "circle:radius=2",
        "--listen", steerd.endpoint, "--record", tmp_path / "drive.mcap",
    )  # fmt: skip
    run.expect("RUNNING")
    watch = steerd("watch", "--connect", steerd.endpoint, "--seconds", "1.5")
    other = steerd("watch", "--connect", steerd.endpoint, "--name", "blue", "--seconds", "0.5")
    assert watch.wait() == 0
    assert other.wait() == 6
    assert "--name car1" in other.text
    assert "RUNNING" in watch.text
    assert "m/s, e1" in watch.text
    assert "fault none" in watch.text
    run.send(signal.SIGINT)
    assert run.wait() == 0, run.text
