"""The findings of `steerd probe` as text of at most 80 columns."""

from collections.abc import Iterator, Sequence
from math import degrees

from steerd.daemon.common.screen import clean, join_words, wrap
from steerd.daemon.setup.probe import (
    UDEV_NAME,
    VESC_USB,
    Advice,
    MocapSeen,
    SerialFound,
    SocketFound,
    VescFound,
)

NAME_MAX = 40
"""Characters of a body's name that are shown."""
ADVICE_MAX = 500
"""Characters of a finding that are shown."""


def format_serial(found: Sequence[SerialFound], may_open: bool) -> Iterator[str]:
    """Serial ports, and how to get the udev rule where a VESC is or could be."""
    yield "serial ports"
    if not found:
        yield "  none: is the VESC powered, and its USB cable one that carries data?"
    for port in found:
        yield f"  {port.port}{f'  (USB {port.usb})' if port.usb else ''}"
        if port.vesc is not None:
            yield from _vesc(port.vesc)
        yield from _advice(port.advice)
    if not may_open:
        yield "  ! you are not in the group dialout"
        yield "    try: sudo usermod -aG dialout $USER, then log out and in again"
    if any(port.vesc or port.usb == VESC_USB for port in found):
        yield "  for the name /dev/vesc, and to keep ModemManager away from it:"
        yield f"    steerd service udev | sudo tee {UDEV_NAME}"


def _vesc(v: VescFound) -> Iterator[str]:
    yield f"    VESC {clean(v.hardware, 30)}, firmware {v.firmware[0]}.{v.firmware[1]:02d}"
    yield f"    UUID      {v.uuid or 'unknown'}   (car file: [vesc] uuid)"
    never = "never" if v.timeout_ms == 0 else f"{v.timeout_ms} ms"
    if v.timeout_ms is not None:
        yield f"    timeout   {never}, then {v.timeout_brake_a:g} A brake current"
    electrics = [f"{v.voltage:.1f} V"] if v.voltage is not None else []
    electrics += [f"{v.temp_fet_c:.0f} °C"] if v.temp_fet_c is not None else []
    electrics += ["IMU answers" if v.imu else "no IMU"]
    yield from _item("state", f"{', '.join(electrics)}, fault: {v.fault or 'none'}")
    if v.round_trip_ms is not None:
        yield f"    answers   {v.answered:.0%}, after {v.round_trip_ms:.1f} ms"


def format_mocap(found: Sequence[tuple[MocapSeen, tuple[Advice, ...]]]) -> Iterator[str]:
    """Mocap servers."""
    yield "motion capture"
    if not found:
        yield "  no NatNet server answered a discovery on this network"
        yield "    try: steerd probe --mocap natnet://HOST/BODY (or vrpn://HOST/BODY)"
    for seen, advice in found:
        yield f"  {clean(seen.address)}"
        if seen.server:
            yield from _item("server", clean(seen.server))
        if seen.bodies:
            names = (join_words(clean(body, NAME_MAX)) for body in seen.bodies)
            yield from _item("bodies", ", ".join(names))
        yield from _poses(seen)
        yield from _advice(advice)


def _poses(seen: MocapSeen) -> Iterator[str]:
    if seen.samples:
        of = f" of {seen.expected_rate_hz:.0f}" if seen.expected_rate_hz else ""
        yield (
            f"    poses     {seen.rate_hz:.0f}{of} Hz, {seen.accepted} of {seen.samples} accepted"
        )
    if seen.latency_ms is not None:
        sigma = "" if seen.clock_sigma_ms is None else f" ± {seen.clock_sigma_ms:.2f} ms"
        figures = (
            f"clock: {seen.clock}{sigma}",
            f"age on arrival: {seen.latency_ms:.1f} ms",
            f"jitter: {seen.jitter_ms:.1f} ms",
        )
        yield from _item("time", ", ".join(map(join_words, figures)))
    if seen.height is not None and seen.tilt is not None:
        yield f"    body      {seen.height:.3f} m high, tilted by {degrees(seen.tilt):.1f}°"


def format_sockets(found: Sequence[SocketFound]) -> Iterator[str]:
    """Ports in use."""
    yield "open sockets"
    if not found:
        yield "  none of zenoh, NatNet and VRPN: nothing is in the way"
    for item in found:
        yield f"  {item.kind} {item.address}:{item.port}  {item.meaning}"


def _item(label: str, text: str) -> list[str]:
    return wrap(text, f"    {label:<10}", " " * 14)


def _advice(advice: Sequence[Advice]) -> Iterator[str]:
    for item in advice:
        yield from wrap(clean(item.what, ADVICE_MAX), "    ! ", "      ")
        for i, line in enumerate(item.fix.splitlines()):
            head = "      try: " if i == 0 else "        "
            # An indented line is to be copied and stays as it is.
            yield from [head + line] if line.startswith(" ") else wrap(line, head, " " * 11)
