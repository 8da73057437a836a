"""The learner of `run --sim --fast --learn`: in the same process, in virtual time."""

from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING

from steerd.daemon.assembly.build import RunPlan
from steerd.daemon.ipc.pipe_records import PipeRecord, is_learnt_from, read_message
from steerd.daemon.offline.virtual import EPOCH_NS

if TYPE_CHECKING:
    from steerd.daemon.learning.feed import Feed


class LearnerBeside:
    """Records of a drive in, reports out; without `--learn` nothing comes out.

    Attributes:
        propose_to: takes the proposals of `--adapt`, and when they were made [ns].
    """

    def __init__(self, plan: RunPlan) -> None:
        """Load the car.

        Raises:
            ValueError: the car file holds what identify does not write.
        """
        settings = plan.settings
        self._feed: Feed | None = None
        if plan.options.learn:  # a drive without it loads no compiler
            from steerd.daemon.learning.feed import make_feed, wiring_of

            self._feed = make_feed(settings.file, wiring_of(EPOCH_NS, settings.scaling))
        self._reports = 0
        if self._feed is not None and plan.learnt is not None:
            from steerd.controller.build import compute_table
            from steerd.daemon.learning.proposing import Proposals, make_proposer

            proposer = make_proposer(plan.learnt, compute_table)
            self._feed.proposals = Proposals(
                proposer, lambda data, t_ns: self.propose_to(data, t_ns)
            )
        self.propose_to: Callable[[bytes, int], None] = lambda data, t_ns: None

    def take(self, record: PipeRecord) -> Iterator[PipeRecord]:
        """The record, and the report that it completes."""
        yield record
        if self._feed is None or not is_learnt_from(record):
            return
        from steerd.daemon.learning.feed import make_record

        report = self._feed.take(record.topic, read_message(record))
        if report is not None:
            yield make_record(report, self._reports, record.log_time_ns)
            self._reports += 1
