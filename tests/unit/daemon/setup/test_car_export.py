"""A car for other simulators: the numbers arrive, the rest is said, and MuJoCo drives alike."""

import re
from dataclasses import replace
from math import hypot, tan
from xml.etree import ElementTree

import numpy as np
import pytest

from steerd.car_model.car_file import default_car_path, load_car
from steerd.car_model.ops import FLOAT
from steerd.car_model.params import wheelbase
from steerd.car_model.rollout import simulate, start
from steerd.car_model.state import ORIGIN, Command
from steerd.daemon.setup.car_export import make_gym_yaml, make_mjcf

GYM = [
    "mu", "C_Sf", "C_Sr", "lf", "lr", "h", "m", "I", "s_min", "s_max", "sv_min", "sv_max",
    "v_switch", "a_max", "v_min", "v_max", "width", "length",
]  # fmt: skip
ANGLE, SPEED = 0.1, 1.5


def car_of(**values):
    file = load_car(default_car_path())
    return replace(file, car=file.car._replace(**values))


def test_the_gym_gets_its_own_names_and_the_cars_numbers():
    made = make_gym_yaml(car_of(mass=3.1, c_sf=4.0), SPEED)
    lines = [line for line in made.text.splitlines() if not line.startswith("#")]
    found = {name: float(value) for name, value in (line.split(": ") for line in lines)}
    assert list(found) == GYM
    assert (found["m"], found["C_Sf"], found["lf"], found["sv_min"]) == (3.1, 4.0, 0.15875, -3.2)
    assert (found["width"], found["length"]) == (0.31, 0.58), "the gym's own car"


@pytest.mark.parametrize("make", [make_gym_yaml, make_mjcf])
def test_what_is_lost_is_said_in_the_file_too(make):
    made = make(car_of(steer_delay=0.07, pose_delay=0.02), SPEED)
    assert any("steer_delay = 0.07, pose_delay = 0.02" in sentence for sentence in made.lost)
    assert all(sentence in made.text for sentence in made.lost)


def test_mass_centre_and_yaw_inertia_of_the_bodies_are_the_cars():
    file = car_of(mass=3.1, inertia_z=0.03)
    root = ElementTree.fromstring(make_mjcf(file, SPEED).text)
    parts = []
    for body in root.iter("body"):
        place = body.get("pos") if body.get("name") != "car" else "0 0 0"
        inertial = body.find("inertial")
        at = np.array([place.split(), inertial.get("pos").split()], float).sum(axis=0)
        yaw = float(inertial.get("diaginertia").split()[2])
        parts.append((float(inertial.get("mass")), at, yaw))
    assert len(parts) == 5
    mass = sum(m for m, _, _ in parts)
    assert mass == pytest.approx(3.1, rel=1e-4)
    assert sum(m * at for m, at, _ in parts) / mass == pytest.approx(np.zeros(3), abs=1e-5)
    turning = sum(yaw + m * (at[0] ** 2 + at[1] ** 2) for m, at, yaw in parts)
    assert turning == pytest.approx(file.car.inertia_z, rel=1e-4)


def test_a_name_cannot_end_the_comment_or_begin_a_line():
    evil = replace(car_of(), name='a --> <b>"\nmu: 9')
    assert ElementTree.fromstring(make_mjcf(evil, SPEED).text).get("model").startswith("a -->")
    assert len(re.findall(r"^mu:", make_gym_yaml(evil, SPEED).text, re.MULTILINE)) == 1


@pytest.mark.parametrize(("c_sf", "c_sr"), [(4.718, 5.4562), (2.5, 6.0), (6.0, 4.0)])
def test_mujoco_drives_the_circle_that_steerd_predicts(c_sf, c_sr):
    """Curvature of a steady turn, with tyres as published, under- and oversteering."""
    mujoco = pytest.importorskip("mujoco")
    file = car_of(c_sf=c_sf, c_sr=c_sr)
    moment = start(file.model, ORIGIN._replace(speed=SPEED), 0.0)
    ours = simulate(FLOAT, file.model, moment, [Command(ANGLE, SPEED)] * 2000, 0.004)[-1].state
    built = mujoco.MjModel.from_xml_string(make_mjcf(file, SPEED).text)
    data = mujoco.MjData(built)
    data.qvel[0] = SPEED
    data.ctrl[:] = (ANGLE, ANGLE, SPEED)
    for _ in range(4000):
        mujoco.mj_step(built, data)
    theirs = data.qvel[5] / hypot(data.qvel[0], data.qvel[1])
    expected = ours.yaw_rate / ours.speed
    assert theirs == pytest.approx(expected, rel=0.01)
    without_slip = tan(ANGLE) / wheelbase(file.car)
    assert abs(theirs - expected) < 0.5 * abs(without_slip - expected)


def test_the_command_says_what_is_lost(tmp_path, cli):
    for name in ("car.xml", "car.YAML"):
        said = cli("export", default_car_path(), "-o", tmp_path / name).out
        assert "What is lost:" in said
        assert max(map(len, said.splitlines()[1:])) <= 80
