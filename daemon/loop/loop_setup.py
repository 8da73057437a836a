"""What does not change during a run of the loop."""

from dataclasses import dataclass

from steerd.controller.acceptance import Acceptance
from steerd.controller.lane_controller import LaneController
from steerd.controller.live import LiveBounds
from steerd.daemon.loop.plans import Drill
from steerd.daemon.settings.config import Settings


@dataclass(frozen=True)
class LoopSetup:
    """What does not change during a run.

    Attributes:
        settings: of the car file.
        controller: the lane keeper, which also gives the lane errors.
        period_ns: period of the loop.
        boot_id: random number of this run, which operators must name.
        remote: commands come from an external controller.
        auto_arm: arm and start once without an operator.
        leased: an operator's lease and deadman are needed.
        duration_ns: length of the drive, None without end.
        simulated: the hardware is simulated: limits of lateness are loose.
        drill: excitation plan, in place of the lane keeper or added to it.
        live: bounds of the live parameters; None where there are none.
        learnt: what designs of the learner are held against; None where none is followed.
    """

    settings: Settings
    controller: LaneController
    period_ns: int
    boot_id: int
    remote: bool = False
    auto_arm: bool = False
    leased: bool = True
    duration_ns: int | None = None
    simulated: bool = False
    drill: Drill | None = None
    live: LiveBounds | None = None
    learnt: Acceptance | None = None

    @property
    def ignores_lane(self) -> bool:
        """Whether lane errors do not count: something else than the lane keeper drives."""
        return self.remote or (self.drill is not None and not self.drill.closed)
