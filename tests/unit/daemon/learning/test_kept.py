"""What was learnt: the page beside the car file, a screen, programs, and what is proposed of it."""

import json
import os
import shutil
import tomllib
from dataclasses import replace
from hashlib import sha256
from math import nan
from pathlib import Path
from unittest.mock import Mock

import pytest

from steerd.car_model.car_file import default_car_path, load_car, parse_car
from steerd.daemon.assembly.build import make_plan
from steerd.daemon.ipc.pipe_records import PipeReader, PipeRecord, make_pipe, pack_record
from steerd.daemon.learning import feed, kept, reported
from steerd.daemon.learning.feed import PAUSE_NS, Proposals, Wiring, make_model, read_memory
from steerd.daemon.learning.kept import DAY_NS, About, Keeper, KeptError, format_kept, parse_kept
from steerd.daemon.learning.reported import ReportedChange, ReportedValue, gap_text, pack
from steerd.daemon.loop.adapting import REFUSED, make_design, make_no_design, read_design
from steerd.daemon.process.bus_operator import read_model
from steerd.daemon.process.gateway import Gateway, run_gateway
from steerd.daemon.settings.run_options import RunOptions
from steerd.daemon.terminal.dashboard import Dashboard
from steerd.sim_gap.online.learner import State
from steerd.sim_gap.online.samples import Ordered, Paused, PoseSeen, Rolled
from steerd.steer_bus import messages as m
from steerd.steer_bus import topics
from steerd.steer_bus.codec import decode, encode
from steerd.steer_bus.topics import LAST_MODEL, make_key
from steerd.vesc_link.scaling import Scaling
from tests.blank import blank
from tests.designs import numbers, standard
from tests.local_bus import LocalBus, LocalHub
from tests.unit.daemon.terminal.test_terminal import printed

NOON = 1_763_812_800_000_000_000
"""12:00:00 UTC of a day, in UNIX time [ns]; the monotonic clock then read 100 s."""
MONO = 100_000_000_000
ABOUT = About("car1", "ab" * 32, "1.0", 'a "wet" one.mcap')


def make_change(verdict="named", alternatives=()):
    """A change 40 s before noon; a named one is a steering bias."""
    since, noticed = MONO - 40_000_000_000, MONO - 39_000_000_000
    if verdict != "named":
        return ReportedChange(since, noticed, verdict)
    bias = ReportedValue("bias", 0.0213, 0.0021, "rad")
    return ReportedChange(since, noticed, verdict, "steer_bias", 0.97, alternatives, (bias,))


def make_report(verdict="none", *changes):
    """A report at noon of a car without changes, or with these."""
    values = [
        ReportedValue("steer_gain", 0.98, 0.012, "1", True),
        ReportedValue("inertia_z", 0.046, nan, "kg m^2", False),
    ]
    model = make_model(State(seen=120), MONO, NOON - MONO, 3, {})
    return replace(model, verdict=verdict, details=pack(values, list(changes)))


report = pytest.fixture(lambda: make_report("named", make_change()))
page = pytest.fixture(lambda report: format_kept(ABOUT, report))


def test_a_page_comes_back_as_it_was(page, report):
    found = parse_kept(page.encode())
    assert (found.about, found.written_ns) == (ABOUT, m.stamp_ns(report.header))
    assert found.values == {"steer_gain": (0.98, 0.012)}, "only what is identifiable"
    (change,) = tomllib.loads(page)["changes"]
    assert change == "since 11:59:20: steer_bias +0.0213 ± 0.0021 rad, 97 %"


def test_a_page_that_is_torn_or_changed_at_any_byte_or_has_other_keys_is_refused(page):
    data = page.encode()
    for place in range(len(data)):
        for bad in (data[:place], data[:place] + bytes([data[place] ^ 1]) + data[place + 1 :]):
            with pytest.raises(KeptError):
                parse_kept(bad)
    body = page.partition("\n")[2].replace("[values]", "[numbers]").encode()
    with pytest.raises(KeptError, match="not what steerd writes"):
        parse_kept(f"# sha256 {sha256(body).hexdigest()}\n".encode() + body)


