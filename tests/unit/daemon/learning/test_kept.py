"""The page beside the car file: it comes back as it was, or is refused in one line."""

import json
import tomllib
from dataclasses import replace
from hashlib import sha256

import pytest

from steerd.car_model.car_file import default_car_path, load_car, parse_car
from steerd.daemon.learning.feed import read_memory
from steerd.daemon.learning.keeping import EVERY_NS, Keeper
from steerd.daemon.learning.kept import (
    DAY_NS,
    About,
    KeptError,
    digest_numbers,
    format_kept,
    parse_kept,
    recall,
)
from steerd.steer_bus import messages as m

ABOUT = About("car1", "ab" * 32, "1.0", 'a "wet" one.mcap')


@pytest.fixture
def report(make_report, make_change):
    return make_report("named", make_change())


@pytest.fixture
def page(report):
    return format_kept(ABOUT, report)


def test_a_page_comes_back_as_it_was(page, report):
    kept = parse_kept(page.encode())
    assert kept.about == ABOUT
    assert kept.written_ns == m.stamp_ns(report.header)
    assert kept.values == {"steer_gain": (0.98, 0.012)}, "only what is identifiable"
    (change,) = tomllib.loads(page)["changes"]
    assert change == "since 11:59:20: steer_bias +0.0213 ± 0.0021 rad, 97 %"


def test_a_page_that_is_torn_at_any_byte_is_refused(page):
    data = page.encode()
    for end in range(len(data)):
        with pytest.raises(KeptError):
            parse_kept(data[:end])


def test_a_page_with_any_byte_changed_is_refused(page):
    data = page.encode()
    for place in range(len(data)):
        with pytest.raises(KeptError):
            parse_kept(data[:place] + bytes([data[place] ^ 1]) + data[place + 1 :])


def test_a_page_of_this_form_with_other_keys_is_refused(page):
    other = replace_body(page, "[values]", "[numbers]")
    with pytest.raises(KeptError, match="not what steerd writes"):
        parse_kept(other)


def replace_body(page, old, new):
    body = page.partition("\n")[2].replace(old, new)
    return f"# sha256 {sha256(body.encode()).hexdigest()}\n{body}".encode()


@pytest.mark.parametrize(
    ("about", "days", "said"),
    [
        (ABOUT._replace(car="car2"), 1.0, "is of car1, not of car2"),
        (ABOUT._replace(numbers="cd" * 32), 1.0, "the car file was edited since"),
        (ABOUT, -0.5, "is from the future"),
    ],
)
def test_a_page_of_another_car_an_edited_file_or_the_future_is_refused(page, about, days, said):
    kept = parse_kept(page.encode())
    with pytest.raises(KeptError, match=said) as refused:
        recall(kept, about, kept.written_ns + round(days * DAY_NS))
    assert "; " in str(refused.value), "what to try"


def test_a_page_is_recalled_with_its_age(page):
    kept = parse_kept(page.encode())
    other_run = ABOUT._replace(session="next.mcap", version="2.0")
    memory = read_memory(recall(kept, other_run, kept.written_ns + 3 * DAY_NS))
    assert memory.days == 3.0
    assert memory.values == kept.values
    early = read_memory(recall(kept, other_run, kept.written_ns - 1_000_000_000))
    assert early.days == 0.0, "a clock that was set back a little"


@pytest.mark.parametrize("text", ["{", "[]", '{"days": 1}', '{"days": 1, "values": {"a": [1]}}'])
def test_a_memory_that_is_none_is_refused(text):
    with pytest.raises(ValueError, match="unreadable"):
        read_memory(text)
    assert read_memory("") is None


def test_numbers_have_a_digest_and_comments_have_none():
    car = load_car(default_car_path())

    def of(text):
        return digest_numbers(parse_car(text, car.path), 4614.0, 0.0)

    same = of(car.text)
    assert of(car.text + "\n# a comment\n") == same
    heavier = car.text.replace(f"mass = {car.car.mass}", "mass = 4.5")
    assert heavier != car.text
    assert of(heavier) != same
    assert digest_numbers(car, 4000.0, 0.0) != same


def test_a_keeper_writes_at_once_each_minute_and_at_the_end(report):
    written = []
    keeper = Keeper(ABOUT, written.append, pytest.fail)
    keeper.take(replace(report, verdict="learning"))
    keeper.end()
    assert written == [], "a car that is not known yet says nothing new"
    for second in range(61):
        keeper.take(replace(report, mono_ns=report.mono_ns + second * 1_000_000_000))
    assert len(written) == 2
    assert EVERY_NS == 60_000_000_000
    keeper.end()
    assert len(written) == 2, "the last report is written already"
    keeper.take(replace(report, mono_ns=report.mono_ns + 62_000_000_000))
    keeper.end()
    assert len(written) == 3
    assert parse_kept(written[0].encode()).about == ABOUT


def test_a_page_that_cannot_be_written_is_said_once(report):
    said = []

    def write(text):
        raise PermissionError(13, "Permission denied")

    keeper = Keeper(ABOUT, write, said.append)
    for second in (0, 61, 122):
        keeper.take(replace(report, mono_ns=report.mono_ns + second * 1_000_000_000))
    keeper.end()
    assert len(said) == 1
    assert "Permission denied" in said[0]


def test_a_memory_is_json_of_days_and_values(page):
    kept = parse_kept(page.encode())
    memory = recall(kept, ABOUT, kept.written_ns)
    assert json.loads(memory) == {"days": 0.0, "values": {"steer_gain": [0.98, 0.012]}}
