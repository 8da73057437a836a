"""Metadata and attachments of a session file."""

import os
import platform
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict
from datetime import UTC, datetime
from functools import lru_cache
from pathlib import Path
from tempfile import TemporaryDirectory

import platformdirs

from steerd.car_model.car_file import CarFile, parse_car
from steerd.daemon.assembly.build import VIRTUAL_EPOCH_NS, RunPlan
from steerd.daemon.assembly.sim_car import TRUTH, make_true_model, make_truth
from steerd.daemon.settings.run_options import RunOptions, encode_options
from steerd.posterior_file import ATTACHED
from steerd.steer_bus.container import SessionInfo
from steerd.steer_bus.session_read import WRONG_CONTENT, Session, SessionError
from steerd.version import VERSION

_DAY_NS = 86_400_000_000_000


def is_virtual(info: SessionInfo) -> bool:
    """Whether a session was driven in virtual time: its date says nothing."""
    mode = info.metadata.get("steerd.session", {}).get("mode")
    return mode != "import" and 0 <= info.start_ns - VIRTUAL_EPOCH_NS < _DAY_NS


def data_folder() -> Path:
    """The user's data folder (systemd: `$STATE_DIRECTORY`)."""
    return Path(os.environ.get("STATE_DIRECTORY") or platformdirs.user_data_path("steerd"))


def sessions_folder() -> Path:
    """Where the sessions of drives lie for which nobody chose a place."""
    return data_folder() / "sessions"


def session_path(options: RunOptions, realtime_ns: int, boot_id: int) -> Path:
    """The file of `--record`; else a name made of date, car and run, in `sessions_folder`."""
    if options.record:
        return Path(options.record)
    stamp = datetime.fromtimestamp(realtime_ns // 1_000_000_000, UTC).strftime("%Y-%m-%dT%H-%M-%SZ")
    return sessions_folder() / f"{stamp}_{options.car}_{boot_id & 0xFFFFFFFF:08x}.mcap"


def _git() -> dict[str, str]:
    root = Path(__file__).resolve().parents[2]
    if not (root / ".git").exists():
        return {}
    command = ["git", "describe", "--always", "--dirty", "--abbrev=12"]
    done = subprocess.run(command, cwd=root, capture_output=True, text=True, check=False)
    return {"git": done.stdout.strip()} if done.returncode == 0 else {}


def make_metadata(plan: RunPlan) -> dict[str, dict[str, str]]:
    """Metadata of a session; of a drive in virtual time without what differs between machines."""
    options, run, car = plan.options, plan.run, plan.settings.file.car
    session = {
        "steerd_version": VERSION,
        "car": options.car,
        "mode": "sim" if options.simulated else "hw",
        "options": encode_options(options),
        "boot_id": str(run.boot_id),
        "leased": str(int(run.leased)),
        "epoch_ns": str(run.epoch_ns),
    }
    if plan.real is not None:
        session |= {"host": platform.node(), "kernel": platform.release(), **_git()}
    vehicle = {name: repr(value) for name, value in car._asdict().items()}
    scaling = {name: repr(value) for name, value in asdict(plan.settings.scaling).items()}
    found = {"steerd.session": session, "steerd.vehicle": vehicle, "steerd.scaling": scaling}
    if options.simulated:
        found[TRUTH] = make_truth(make_true_model(plan.sim, options.effects))
    return found


def make_attachments(plan: RunPlan) -> dict[str, str]:
    """Attachments of the session, unchanged: car file, what identify knows, path, simulated car."""
    texts = {"car.toml": plan.settings.file.text}
    if plan.settings.file.posterior:
        texts[ATTACHED] = plan.settings.file.posterior
    if plan.options.sim_car:
        texts["sim_car.toml"] = plan.sim.file.text
    path_file = csv_file(plan.options.path)
    if path_file is not None:
        texts["path.csv"] = Path(path_file).read_text()
    return texts


def read_session_car(session: Session) -> CarFile:
    """The car file inside a session, with what identify knew of the car.

    Raises:
        SessionError: there is none, or it is no text.
        CarFileError: it cannot be used.
    """
    texts = {}
    for name in ("car.toml", *({ATTACHED} & {*session.info().attachments})):
        try:
            texts[name] = session.attachment(name).decode()
        except UnicodeDecodeError:
            what = f"{session.info().path.name}: the attached {name} is no UTF-8"
            raise SessionError("bad_attachment", what, exit_code=WRONG_CONTENT) from None
    place = Path(f"{session.info().path.name}:car.toml")
    return _parse_once(texts["car.toml"], place, texts.get(ATTACHED, ""))


_parse_once = lru_cache(maxsize=8)(parse_car)  # several parts of one command ask for the same car


@contextmanager
def recorded_path(session: Session, spec: str) -> Iterator[str]:
    """The path's spec, with the file that it names taken from the session, never from this disk.

    Raises:
        SessionError: the session does not hold the file.
    """
    if csv_file(spec) is None:
        yield spec
        return
    with TemporaryDirectory() as folder:
        copy = Path(folder) / "path.csv"
        copy.write_bytes(session.attachment(copy.name))
        yield ",".join([f"csv:{copy}", *spec.split(",")[1:]])


def csv_file(spec: str) -> str | None:
    """The file that a path description names, if it names one."""
    return spec.removeprefix("csv:").split(",")[0] if spec.startswith("csv:") else None
