"""What a replay gives again, and what it does not without some of the recorded messages."""

from steerd.daemon.offline.replay import replay
from steerd.steer_bus.session_read import Session


def count_differences_without(session: Session, ending: str, ticks: int) -> int:
    """Orders that differ where messages of the topics with this ending are kept from the replay.

    With them every order of more than `ticks` is given again, which is checked first.
    """
    run, differences = replay(session, "drive.mcap")
    assert list(differences) == []
    assert run.ticks > ticks
    deaf, _ = replay(session, "drive.mcap")
    heard = (record for record in session.messages() if not record.topic.endswith(ending))
    return sum(deaf.take(record) is not None for record in heard)
