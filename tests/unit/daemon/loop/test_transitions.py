"""`docs/reference/safety-requirements.md#invariants`, over every state and all guard bits."""

from itertools import combinations, pairwise
from math import inf, isfinite, nan

import pytest

from steerd.daemon.loop import supervisor as sv
from steerd.daemon.loop import transitions as tr
from steerd.daemon.loop.supervisor import NEVER, derive_facts, step_supervisor
from steerd.steer_bus.quick_values import changed

S, M, Fact = tr.SupervisorState, tr.MotorOutput, tr.Fact
DRIVEN = (S.ARMED, S.RUNNING, S.STOPPING)
T_NS, AGO_NS = 100 * 10**9, 50 * 10**9
GIVEN = int(Fact.CHECKS_HELD) - 1
MOTION = (M.DRIVE, M.RAMP_STOP)


def used_bits(state):
    mask = int(Fact.SLOWING)
    for row in tr.ROWS[state]:
        mask |= row.needs | row.one_of | row.unless
    return [1 << k for k in range(27) if mask >> k & 1]


def every(bits):
    return (sum(chosen) for size in range(len(bits) + 1) for chosen in combinations(bits, size))


def realise(state, bits):
    """Inputs for which ``derive_facts`` gives exactly ``bits``, or None if there are none."""
    still, measured = bits & Fact.STILL, bits & (Fact.STILL | Fact.MEASURED)
    facts = bits & GIVEN
    facts |= int(Fact.CHECKS_PASS) if bits & Fact.CHECKS_HELD else 0
    facts |= int(Fact.FW_TIMEOUT) if bits & Fact.PROVEN else 0
    if bits & Fact.REARM:
        if bits & (Fact.SOFT | Fact.DISARM | Fact.UNKNOWN):
            return None
        facts |= int(Fact.LEASED)
    before_ns = T_NS - 10_000_000
    since_ns = AGO_NS if bits & Fact.ELAPSED else before_ns
    timers = (
        AGO_NS if bits & bit else NEVER for bit in (Fact.STILL, Fact.CHECKS_HELD, Fact.PROVEN)
    )
    rearm = bool(bits & Fact.REARM)
    old = sv.SupervisorMemory(state, before_ns, since_ns, "before", *timers, 1.0, rearm, False, 0)
    speed = 0.0 if still else (2.0 if measured else nan)
    return old, sv.Conditions(facts, speed, 150_000_000, "W0 words"), bits & tr.ASKED


def cases(state):
    for bits in every(used_bits(state)):
        made = realise(state, bits)
        if made is not None:
            old, conditions, requests = made
            yield bits, old, conditions, requests, *step_supervisor(old, conditions, requests, T_NS)


@pytest.fixture(scope="module", params=S, ids=lambda s: s.name)
def outcomes(request):
    return request.param, list(cases(request.param))


def test_cases_are_many_and_step_follows_the_table(outcomes):
    state, found = outcomes
    assert len(found) >= 16
    moved = 0
    for bits, old, conditions, requests, new, _ in found:
        derived = derive_facts(old, conditions, requests, T_NS)
        assert derived & bits == bits
        row = tr.choose_row(state, derived)
        assert new.state == (state if row is None else row.to)
        moved += new.state != state
    assert moved


def test_i1_motion_only_while_running_or_stopping(outcomes):
    for _, _, _, _, new, action in outcomes[1]:
        if action.motor in MOTION:
            assert new.state == (S.RUNNING, S.STOPPING)[MOTION.index(action.motor)]
        assert (new.state in (S.DISARMED, S.READY, S.SELF_TEST)) <= (action.motor == 0)


def test_i2_hard_fault_leaves_in_the_same_tick(outcomes):
    state, found = outcomes
    for bits, _, _, _, new, action in found:
        if state in DRIVEN and bits & Fact.HARD:
            assert new.state in (S.FAULT_STOP, S.ESTOP)
            assert action.motor in (M.BRAKE, M.DUTY_ZERO, M.ESTOP_BRAKE)
            assert (action.motor == M.DUTY_ZERO) == (not bits & Fact.SLOWING)


