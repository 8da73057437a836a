"""Sets are disjoint, opaque, sealed; what was sealed opens once, logged, and unchanged."""

import json
from collections import Counter
from dataclasses import replace
from datetime import UTC, datetime

import numpy as np
import pytest

from benchmarks.blind_gap.__main__ import main
from benchmarks.blind_gap.bank import CARS, Source, make_plan
from benchmarks.blind_gap.detectability import load_severities, sigmas
from benchmarks.blind_gap.diagnosing import diagnose_set, expand
from benchmarks.blind_gap.effects import EFFECTS, OUTSIDE, SIZES
from benchmarks.blind_gap.generate import generate, key_path, load_car, make_runs
from benchmarks.blind_gap.inside import _claimed, _decoded, _encoded
from benchmarks.blind_gap.seal import KEY_BYTES, SealError, seal, unseal
from benchmarks.blind_gap.unsealing import OpeningError, load_labels, load_log, open_labels
from steerd.car_model.car_file import default_car_path
from steerd.car_model.car_file import load_car as load_default_car
from steerd.car_model.effects import find_effect
from steerd.steer_bus.messages import Actuation, MocapPose, VescTelemetry
from steerd.steer_bus.session import open_session

pytestmark = pytest.mark.slow

NOW = datetime(2030, 1, 1, tzinfo=UTC)
KEY, OTHER = bytes(range(KEY_BYTES)), bytes(KEY_BYTES)


@pytest.mark.parametrize("effect", ["steer_delay", "steer_rate_limit", "cog_offset"])
def test_strength_in_sigmas_goes_through_what_was_measured(effect):
    row = load_severities()[effect]
    assert sigmas(row, row["five_sigma"]) == pytest.approx(5.0)
    assert sigmas(row, row["small"]) == pytest.approx(7.5)
    assert sigmas(row, row["large"]) == pytest.approx(min(60.0, row["strongest_sigma"]))
    weaker = row["five_sigma"] * (0.5 if row["large"] > row["small"] else 1.01)
    assert sigmas(row, weaker) < 5.0


def test_plan_holds_the_grid():
    plan = make_plan(Source("report", 1))
    rich = Counter((c.truths[0].effect, c.truths[0].size) for c in plan if c.block == "single-rich")
    assert rich == {(effect, size): 5 for effect in EFFECTS for size in SIZES}
    kinds = Counter(case.kind for case in plan)
    assert kinds["null"] >= 100
    assert kinds["pair"] >= 60
    assert {c.outside for c in plan if c.kind == "outside"} == set(OUTSIDE)
    assert {c.control for c in plan if c.kind == "control"} == {"shuffled", "reversed", "zero"}
    assert len({case.name for case in plan}) == len(plan)
    assert {case.car >= CARS for case in plan if case.kind == "structural"} == {True}


def test_limit_keeps_shares():
    plan, few = make_plan(Source("report", 1)), make_plan(Source("report", 1), 200)
    all_kinds, kinds = (Counter(c.kind for c in cases) for cases in (plan, few))
    assert len(few) == 200
    for kind, count in all_kinds.items():
        assert abs(kinds[kind] - count * 200 / len(plan)) <= 6


def test_whole_parts_stay_beside_a_limit():
    plan = make_plan(Source("report", 1), 200, ("null", "single"), 4, ("null",))
    everything = make_plan(Source("report", 1), None, ("null",))
    assert len(plan) == 200
    assert sum(case.kind == "null" for case in plan) == len(everything)
    assert {case.car for case in plan} == set(range(4))


def test_names_do_not_follow_the_plan():
    plan = make_plan(Source("report", 1))
    singles = [case.kind == "single" for case in plan]
    half = len(singles) // 2
    assert abs(np.mean(singles[:half]) - np.mean(singles[half:])) < 0.1


def test_sets_share_no_seed():
    tuning, report = Source("tuning", 0), Source("report", 0)
    cars = {load_car(source, n) for source in (tuning, report) for n in range(CARS)}
    assert len(cars) == 2 * CARS
    draws = [s.rng("case", n).integers(2**63) for s in (tuning, report) for n in range(200)]
    assert len(set(draws)) == 400
    with pytest.raises(ValueError, match="no set"):
        Source("other").rng("car", 0)


def test_cases_repeat_by_seed():
    plan = make_plan(Source("tuning"))
    case = next(c for c in plan if c.kind == "pair")
    (one, label), (two, again) = (make_runs(Source("tuning"), case) for _ in range(2))
    assert label == again
    assert all(np.array_equal(a.poses, b.poses) for a, b in zip(one, two, strict=True))
    assert len(label) == 2
    assert all(entry["parameters"] for entry in label)


def test_severity_zero_is_the_healthy_car():
    case = next(c for c in make_plan(Source("tuning")) if c.control == "zero")
    _, label = make_runs(Source("tuning"), case)
    assert label[0]["parameters"] == EFFECTS[label[0]["effect"]].null


def test_seal_round_trip_and_tampering():
    text = b"the labels" * 50
    sealed = seal(text, KEY, bytes(16))
    assert text[:10] not in sealed
    assert unseal(sealed, KEY) == text
    with pytest.raises(SealError, match="wrong key"):
        unseal(sealed, OTHER)
    for at in range(len(sealed)):
        broken = bytearray(sealed)
        broken[at] ^= 1
        with pytest.raises(SealError):
            unseal(bytes(broken), KEY)
        with pytest.raises(SealError):
            unseal(sealed[:at], KEY)


@pytest.fixture(scope="module")
def small_set(tmp_path_factory):
    out = tmp_path_factory.mktemp("blind") / "set"
    generate("report", out, limit=1, nonce=3, blocks=("null-long",))
    return out


