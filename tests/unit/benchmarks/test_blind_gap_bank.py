"""Sets are disjoint, opaque, sealed; what was sealed opens once, logged, and unchanged."""

import json
from datetime import UTC, datetime

import pytest

from benchmarks.blind_gap.bank import CARS, Source
from benchmarks.blind_gap.generate import generate, load_car
from benchmarks.blind_gap.seal import KEY_BYTES, SealError, seal, unseal
from benchmarks.blind_gap.unsealing import OpeningError, load_labels, load_log, open_labels

pytestmark = pytest.mark.slow

NOW = datetime(2030, 1, 1, tzinfo=UTC)
KEY, OTHER = bytes(range(KEY_BYTES)), bytes(KEY_BYTES)


def test_sets_share_no_seed():
    tuning, report = Source("tuning", 0), Source("report", 0)
    cars = {load_car(source, n) for source in (tuning, report) for n in range(CARS)}
    assert len(cars) == 2 * CARS
    draws = [s.rng("case", n).integers(2**63) for s in (tuning, report) for n in range(200)]
    assert len(set(draws)) == 400
    with pytest.raises(ValueError, match="no set"):
        Source("other").rng("car", 0)


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