@pytest.mark.parametrize(("about", "days", "said"), [
    (ABOUT._replace(car="car2"), 1.0, "is of car1, not of car2"),
    (ABOUT._replace(numbers="cd" * 32), 1.0, "the car file was edited since"),
    (ABOUT, -0.5, "is from the future"),
])  # fmt: skip
def test_a_page_of_another_car_an_edited_file_or_the_future_is_refused(page, about, days, said):
    found = parse_kept(page.encode())
    with pytest.raises(KeptError, match=said) as refused:
        kept.recall(found, about, found.written_ns + round(days * DAY_NS))
    assert "; " in str(refused.value), "what to try"


def test_a_page_is_recalled_with_its_age(page):
    found = parse_kept(page.encode())
    other_run = ABOUT._replace(session="next.mcap", version="2.0")
    memory = read_memory(kept.recall(found, other_run, found.written_ns + 3 * DAY_NS))
    assert (memory.days, memory.values) == (3.0, found.values)
    early = read_memory(kept.recall(found, other_run, found.written_ns - 1_000_000_000))
    assert early.days == 0.0, "a clock that was set back a little"


@pytest.mark.parametrize("text", ["{", "[]", '{"days": 1}', '{"days": 1, "values": {"a": [1]}}'])
def test_a_memory_that_is_none_is_refused(text):
    with pytest.raises(ValueError, match="unreadable"):
        read_memory(text)
    assert read_memory("") is None


def test_numbers_have_a_digest_and_comments_have_none():
    car = load_car(default_car_path())

    def digest(text, **scaling):
        return kept.digest_numbers(parse_car(text, car.path), Scaling(**scaling))

    same = digest(car.text)
    assert digest(car.text + "\n# a comment\n") == same
    assert digest(car.text.replace(f"mass = {car.car.mass}", "mass = 4.5")) != same
    assert digest(car.text, erpm_gain=4000.0) != same


def test_a_keeper_writes_at_once_each_minute_and_at_the_end(report, tmp_path):
    keeper = Keeper(tmp_path / "page.toml", ABOUT)

    def written(*seconds, **changes):
        """Whether reports of these seconds, and then the end where there are none, write a page."""
        for second in seconds:
            mono_ns = report.mono_ns + second * 1_000_000_000
            keeper.take(replace(report, mono_ns=mono_ns, **changes))
        if not seconds:
            keeper.end()
        there = keeper.page.exists()
        keeper.page.unlink(missing_ok=True)
        return there

    assert not written(0, verdict="learning")
    assert not written(), "a car that is not known yet says nothing new"
    assert written(0)
    assert not written(*range(1, 60))
    assert kept.EVERY_NS == 60_000_000_000
    assert written(60)
    assert not written(), "the last report is written already"
    assert not written(62)
    assert written()


def test_a_page_that_cannot_be_written_is_said_once(report, tmp_path, capsys):
    (tmp_path / "file").write_text("")
    keeper = Keeper(tmp_path / "file" / "page.toml", ABOUT)
    for second in (0, 61, 122):
        keeper.take(replace(report, mono_ns=report.mono_ns + second * 1_000_000_000))
    keeper.end()
    (said,) = capsys.readouterr().err.splitlines()
    assert "File exists" in said


# What a run's learner begins with: the page beside its car file, if it is this car's.
@pytest.fixture
def plan(tmp_path):
    """A run on a car, its file in a folder of its own."""
    path = shutil.copy(default_car_path(), tmp_path / "car.toml")
    return make_plan(RunOptions(car_file=str(path), port="/dev/null", learn=True))


def recalled(plan, now_ns):
    return kept.recall_learnt(plan, plan.settings.file.path.with_name("next.mcap"), now_ns)


def keep(plan, report):
    """A drive's page, written as the learner process writes it."""
    memory = recalled(plan, m.stamp_ns(report.header))
    Keeper(Path(memory.page), memory.about, memory.refused).take(report)
    return memory


