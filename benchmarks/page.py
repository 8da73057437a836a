"""docs/results/performance.md from what the pieces of `make bench` said."""

from collections.abc import Sequence
from math import isnan
from typing import Any

MISSING = "*Not measured: {0}.*\n"


def table(head: Sequence[str], rows: Sequence[Sequence[object]]) -> str:
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join("| " + " | ".join(str(cell) for cell in line) + " |" for line in lines) + "\n"


def number(value: float | None) -> str:
    """Three figures that count."""
    if value is None or isnan(value):
        return "—"
    return f"{value:,.0f}" if abs(value) >= 100 else f"{value:.3g}"


def spread(found: dict[str, float]) -> str:
    """Median, and the middle of the repetitions."""
    return f"{number(found['median'])} ({number(found['low'])}..{number(found['high'])})"


def times(part: float, whole: float) -> str:
    return f"{number(part / whole)} ×"


def simulation(said: dict[str, Any]) -> str:
    ms = said["ms"]
    base = ms.get("plain C loop", ms["bare kernel"])["median"]
    other = "plain C loop" if "plain C loop" in ms else "bare kernel"
    rows = [[name, spread(ms[name]), times(ms[name]["median"], base)] for name in ms]
    return (
        "Value and gradient of 16 runs × 4000 RK4 steps: CPU time on one thread, the last row wall "
        "time on all cores. The torch reference is timed over 200 steps and the scalar loop over "
        f"20 of one run. Largest relative difference: {said['apart']:.1e}.\n\n"
        + table(["", "ms, median (10..90 %)", f"of the {other}"], rows)
        + "\n![growth by runs, steps and parameters](performance-growth.svg)\n"
    )


def identify(said: dict[str, Any]) -> str:
    methods = said["methods"]
    ours = methods["ours"]["all_s"]
    rows = [
        [name, number(m["iterations"]), number(m["s"]), number(m["all_s"]), times(m["all_s"], ours),
         number(m["final_mm"]), number(m["slalom_mm"])] for name, m in methods.items()
    ]  # fmt: skip
    head = [
        "",
        f"iterations to {said['target_mm']:g} mm",
        "s to it",
        "s in all",
        "of ours",
        "end, mm",
        "end on slaloms, mm",
    ]
    return (
        "One start of the [race](identification.md) on the paper's circles, CPU seconds; the time "
        "of `ours` includes standard errors.\n\n" + table(head, rows)
    )


def diagnosis(said: dict[str, Any]) -> str:
    minutes = said["driven_s"] / 60.0
    rows = [
        [r["candidates"], r["jobs"], number(r["cpu_s"] / minutes), number(r["wall_s"] / minutes),
         times(r["wall_s"], said["rows"][-2]["wall_s"]), r["named"]] for r in said["rows"]
    ]  # fmt: skip
    head = ["candidates", "jobs", "CPU s", "wall s", "wall, of all on one", "named"]
    return "Seconds for a minute of driving in four drives, steering 30 ms late.\n\n" + table(
        head, rows
    )


def control_path(said: list[dict[str, Any]]) -> str:
    shown, marks = ("path_ms", "work_ms", "late_ms"), ("p50", "p99", "p999")
    rows = [
        [r["rate"], "loaded" if r["busy"] else "idle", "FIFO" if r["fifo"] else "other",
         *("/".join(number(r[what][p]) for p in marks) for what in shown),
         r["unrecorded"], "yes" if r["stopped"] else ""]
        for r in said
    ]  # fmt: skip
    words = "Hz,cores,scheduler,path,work,past deadline,ticks not recorded,car stopped"
    head = words.split(",")
    shares = [
        [r["rate"], *(f"{r['cpu_percent'][n]:g} %" for n in r["cpu_percent"])]
        for r in said if not r["busy"] and r["fifo"]
    ]  # fmt: skip
    names = list(said[0]["cpu_percent"])
    return (
        "Milliseconds, p50/p99/p99.9. `path`: mocap datagram to the first bytes of the tick after "
        "it, stamped by a process between core and simulated hardware. `work`: of the core in a "
        "tick, after the pose is fused. `past deadline`: how late a tick began. `loaded`: one "
        "endless loop per core.\n\n"
        + table(head, rows)
        + "\nShare of a core, idle and FIFO:\n\n"
        + table(["Hz", *names], shares)
    )


def control_floor(said: dict[str, Any]) -> str:
    def row(name: str, found: dict[str, float]) -> list[str]:
        return [name, *(number(found[mark]) for mark in ("p50", "p99", "p999"))]

    tick = said["tick"]
    rows = [row(f"path through a C program, {name}", found) for name, found in said["bare"].items()]
    rows += [row(f"the core's tick, {name}", found) for name, found in tick.items()]
    slower = times(tick["after a sleep"]["p50"], tick["in a row"]["p50"])
    return (
        f"Milliseconds at {said['rate']} Hz under SCHED_FIFO. The C program answers a datagram at "
        "once, in the core's place. The tick is the core's with a fresh pose, in virtual time: one "
        "after the other, or asleep until the next is due.\n\n"
        + table(["", "p50", "p99", "p99.9"], rows)
        + f"\nAfter a rest the tick takes {slower} as long: the caches are cold.\n"
    )


