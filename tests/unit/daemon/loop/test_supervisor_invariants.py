"""`docs/reference/safety-requirements.md#invariants`, over every state and all guard bits."""

from itertools import combinations, pairwise
from math import inf, isfinite, nan

import pytest

from steerd.daemon.loop.supervisor import NEVER, Conditions, SupervisorState, derive, step
from steerd.daemon.loop.transitions import (
    ROWS,
    TABLE,
    Is,
    Motor,
    Request,
    State,
    choose,
    is_engaged,
)

T_NS, AGO_NS = 100 * 10**9, 50 * 10**9
REQUEST_BITS = {getattr(Is, r.name if r != Request.ESTOP else "CALL_ESTOP"): r for r in Request
                if r not in (Request.NONE, Request.KEEPALIVE)}  # fmt: skip
GIVEN = int(Is.GREEN_HELD) - 1
MOTION = (Motor.DRIVE, Motor.RAMP_STOP)


def used_bits(state):
    mask = int(Is.SLOWING)
    for row in ROWS[state]:
        mask |= row.needs | row.one_of | row.unless
    return [1 << k for k in range(27) if mask >> k & 1]


def every(bits):
    return (sum(chosen) for size in range(len(bits) + 1) for chosen in combinations(bits, size))


def realise(state, bits):
    """Return what makes ``derive`` say exactly ``bits``, or None if they contradict each other."""
    still, measured = bits & Is.STILL, bits & (Is.STILL | Is.MEASURED)
    facts = bits & GIVEN
    facts |= int(Is.GREEN) if bits & Is.GREEN_HELD else 0
    facts |= int(Is.FW_TIMEOUT) if bits & Is.PROVEN else 0
    if bits & Is.REARM:
        if bits & (Is.SOFT | Is.DISARM | Is.UNKNOWN):
            return None
        facts |= int(Is.LEASED)
    old = SupervisorState(
        state,
        T_NS - 10_000_000,
        AGO_NS if bits & Is.ELAPSED else T_NS - 10_000_000,
        "before",
        AGO_NS if still else NEVER,
        AGO_NS if bits & Is.GREEN_HELD else NEVER,
        AGO_NS if bits & Is.PROVEN else NEVER,
        1.0,
        bool(bits & Is.REARM),
        False,
        0,
    )
    speed = 0.0 if still else (2.0 if measured else nan)
    requests = sum(int(r) for fact, r in REQUEST_BITS.items() if bits & fact)
    return old, Conditions(facts, speed, 150_000_000, "W0 words"), requests


def cases(state):
    for bits in every(used_bits(state)):
        made = realise(state, bits)
        if made is not None:
            old, conditions, requests = made
            yield bits, old, conditions, requests, *step(old, conditions, requests, T_NS)


@pytest.fixture(scope="module", params=State, ids=lambda s: s.name)
def outcomes(request):
    return request.param, list(cases(request.param))


def test_cases_are_many_and_step_follows_the_table(outcomes):
    state, found = outcomes
    assert len(found) >= 32
    moved = 0
    for bits, old, conditions, requests, new, _ in found:
        derived = derive(old, conditions, requests, T_NS)
        assert derived & bits == bits
        row = choose(state, derived)
        assert new.state == (state if row is None else row.to)
        moved += new.state != state
    assert moved


def test_i1_motion_only_while_running_or_stopping(outcomes):
    for _, _, _, _, new, action in outcomes[1]:
        if action.motor in MOTION:
            assert new.state == (State.RUNNING, State.STOPPING)[MOTION.index(action.motor)]
        assert (new.state in (State.DISARMED, State.READY, State.SELF_TEST)) <= (action.motor == 0)


def test_i2_hard_fault_leaves_in_the_same_tick(outcomes):
    state, found = outcomes
    driven = state in (State.ARMED, State.RUNNING, State.STOPPING)
    for bits, _, _, _, new, action in found:
        if driven and bits & Is.HARD:
            assert new.state in (State.FAULT_STOP, State.ESTOP)
            assert action.motor in (Motor.BRAKE, Motor.DUTY_ZERO, Motor.ESTOP_BRAKE)
            assert (action.motor == Motor.DUTY_ZERO) == (not bits & Is.SLOWING)