def test_what_one_run_keeps_the_next_begins_with(plan, report, capsys):
    first = keep(plan, report)
    assert (first.memory, dict(first.metadata), first.refused) == ("", {}, False)
    page = plan.settings.file.path.with_name("car.learnt.toml")
    assert first.page == str(page)
    assert page.read_text() == format_kept(first.about, report), "with the drive's time"
    second = recalled(plan, m.stamp_ns(report.header) + 2 * DAY_NS)
    about = second.metadata[kept.METADATA]
    assert (about["memory"], about["file"]) == (second.memory, "car.learnt.toml")
    assert capsys.readouterr().err == ""
    memory = read_memory(json.loads(json.dumps(second._asdict()))["memory"])
    assert (memory.days, memory.values) == (2.0, {"steer_gain": (0.98, 0.012)})
    made = feed.make_feed(plan.settings.file, Wiring(0, plan.settings.scaling), memory)
    assert [*made.learner.remembered] == ["steer_gain"]
    assert plan.settings.file.path.read_text() == default_car_path().read_text()


def test_the_car_that_steerd_brings_is_kept_in_the_data_folder(plan, tmp_path, monkeypatch):
    monkeypatch.setenv("STATE_DIRECTORY", str(tmp_path / "state"))
    own = make_plan(replace(plan.options, car_file=""))
    assert kept.learnt_page(own) == tmp_path / "state" / "car1.learnt.toml"


@pytest.mark.parametrize("change", [{"learn": False}, {"simulated": True}])
def test_simulated_hardware_and_a_run_without_a_learner_keep_nothing(plan, report, change):
    keep(plan, report)
    other = make_plan(replace(plan.options, **change))
    memory = recalled(other, m.stamp_ns(report.header))
    assert (memory.page, memory.memory) == ("", "")


def test_an_edited_car_file_begins_anew_and_nothing_is_lost(plan, report, capsys):
    keep(plan, report)
    page, path = kept.learnt_page(plan), plan.settings.file.path
    old, mass = page.read_text(), plan.settings.file.car.mass
    path.write_text(path.read_text().replace(f"mass = {mass}", "mass = 4.5"))
    edited = make_plan(plan.options)
    memory = keep(edited, report)
    assert (memory.refused, memory.memory) == (True, "")
    said = capsys.readouterr().err
    assert "the car file was edited since" in said
    assert said.count("\n") == 1
    (aside,) = set(page.parent.glob("car.learnt.*.toml")) - {page}
    assert aside.read_text() == old
    assert recalled(edited, m.stamp_ns(report.header)).memory != ""


@pytest.mark.parametrize("said", ["car.learnt.toml is torn or was edited", "cannot be read"])
def test_a_page_that_is_torn_or_cannot_be_read_is_named_and_left_out(plan, report, capsys, said):
    page = kept.learnt_page(plan)
    if "torn" in said:
        keep(plan, report)
        page.write_bytes(page.read_bytes()[:-1])
    else:
        page.mkdir()
    memory = recalled(plan, m.stamp_ns(report.header))
    assert (memory.memory, memory.refused) == ("", True)
    assert said in capsys.readouterr().err


# What was learnt, on a screen and for programs.
@pytest.mark.parametrize(("verdict", "words"), [
    ("named", "since 11:59:20: steer_bias +0.0213 ± 0.0021 rad, 97 %"),
    ("changed", "since 11:59:20: something changed, too early to say what"),
    ("unexplained", "since 11:59:20: something changed that no effect explains"),
    ("none", "no change of the car"), ("learning", "learning the car"),
])  # fmt: skip
def test_a_change_is_told_with_its_time_and_odds(verdict, words):
    changes = () if verdict in ("none", "learning") else (make_change(verdict),)
    assert gap_text(make_report(verdict, *changes)).replace("\u00a0", " ") == words


