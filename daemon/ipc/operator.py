"""An operator's side of the lease: requests with rising numbers under one id."""

import contextlib
from collections.abc import Mapping
from dataclasses import dataclass
from math import nan
from pathlib import Path

from steerd.daemon.common.errors import ExitCode, SteerdError
from steerd.daemon.ipc.requests import LIVE
from steerd.steer_bus import messages as m
from steerd.steer_bus.codec import CodecError, decode, encode
from steerd.steer_bus.lab import DEFAULT_PORT, Lab, load_lab
from steerd.steer_bus.topics import LAST_MODEL, BusError, make_key
from steerd.steer_bus.zenoh_bus import Profile, ZenohBus

DEFAULT_ENDPOINT = f"tcp/127.0.0.1:{DEFAULT_PORT}"

MODEL_WAIT_S = 0.5  # longest wait for the learner's newest report [s]
KEEPALIVE_NS = 50_000_000  # time between keepalives; the lease lasts 300 ms


@dataclass
class Operator:
    """One person at one terminal."""

    boot_id: int  # of the addressed run
    lease_id: int  # random, not zero
    name: str = "operator"  # for the recording
    seq: int = 0  # sequence number of the last request

    def make_request(self, kind: m.RequestKind, realtime_ns: int) -> bytes:
        """The next request, encoded."""
        return encode(m.OperatorRequest(*self._begin(realtime_ns), int(kind), self.name))

    def make_parameters(
        self, wanted: Mapping[str, float], realtime_ns: int, name: str = ""
    ) -> bytes:
        """The next request as one for other live parameters, encoded; what is not named stays.

        `wanted` has `speed` [m/s], `offset` [m], `gain`; `name` is who asks, where not the holder.
        """
        speed, offset, gain = (wanted.get(each, nan) for each in LIVE)
        start, who = self._begin(realtime_ns), name or self.name
        return encode(m.ParameterRequest(*start, speed, offset, gain, who))

    def _begin(self, realtime_ns: int) -> tuple[m.Header, int, int, int]:
        self.seq += 1
        return m.make_header(realtime_ns, m.BODY), self.boot_id, self.lease_id, self.seq


def connect(given_endpoint: str | None, folder: Path | None, first: str = "steerd run") -> ZenohBus:
    """Join the bus of a running daemon, which the command `first` starts; or SteerdError.

    Its endpoint is that of `folder` (of `steerd keys`) where none is given, else this machine's.
    """
    lab = read_lab(folder) if folder else None
    endpoint = given_endpoint or (lab.endpoint if lab else DEFAULT_ENDPOINT)
    try:
        return ZenohBus(Profile(False, endpoint, lab))
    except BusError as error:
        hint = f"start `{first}` first, or name its endpoint with --connect"
        if lab is not None:
            hint = f"is it up with --lab, and is {lab.folder} of the same lab and in date?"
        raise SteerdError(f"no steerd answers: {error}", hint, ExitCode.UNREACHABLE) from None


def read_lab(folder: Path) -> Lab:
    """A participant's folder; SteerdError if it is not one."""
    try:
        return load_lab(folder)
    except BusError as error:
        raise SteerdError(str(error), "", ExitCode.INVALID) from None


def read_model(bus: ZenohBus, car: str) -> m.Model | None:
    """The newest report of a car's learner; None without one, or one of another version."""
    for data in bus.query(make_key(car, LAST_MODEL), MODEL_WAIT_S).values():
        with contextlib.suppress(CodecError):
            return decode(m.Model, data)
    return None
