"""Cases, lists, the commands, and the table that comes of them."""

import json
import sys
from pathlib import Path

import numpy as np
import pytest

from benchmarks.blind_gap.seal import SealError
from benchmarks.foreign_cars.__main__ import main
from benchmarks.foreign_cars.bank import Shares, draw_cases, load_cases, save_cases
from benchmarks.foreign_cars.cases import Case, healthy_logs, later_logs
from benchmarks.foreign_cars.judge import ROWS, judge, read_rows
from benchmarks.foreign_cars.plants import make_plant
from benchmarks.foreign_cars.table import format_cases, format_table, score_rows

SECONDS = 3.0
TOOL = """
import json, os, sys
words = sys.argv[1:]
out = lambda option: words[words.index(option) + 1]
if words[0] == "import":
    assert not os.path.exists(out("-o") + ".partial")
    open(out("-o"), "w").write(open(words[2]).read())
elif words[0] == "identify":
    sessions = [w for w in words[1:3]]
    assert all(w.endswith(".mcap") for w in sessions)
    open(out("-o"), "w").write("[car]")
    value = {"value": 0.16, "sd": 0.01, "unit": "m", "identifiable": True}
    answer = {"parameters": {"lf": value}, "held_out": {"horizons": [
        {"horizon": 1.0, "position": 0.02}]}}
    open(out("--json"), "w").write(json.dumps(answer))
else:
    assert words[4] == "--base"
    if "fail" in open(words[1]).name:
        sys.exit(4)
    cause = {"effect": "steer_delay", "confidence": 0.9,
             "parameters": {"delay": {"value": 0.031, "sd": 0.001, "unit": "s"}},
             "shrink": {"predicted": 0.9, "measured": 0.88}, "ambiguous_with": ["steer_lag"]}
    other = {**cause, "effect": "scrub", "parameters": {}}
    answer = {"schema": "steerd.gap/1", "verdict": "explained", "causes": [cause, other],
              "candidates": [], "gap": {"before": {"errors": []}, "after": {"errors": []}}}
    open(out("--json"), "w").write(json.dumps(answer))
"""


@pytest.fixture
def tool(tmp_path: Path) -> str:
    script = tmp_path / "tool.py"
    script.write_text(TOOL)
    return f"{sys.executable} {script}"


def a_case(*hidden: tuple[str, str], number: int = 0) -> Case:
    return Case("own", 7, number, hidden, seconds=SECONDS)


def test_healthy_drives_are_the_cars_and_later_ones_the_cases() -> None:
    one, other = a_case(), a_case(("steer_delay", "large"), number=1)
    for a, b in zip(healthy_logs(one), healthy_logs(other), strict=True):
        np.testing.assert_array_equal(a.poses, b.poses)
    first, labels = later_logs(other)
    assert labels == [
        {
            "effect": "steer_delay",
            "size": "large",
            "strength": 0.06,
            "parameters": {"delay": 0.06},
        }
    ]
    assert len(first) == 3
    assert not np.array_equal(first[0].commands, first[1].commands)
    assert not np.array_equal(first[0].commands, later_logs(one)[0][0].commands)


def test_the_hidden_effect_is_all_that_differs_from_the_null_of_that_number() -> None:
    null, labels = later_logs(a_case(number=1))
    ill, _ = later_logs(a_case(("mocap_yaw", "large"), number=1))
    assert labels == []
    for a, b in zip(null, ill, strict=True):
        np.testing.assert_array_equal(a.poses[:, :2], b.poses[:, :2])
        np.testing.assert_allclose(np.abs(a.poses[:, 2] - b.poses[:, 2]), 0.02, atol=1e-12)


def test_a_patch_lies_where_the_car_drives() -> None:
    logs, labels = later_logs(a_case(("grip_patch", "large")))
    values = labels[0]["parameters"]
    places = np.concatenate([log.poses[:, :2] for log in logs])
    inside = np.hypot(*(places - [values["x"], values["y"]]).T) < values["radius"]
    assert inside.mean() > 0.1


def test_names_do_not_show_what_is_hidden() -> None:
    names = [a_case().name, a_case(("steer_delay", "large")).name]
    assert len(set(names)) == 2
    assert not any("delay" in name for name in names)