def test_the_screen_fits_80_columns_and_hides_what_is_not_identifiable():
    change = make_change(alternatives=("steer_gain", "mocap_yaw", "cornering_stiffness"))
    report = make_report("named", change)
    said = "; this drive cannot distinguish it from steer_gain, mocap_yaw, cornering_stiffness"
    assert gap_text(report).endswith(said)
    lines = reported.format_model(report)
    assert max(map(len, lines)) <= 80
    assert "  steer_gain  0.980 ± 0.012" in lines
    assert "not identifiable here: inertia_z" in lines


def test_json_has_the_gap_and_the_model():
    report = make_report("named", make_change(alternatives=("mocap_yaw",)))
    values = json.loads(json.dumps(reported.encode_model(report), allow_nan=False))
    gap = values["gap"]
    assert gap["verdict"] == "named"
    assert gap["since_s"] == pytest.approx(m.stamp_ns(report.header) * 1e-9 - 40.0)
    (cause,) = gap["causes"]
    assert (cause["effect"], cause["alternatives"]) == ("steer_bias", ["mocap_yaw"])
    assert cause["parameters"]["bias"]["value"] == pytest.approx(0.0213)
    gain, inertia = values["model"]["steer_gain"], values["model"]["inertia_z"]
    assert gain == {"value": 0.98, "sd": 0.012, "unit": "1", "identifiable": True}
    assert inertia == {"value": 0.046, "sd": None, "unit": "kg m^2", "identifiable": False}
    unnamed = reported.encode_model(make_report("changed", make_change("changed")))
    assert json.loads(json.dumps(unnamed, allow_nan=False))["gap"]["causes"] == []


@pytest.mark.parametrize(("value", "sd", "shown"), [
    (0.02134, 0.0021, "0.0213 ± 0.0021 rad"), (12.3, 4.2, "12.3 ± 4.2 rad"),
    (123.4, 42.0, "123 ± 42 rad"), (0.5, float("nan"), "0.5 rad"),
])  # fmt: skip
def test_numbers_have_the_digits_of_their_error(value, sd, shown):
    text = reported.with_sd(ReportedValue("bias", value, sd, "rad"))
    assert text.replace("\u00a0", " ") == shown


# Where people look: the dashboard, `steerd status`, and what the gateway answers.
def record(report):
    return PipeRecord(topics.MODEL, 0, 1, 1, encode(report))


def test_the_dashboard_says_what_is_learnt_and_a_change_once():
    board = Dashboard("car1")
    assert "gap" not in printed(board.render())
    assert board.take(record(make_report("none"))) is None
    assert "no change of the car" in printed(board.render())
    line = board.take(record(make_report("changed", make_change("changed"))))
    assert line.startswith("GAP")
    assert "something changed" in line
    assert board.take(record(make_report("changed", make_change("changed")))) is None
    named = board.take(record(make_report("named", make_change())))
    assert "steer_bias +0.0213 ± 0.0021 rad, 97 %" in named
    assert list(board.events) == [line, named]


def test_the_gateway_publishes_reports_and_answers_with_the_last(pipe, ends):
    hub, (read_fd, write_fd) = LocalHub(), pipe
    listener, gateway = LocalBus(hub), Gateway(LocalBus(hub), "car1", None)
    heard = listener.subscribe(make_key("car1", topics.MODEL), 8)
    assert read_model(listener, "car1") is None
    LocalBus(hub).serve(make_key("car2", LAST_MODEL), lambda _: b"\0\1\0\0short")
    assert read_model(listener, "car2") is None, "of another version"
    report_fd, report_end = make_pipe()
    report = make_report("none")
    os.write(report_end, pack_record(feed.make_record(report, 0, 1)))
    os.write(write_fd, b"\0")  # wakes it; no whole record
    os.close(report_end)
    os.close(write_fd)
    run_gateway(gateway, PipeReader(read_fd), ends[0], PipeReader(report_fd))
    assert [sample.data for sample in heard.poll()] == [encode(report)]
    last = read_model(listener, "car1")
    assert encode(last) == encode(report)


# The learner's proposals: by steps, from where the core is, and none in doubt.
S = 1_000_000_000


