"""What does not change during a run of the loop."""

from dataclasses import dataclass

from steerd.controller.acceptance import Acceptance
from steerd.controller.lane_controller import LaneController
from steerd.controller.live import LiveBounds
from steerd.daemon.loop.plans import Drill
from steerd.daemon.settings.config import Settings


@dataclass(frozen=True)
class LoopSetup:
    """What does not change during a run."""

    settings: Settings  # of the car file
    controller: LaneController  # the lane keeper, which also gives the lane errors
    period_ns: int  # period of the loop
    boot_id: int  # random number of this run, which operators must name
    remote: bool = False  # commands come from an external controller
    auto_arm: bool = False  # arm and start once without an operator
    leased: bool = True  # an operator's lease and deadman are needed
    duration_ns: int | None = None  # length of the drive, None without end
    simulated: bool = False  # the hardware is simulated: limits of lateness are loose
    drill: Drill | None = None  # excitation plan, in place of the lane keeper or added to it
    live: LiveBounds | None = None  # bounds of the live parameters; None where there are none
    # What designs of the learner are held against; None where none is followed
    learnt: Acceptance | None = None

    @property
    def ignores_lane(self) -> bool:
        """Whether lane errors do not count: something else than the lane keeper drives."""
        return self.remote or (self.drill is not None and not self.drill.closed)