def virtual(said: dict[str, Any]) -> str:
    def row(name: str, values: list[float]) -> list[object]:
        middle = values[len(values) // 2]
        return [name, f"{number(middle)} × ({number(values[0])}..{number(values[-1])})",
                f"{1e6 / (middle * 100.0):,.0f}"]  # fmt: skip

    rows = [row(f"loop at {hz} Hz", v) for hz, v in said["loop_hz"].items()]
    rows += [row("100 Hz, recorded and watched", said["recorded"])]
    rows += [row(f"100 Hz, physics every {ms} ms", v) for ms, v in said["physics_ms"].items()]
    units = ""
    if "units" in said:
        u = said["units"]
        units = (
            f"\nA simulated second at 100 Hz, recorded, costs {spread(u)} times a fixed piece of "
            f"pure Python (`benchmarks/timing.py`, {number(u['unit_ms'])} ms here).\n"
        )
    each_us = 1e4 / sorted(said["loop_hz"]["100"])[1] / said["calls"]
    seeds = [[s["seeds"], s["workers"], number(s["wall_s"]), f"{number(s['times_real'])} ×"]
             for s in said["seeds"]]  # fmt: skip
    return (
        "Simulated seconds per CPU second of the whole loop with both protocols. Default physics "
        "step: 2 ms.\n\n"
        + table(["", "of real time", "µs per 10 ms"], rows)
        + units
        + "\n"
        + table(["seeds of 2 s", "processes", "wall s", "of real time, together"], seeds)
        + f"\nA tick of 10 ms is {number(said['calls'])} calls at {number(each_us)} µs each.\n"
    )


def ratio(said: dict[str, Any]) -> str:
    return (
        f"A simulated second at 100 Hz, recorded, costs {spread(said)} of what it cost at "
        f"`{said['since']}`: {number(said['after_ms'])} ms of CPU for {number(said['before_ms'])} "
        "(`python -m benchmarks.perf_ratio --since COMMIT`).\n"
    )


def wire(said: dict[str, Any]) -> str:
    others = {"vesc": "pyvesc", "mocap": "natnet", "bus": "msgspec MessagePack"}
    rows = []
    for part, other in others.items():
        for name, found in said[part].items():
            theirs = found.get("other_us")
            ratio = times(found["us"]["median"], theirs["median"]) if theirs else "—"
            rows.append([f"{part} {name}", spread(found["us"]),
                         spread(theirs) if theirs else "—", other, ratio])  # fmt: skip
    s = said["session"]
    return (
        table(["µs", "here", "there", "(package)", "of it"], rows)
        + f"\nA session of ten minutes at 100 Hz ({s['messages']:,} messages, {s['megabytes']:g} "
        f"MB; {s['kept']:,} read back) is written at {s['write_per_s']:,} messages per CPU second, "
        f"{number(s['write_per_s'] / 700)} times what a drive makes, and read to arrays in "
        f"{number(s['open_s'])} s; the mcap package needs {number(s['mcap_reader_s'])} s to count "
        "its messages.\n"
    )


def startup(said: dict[str, Any]) -> str:
    bare = said["python -c pass"]["median"]
    rows = [[name, spread(found), times(found["median"], bare)] for name, found in said.items()]
    return (
        table(["wall s", "median (least..most)", "of an empty interpreter"], rows)
        + "\nThe first command waits 1 s for the checks and 0.4 s for the VESC's timeout.\n"
    )


def batch(said: dict[str, Any]) -> str:
    rows = []
    for each in said["hidden"]:
        off = "not found" if each["days_off"] is None else f"{each['days_off']:+d}"
        rows.append([each["car"], each["parameter"], each["day"], each["found"] or "—", off,
                     number(each["sigma"]) if each["sigma"] else "—"])  # fmt: skip
    wrong = ", ".join(said["wrongly"]) or "none"
    return (
        f"`steerd batch identify` over {said['sessions']} imported drives of 20 s, {said['cars']} "
        f"cars; one worker is killed. Failed: {said['failed']}; cars named wrongly: {wrong}."
        "\n\n"
        + table(["car", "hidden", "since", "named", "days off", "sigma"], rows)
        + f"\nIn {number(said['identified_s'])} s. A part of it by one process and by two: "
        f"{number(said['one_s'])} and {number(said['two_s'])} s, {number(said['ratio'])} × (load "
        f"average {said['load']:g}).\n"
    )


def hours(said: list[dict[str, Any]]) -> str:
    rows = [
        [f"{each['hours']:g}", each["sessions"], each["identify_mb"], each["identify_cpu_s"],
         each["diagnose_mb"], each["diagnose_cpu_s"]]
        for each in sorted(said, key=lambda each: float(each["hours"]))
    ]  # fmt: skip
    head = ["hours", "sessions", "identify MB", "CPU s", "diagnose MB", "CPU s"]
    return (
        "Imported drives, 100 poses a second; peak memory and processor time. Of more than twenty "
        "minutes, pieces from all sessions are used.\n\n" + table(head, rows)
    )


PARTS = {
    "simulation": ("Differentiable simulation", simulation),
    "identify": ("Identification", identify),
    "diagnosis": ("Diagnosis", diagnosis),
    "control_path": ("Control path", control_path),
    "control_floor": ("What the machine takes of it", control_floor),
    "virtual": ("Virtual time", virtual),
    "ratio": ("Virtual time, against an older commit", ratio),
    "wire": ("Wire and file", wire),
    "startup": ("Start-up", startup),
    "batch": ("Batches", batch),
    "hours": ("Hours of driving", hours),
}


def render(kept: dict[str, Any]) -> str:
    """The page."""
    machine = kept["machine"]
    page = [
        "# Performance\n",
        "Written by `make bench`. Compare only figures of one run: machines differ more than "
        "programs.\n",
        f"{machine['cpu']}, {machine['cores']} cores, Linux {machine['kernel']}, Python "
        f"{machine['python']}, {machine['date']}; load average at the start {machine['load']}.\n",
    ]
    for name, (title, write) in PARTS.items():
        found = kept.get(name, {"failed": "left out"})
        page.append(f"## {title}\n")
        page.append(write(found["said"]) if "said" in found else MISSING.format(found["failed"]))
    return "\n".join(page)