class Proposer(Proposals):
    """Proposals towards `aim`, which a test sets, decoded as they go out."""

    def __init__(self):
        self.held, self.sent, self.aim = standard(), [], "the car is being learnt"
        super().__init__(self.held, lambda *sent: self.sent.append(sent))

    def say(self, t_ns):
        self.propose(None, None, t_ns, 0)
        data, sent_ns = self.sent[-1]
        assert sent_ns == t_ns
        return decode(m.Design, data)


@pytest.fixture
def at(monkeypatch):
    """Whose designs are only counted."""
    monkeypatch.setattr(feed, "design_table", Mock(return_value=standard().file.table))
    made = Proposer()
    monkeypatch.setattr(feed, "find_aim", lambda learner, state: made.aim)
    return made


def test_in_doubt_or_for_the_car_of_the_file_the_reason_is_proposed(at):
    said = at.say(5 * S)
    assert (said.number, said.text, said.mono_ns) == (0, "the car is being learnt", 5 * S)
    at.aim = numbers(at.held)
    said = at.say(6 * S)
    assert (said.number, said.text) == (0, "the car is as in the car file")


def test_the_learnt_car_is_reached_by_steps_that_the_core_took(at):
    at.aim = numbers(at.held, steer_gain=0.88)
    unanswered = [at.say(k * S).steer_gain for k in range(4)]
    assert unanswered == pytest.approx([0.97] * 4)
    seen = []
    for k in range(4, 12):
        said = at.say(k * S)
        seen.append(said.steer_gain)
        at.hear(make_design(k * S, 0, k + 1, read_design(said)))
    assert seen == pytest.approx([0.97, 0.94, 0.91, 0.88, 0.88, 0.88, 0.88, 0.88])
    assert feed.design_table.call_count == 4, "what stays is not designed again"


def test_after_a_refusal_it_pauses_and_begins_at_the_files(at):
    at.aim = numbers(at.held, steer_gain=0.88)
    at.hear(make_design(S, 0, 1, read_design(at.say(S))))
    at.hear(make_no_design(2 * S, 0, REFUSED + "a gain is absurd"))
    said = at.say(3 * S)
    assert (said.number, said.text) == (0, "a design was refused")
    assert at.say(2 * S + PAUSE_NS).steer_gain == pytest.approx(0.97)


# Messages of a drive as samples of the learner.
EPOCH = 1_700_000_000_000_000_000
WIRING = Wiring(EPOCH, Scaling(4000.0, 100.0))
POSE = {"t_valid_ns": 2 * S, "x": 1.0, "y": 2.0, "yaw": 0.3}
OTHER_ORDERS = [mode for mode in m.ActuationMode if mode != m.ActuationMode.SPEED]
TOLD = {"t_sent_ns": S, "t_received_ns": S + 2_000_000, "erpm": 6100}


def at_s(seconds, cls, **values):
    """A message with a header of so long after the session's zero."""
    return blank(cls, **{"header": m.make_header(EPOCH + seconds * S, m.BODY), **values})


def actuation(mode):
    return at_s(3, m.Actuation, mode=mode, steer=0.1, speed=1.5)


@pytest.mark.parametrize(("topic", "message", "sample"), [
    (topics.MOCAP, at_s(2, m.MocapPose, **POSE), PoseSeen(2.0, 1.0, 2.0, 0.3)),
    (topics.MOCAP, at_s(2, m.MocapPose, **POSE, reject="jump"), None),
    (topics.ACTUATION, actuation(m.ActuationMode.SPEED), Ordered(3.0, 0.1, 1.5)),
    *((topics.ACTUATION, actuation(mode), Paused(3.0)) for mode in OTHER_ORDERS),
    (topics.VESC, at_s(1, m.VescTelemetry, **TOLD), Rolled(pytest.approx(1.001), 1.5)),
    (topics.WHEEL, at_s(4, m.WheelSpeed, t_ns=4 * S, speed=1.25), Rolled(4.0, 1.25)),
])  # fmt: skip
def test_a_message_counts_when_it_was_valid_in_the_sessions_own_scaling(topic, message, sample):
    assert feed.make_sample(WIRING, topic, message) == sample