def test_a_list_is_a_function_of_its_nonce() -> None:
    shares = Shares(nulls=2, singles=40, pairs=3, outside=4, cars=2)
    cases = draw_cases(5, shares, ("own",))
    assert cases == draw_cases(5, shares, ("own",))
    assert {c.seed for c in cases}.isdisjoint(c.seed for c in draw_cases(6, shares, ("own",)))
    kinds = [case.kind for case in cases]
    assert [kinds.count(k) for k in ("null", "single", "pair", "outside")] == [2, 40, 3, 4]
    singles = {case.hidden[0][0] for case in cases if case.kind == "single"}
    assert singles == make_plant("own", 1).effects
    assert len({case.name for case in cases}) == len(cases)


def test_a_sealed_list_opens_with_its_key_only(tmp_path: Path) -> None:
    cases = draw_cases(5, Shares(1, 2, cars=1), ("own",))
    path = tmp_path / "list.sealed"
    save_cases(path, cases, sealed=True)
    assert b"own" not in path.read_bytes()
    assert load_cases(path, path.with_name("list.sealed.key")) == cases
    path.write_bytes(path.read_bytes()[:-1] + b"x")
    with pytest.raises(SealError):
        load_cases(path, path.with_name("list.sealed.key"))
    with pytest.raises(FileExistsError):
        save_cases(path, cases)


def test_judging_writes_a_row_a_case_once(tmp_path: Path, tool: str) -> None:
    cases = [a_case(("steer_delay", "medium")), a_case(number=1)]
    out = tmp_path / "out"
    rows = judge(cases[:1], out, tool)
    assert [row["kind"] for row in rows] == ["single"]
    assert rows[0]["gap"]["verdict"] == "explained"
    assert rows[0]["identify"]["parameters"]["lf"]["value"] == 0.16
    assert len(judge(cases, out, tool)) == 2
    assert len(read_rows(out / ROWS)) == 2
    column = score_rows(read_rows(out / ROWS))
    assert column["false alarms on nulls"].startswith("100 % (1/1")
    assert column["first name right, of detected"].startswith("100 % (1/1")
    assert column["invented second name at 0.8 or more"].startswith("100 % (1/1")
    assert column["mean size of the set"] == "2"
    assert column["parameter error, median; 90 %"] == "3.33; 3.33 %"
    assert column["identify: position after 1 s, median"] == "20 mm"
    table = format_table(rows)
    assert table.splitlines()[0] == "| | own |"
    assert "steer_delay medium" in format_cases(rows)


def test_an_import_that_was_cut_off_is_done_again(tmp_path: Path, tool: str) -> None:
    case = a_case(("steer_delay", "medium"))
    folder = tmp_path / "out" / "cases" / case.name
    folder.mkdir(parents=True)
    (folder / "later-1.mcap.partial").write_text("cut off")
    assert judge([case], tmp_path / "out", tool)[0]["gap"]["verdict"] == "explained"


def test_a_command_that_fails_is_a_row_without_a_verdict(tmp_path: Path) -> None:
    rows = judge([a_case()], tmp_path, f"{sys.executable} -c 'import sys; sys.exit(4)'")
    assert "exit 4" in rows[0]["error"]
    column = score_rows(rows)
    assert column["cases; without a verdict"] == "1; 1"
    assert column["false alarms on nulls"].startswith("100 %")


def test_make_writes_tables_that_the_import_reads(tmp_path: Path) -> None:
    out = tmp_path / "case"
    words = ["make", "--plant", "own", "--seed", "7", "--seconds", "3", "-o", str(out)]
    assert main([*words, "--effect", "steer_delay", "--severity", "medium"]) == 0
    assert sorted(p.name for p in out.iterdir()) == [
        "healthy-1.csv", "healthy-2.csv", "later-1.csv", "later-2.csv", "later-3.csv", "map.toml",
    ]  # fmt: skip
    from steerd.daemon.cli.main import run_cli

    session = tmp_path / "drive.mcap"
    maps = ["--map", str(out / "map.toml"), "-o", str(session)]
    assert run_cli(["import", "csv", str(out / "later-1.csv"), *maps]) == 0
    assert session.stat().st_size > 10_000


def test_an_unknown_effect_is_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    words = ["make", "--plant", "own", "--seed", "7", "--seconds", "3", "-o", str(tmp_path)]
    assert main([*words, "--effect", "gremlins"]) == 1
    assert capsys.readouterr().err.startswith("foreign_cars: gremlins")


def test_rows_survive_as_json(tmp_path: Path, tool: str) -> None:
    judge([a_case()], tmp_path, tool)
    rows = [json.loads(line) for line in (tmp_path / ROWS).read_text().splitlines()]
    assert rows[0]["case"]["plant"] == "own"
    assert rows[0]["errors"] == {"before": [], "after": []}