@pytest.fixture
def verdicts(tmp_path, small_set):
    folder = tmp_path / "verdicts"
    folder.mkdir()
    none = json.dumps({"schema": "steerd.gap/1", "verdict": "none", "causes": []})
    (folder / "case-0001.json").write_text(none)
    return folder


def test_sessions_open_as_any_other(small_set):
    manifest = json.loads((small_set / "manifest.json").read_text())
    session = open_session(small_set / manifest["cars"][0]["runs"][0])
    info = session.info()
    assert info.clean
    assert not info.warnings
    poses, commands = session.columns(MocapPose), session.columns(Actuation)
    assert len(poses["x"]) == len(commands["steer"]) == 1500
    assert np.all(np.diff(poses["t_valid_ns"]) == 10_000_000)
    if any(topic.name.endswith("vesc") for topic in info.topics):
        erpm = session.columns(VescTelemetry)["erpm"]
        assert np.abs(erpm / 4614 - commands["speed"][::2]).mean() < 0.3


def test_manifest_tells_nothing(small_set):
    text = (small_set / "manifest.json").read_text()
    assert not any(word in text for word in (*EFFECTS, *OUTSIDE, "null", "nonce"))
    assert not (small_set / "labels.json").exists()


def test_opening_wants_verdicts_and_is_logged(small_set, verdicts, tmp_path):
    log = tmp_path / "opened.jsonl"
    with pytest.raises(OpeningError, match="sealed"):
        load_labels(small_set, verdicts, log)
    with pytest.raises(OpeningError, match="no verdict yet"):
        open_labels(small_set, tmp_path, log=log, now=NOW)
    assert load_log(log) == []
    for _ in range(2):
        open_labels(small_set, verdicts, log=log, now=NOW)
    labels, openings = load_labels(small_set, verdicts, log)
    assert labels["nonce"] == 3
    assert [case["kind"] for case in labels["cases"]] == ["null"]
    assert len(openings) == 2
    (verdicts / "case-0001.json").write_text("{}")
    with pytest.raises(OpeningError, match="not the ones"):
        load_labels(small_set, verdicts, log)
    log.write_text(log.read_text().splitlines()[1] + "\n")
    with pytest.raises(OpeningError, match="does not follow"):
        load_log(log)
    (small_set / "labels.json").unlink()


def test_opening_refuses_other_labels(small_set, verdicts, tmp_path):
    path = small_set / "labels.sealed"
    whole = path.read_bytes()
    path.write_bytes(whole[:-1] + bytes([whole[-1] ^ 1]))
    with pytest.raises(OpeningError, match="published"):
        open_labels(small_set, verdicts, log=tmp_path / "log", now=NOW)
    path.write_bytes(whole)
    wrong = tmp_path / "wrong.key"
    wrong.write_text(OTHER.hex())
    with pytest.raises(SealError):
        open_labels(small_set, verdicts, wrong, log=tmp_path / "log", now=NOW)
    assert not (tmp_path / "log").exists()


def test_key_is_private_and_outside(small_set):
    assert key_path(small_set).stat().st_mode & 0o077 == 0
    assert key_path(small_set).parent == small_set.parent


def test_commands_are_expanded():
    words = expand(
        "tool {runs} --held {held} --base {base}", {"runs": ["a", "b"], "held": [], "base": "c"}
    )
    assert words == ["tool", "a", "b", "--base", "c"]
    assert expand("t --h {held}", {"held": ["x", "y"]}) == ["t", "--h", "x", "y"]


def test_whole_chain_with_a_stand_in_tool(small_set, tmp_path, capsys):
    verdicts, page = tmp_path / "verdicts", tmp_path / "page.md"
    answer = tmp_path / "answer.json"
    answer.write_text('{"schema": "steerd.gap/1", "verdict": "none"}')
    common = ["--out", str(small_set), "--verdicts", str(verdicts)]
    logged = [*common, "--log", str(tmp_path / "log")]
    tools = ["--identify", "touch {base}", "--diagnose", f"cat {answer}"]
    assert main(["open", *logged]) == 1
    assert main(["run", *common, *tools]) == 0
    assert float((verdicts / "case-0001.time").read_text()) > 0.0
    assert main(["score", *logged, "--page", str(page)]) == 1
    assert "sealed" in capsys.readouterr().err
    assert main(["open", *logged]) == 0
    assert main(["score", *logged, "--page", str(page)]) == 0
    assert "| false alarms on nulls | 0.0 % (0/1; 0 to 79) | ≤ 2 % | yes |" in page.read_text()
    assert "nonce 3" in page.read_text()
    assert "opened 1 times" in page.read_text()
    (small_set / "labels.json").unlink()


def test_a_base_is_kept_and_read_again(tmp_path):
    car = load_default_car(default_car_path())
    effects = (find_effect("steer_backlash"),)
    base = replace(
        car, effects=effects, values=((0.01,),), sd={"lf": 0.002},
        sections={**car.sections, "noise": {"position": 1e-3}},
    )  # fmt: skip
    again = _decoded(json.dumps(_encoded(base)))
    assert again.model == base.model
    assert (again.sd, again.sections["noise"]) == (base.sd, base.sections["noise"])


def test_two_processes_never_work_on_one_case(tmp_path):
    assert _claimed(tmp_path / "case-0001.json")
    assert not _claimed(tmp_path / "case-0001.json")


def test_failing_tool_leaves_its_reason(small_set, tmp_path):
    diagnose_set(small_set, tmp_path, "touch {base}", "sh -c 'echo broken >&2; exit 3'")
    assert "broken" in (tmp_path / "case-0001.error").read_text()
    assert not (tmp_path / "case-0001.json").exists()