def test_i3_no_way_from_a_fault_to_running_without_disarmed_arm_and_self_test():
    into = {state: {s for row in TABLE if row.to == state for s in row.sources} for state in State}
    assert into[State.RUNNING] == {State.ARMED}
    assert into[State.ARMED] == {State.SELF_TEST, State.STOPPING}
    assert into[State.STOPPING] == {State.RUNNING}
    assert into[State.SELF_TEST] == {State.READY}
    assert into[State.READY] == {State.DISARMED}
    for row in TABLE:
        assert row.to != State.RUNNING or row.needs & Is.START
        assert row.to != State.SELF_TEST or row.needs & Is.ARM
        assert row.to != State.ARMED or row.needs & (Is.PROVEN | Is.REARM)


def test_i4_emergency_stop_dominates(outcomes):
    for bits, _, _, _, new, action in outcomes[1]:
        if bits & (Is.CALL_ESTOP | Is.KILLED):
            assert new.state == State.ESTOP
            assert action.motor in (Motor.ESTOP_BRAKE, Motor.DUTY_ZERO, Motor.SILENT)
            if outcomes[0] != State.ESTOP:
                assert action.motor != Motor.SILENT


def test_i5_nothing_raises_the_speed_of_a_stop(outcomes):
    state, found = outcomes
    for _, old, _, _, new, action in found:
        if new.state == State.STOPPING:
            assert action.cap <= old.cap
            assert action.cap == pytest.approx(0.985) or state == State.RUNNING
        elif new.state != State.RUNNING:
            assert action.cap == 0.0


def test_i6_caps_are_speeds(outcomes):
    state, found = outcomes
    for _, _, conditions, _, new, action in found:
        launched = state == State.RUNNING and conditions.facts & Is.LAUNCHED
        assert action.cap >= 0.0
        assert isfinite(action.cap) or (new.state == State.RUNNING and launched)
        assert action.cap <= (inf if launched else 1.0)


def test_i7_nothing_but_an_operator_lifts_a_state(outcomes):
    state, found = outcomes
    asks = Is.ARM | Is.START | Is.CLEAR | Is.RESET
    latched = (State.FAULT_STOP, State.FAULT_LATCHED, State.ESTOP)
    for bits, _, _, _, new, _ in found:
        if bits & asks:
            continue
        assert new.state not in (State.SELF_TEST, State.RUNNING) or new.state == state
        assert state not in latched or new.state in latched
        if new.state == State.ARMED != state:
            assert state in (State.SELF_TEST, State.STOPPING)


def test_i8_an_unknown_event_is_a_stop(outcomes):
    for bits, old, conditions, requests, new, action in outcomes[1]:
        if bits & Is.UNKNOWN:
            assert new.state not in (State.SELF_TEST, State.ARMED, State.RUNNING)
            assert action.motor != Motor.DRIVE
            alien = (requests & ~int(Request.UNKNOWN)) | 1 << 40
            assert step(old, conditions, alien, T_NS) == (new, action)


def test_every_row_of_the_table_can_fire():
    fired = set()
    for state in State:
        for bits in every(used_bits(state)):
            row = choose(state, bits)
            if row is not None and row.to != state:
                fired.add(row)
    assert fired == set(TABLE)


def test_requests_and_facts_line_up():
    shift = int(Is.ARM) // int(Request.ARM)
    assert all(int(fact) == int(asked) * shift for fact, asked in REQUEST_BITS.items())
    assert len(REQUEST_BITS) == 9
    values = sorted(int(fact) for fact in Is)
    assert all(b == 2 * a for a, b in pairwise(values))
    assert len(values) == 27


def test_guardian_is_engaged_exactly_where_motor_bytes_flow():
    engaged = (State.ARMED, State.RUNNING, State.STOPPING, State.FAULT_STOP, State.ESTOP)
    assert tuple(state for state in State if is_engaged(state)) == engaged


def test_derived_facts_cannot_be_given_and_every_unknown_bit_is_unknown():
    old = realise(State.ARMED, 0)[0]
    everything = Conditions((1 << 40) - 1, nan, 0)
    assert derive(old, everything, 0, T_NS) == GIVEN
    for bit in (*range(10, 14), 31, 63):
        assert derive(old, everything._replace(facts=0), 1 << bit, T_NS) == Is.UNKNOWN
    assert derive(old, everything._replace(facts=0), Request.KEEPALIVE, T_NS) == 0