def test_i3_no_way_from_a_fault_to_running_without_disarmed_arm_and_self_test():
    into = {to: {s for row in tr.TABLE if row.to == to for s in row.sources} for to in S}
    assert into[S.RUNNING] == {S.ARMED}
    assert into[S.ARMED] == {S.SELF_TEST, S.STOPPING}
    assert into[S.STOPPING] == {S.RUNNING}
    assert into[S.SELF_TEST] == {S.READY}
    assert into[S.READY] == {S.DISARMED}
    for row in tr.TABLE:
        assert row.to != S.RUNNING or row.needs & Fact.START
        assert row.to != S.SELF_TEST or row.needs & Fact.ARM
        assert row.to != S.ARMED or row.needs & (Fact.PROVEN | Fact.REARM)


def test_i4_emergency_stop_dominates(outcomes):
    for bits, _, _, _, new, action in outcomes[1]:
        if bits & (Fact.CALL_ESTOP | Fact.KILLED):
            assert new.state == S.ESTOP
            assert action.motor in (M.ESTOP_BRAKE, M.DUTY_ZERO, M.SILENT)
            if outcomes[0] != S.ESTOP:
                assert action.motor != M.SILENT


def test_i5_nothing_raises_the_speed_of_a_stop(outcomes):
    state, found = outcomes
    for _, old, _, _, new, action in found:
        if new.state == S.STOPPING:
            assert action.cap <= old.cap
            assert action.cap == pytest.approx(0.985) or state == S.RUNNING
        elif new.state != S.RUNNING:
            assert action.cap == 0.0


def test_i6_caps_are_speeds(outcomes):
    state, found = outcomes
    for _, _, conditions, _, new, action in found:
        launched = state == S.RUNNING and conditions.facts & Fact.LAUNCHED
        assert action.cap >= 0.0
        assert isfinite(action.cap) or (new.state == S.RUNNING and launched)
        assert action.cap <= (inf if launched else 1.0)


def test_i7_nothing_but_an_operator_lifts_a_state(outcomes):
    state, found = outcomes
    asks = Fact.ARM | Fact.START | Fact.CLEAR | Fact.RESET
    latched = (S.FAULT_STOP, S.FAULT_LATCHED, S.ESTOP)
    for bits, _, _, _, new, _ in found:
        if bits & asks:
            continue
        assert new.state not in (S.SELF_TEST, S.RUNNING) or new.state == state
        assert state not in latched or new.state in latched
        if new.state == S.ARMED != state:
            assert state in (S.SELF_TEST, S.STOPPING)


def test_i8_an_unknown_event_is_a_stop(outcomes):
    for bits, old, conditions, requests, new, action in outcomes[1]:
        if bits & Fact.UNKNOWN:
            assert new.state not in (S.SELF_TEST, S.ARMED, S.RUNNING)
            assert action.motor != M.DRIVE
            alien = (requests & ~Fact.UNKNOWN) | 1 << 40
            assert step_supervisor(old, conditions, alien, T_NS) == (new, action)


def test_every_row_of_the_table_can_fire():
    rows = ((state, tr.choose_row(state, bits)) for state in S for bits in every(used_bits(state)))
    assert {row for state, row in rows if row and row.to != state} == set(tr.TABLE)


def test_every_fact_is_one_bit_and_the_last_nine_are_requests():
    values = sorted(bit for name, bit in vars(Fact).items() if name.isupper())
    assert all(b == 2 * a for a, b in pairwise(values))
    assert len(values) == 27
    assert sum(values[-9:]) == tr.ASKED


def test_guardian_is_engaged_exactly_where_motor_bytes_flow():
    engaged = (S.ARMED, S.RUNNING, S.STOPPING, S.FAULT_STOP, S.ESTOP)
    assert tuple(state for state in S if state.engaged) == engaged


def test_derived_facts_cannot_be_given_and_every_unknown_bit_is_unknown():
    old = realise(S.ARMED, 0)[0]
    everything = sv.Conditions((1 << 40) - 1, nan, 0)
    assert derive_facts(old, everything, 0, T_NS) == GIVEN
    for bit in (*range(18), 27, 31, 63):
        assert derive_facts(old, changed(everything, facts=0), 1 << bit, T_NS) == Fact.UNKNOWN
