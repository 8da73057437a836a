"""Cases, lists, the commands, and the table that comes of them."""

import sys
from pathlib import Path

import numpy as np
import pytest

from benchmarks.foreign_cars.bank import Shares, draw_cases
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
        {"effect": "steer_delay", "size": "large", "strength": 0.06, "parameters": {"delay": 0.06}}
    ]
    assert len(first) == 3
    assert not np.array_equal(first[0].commands, first[1].commands)
    assert not np.array_equal(first[0].commands, later_logs(one)[0][0].commands)


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
