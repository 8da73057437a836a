"""`steerd.Environment`: the simulated car one step at a time, as Gymnasium's environments go."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from importlib import import_module
from importlib.util import find_spec
from typing import Any

import numpy as np
from numpy.typing import NDArray

from steerd.daemon.analysis.options import CarSource
from steerd.daemon.analysis.simulation import EffectValues, Steered, plan_drive
from steerd.daemon.assembly.build import make_world_config
from steerd.daemon.common.errors import SteerdError, UsageError
from steerd.daemon.common.notebook import speaking_of_arguments
from steerd.daemon.loop.transitions import SupervisorState
from steerd.daemon.offline.virtual import make_virtual_run
from steerd.sim_hw.world import World
from steerd.steer_bus.messages import StateMessage

Observation = NDArray[np.float32]
OBSERVED = ("e1", "e2", "curvature", "speed_ref", "speed", "yaw_rate", "slip_angle", "steer")
"""Fields of `state` that an observation holds, in SI."""
_WAIT_MAX = 30.0  # time in which a simulated car comes to drive [s]
_Base: Any = import_module("gymnasium").Env if find_spec("gymnasium") else object


def stay_in_lane(state: StateMessage, action: Sequence[float]) -> float:
    """The reward without another: progress, less the offsets from the lane."""
    return float(0.01 * state.speed - state.e1**2 - 0.1 * state.e2**2)


class Environment(_Base):  # type: ignore[misc]
    """A drive that waits for an action at every estimate, 100 times a second.

    An action is (steer [rad], speed [m/s]), an observation the estimate's fields `OBSERVED`. The
    loop, the limits and the watchdogs are those of every drive: a watchdog that stops the car, or
    leaving the lane, terminates the episode; the end of `duration` truncates it. The same seed and
    actions give the same episode. With Gymnasium installed this is one of its environments.

    Args:
        car, path, speed, effects: as for `simulate`.
        duration: of an episode [s].
        every: estimates to a step; the action is held in between.
        leave: offset from the lane that ends the episode [m].
        reward: from the estimate and the action; `stay_in_lane` without.

    A SteerdError where an argument cannot be used.
    """

    metadata: Mapping[str, Any] = {"render_modes": []}

    @speaking_of_arguments
    def __init__(
        self,
        car: CarSource = None,
        path: str = "figure8",
        *,
        speed: float = 1.0,
        duration: float = 20.0,
        effects: EffectValues | None = None,
        every: int = 1,
        leave: float = 0.5,
        reward: Callable[[StateMessage, Sequence[float]], float] = stay_in_lane,
    ) -> None:
        if every < 1:
            raise UsageError(f"every {every}: 1 or more")
        # The drive itself is longer: its end belongs to the episode's truncation.
        self._plan = plan_drive(car, path, speed, duration + 1.0, 0, effects, external=True)
        make_world_config(self._plan)  # refuses effects that there are not
        self._ticks, self._every = round(duration * 100.0), every
        self._leave, self._reward = leave, reward
        self._action: tuple[float, float] = (0.0, 0.0)
        self._left = 0
        if _Base is not object:
            spaces, limits = import_module("gymnasium.spaces"), self._plan.settings.limits
            low = np.array([-limits.steer_right_max, 0.0], np.float32)
            high = np.array([limits.steer_left_max, limits.speed_max], np.float32)
            self.action_space = spaces.Box(low, high)
            self.observation_space = spaces.Box(-np.inf, np.inf, (len(OBSERVED),), np.float32)

    def __repr__(self) -> str:
        path, speed = self._plan.options.path, self._plan.options.speed
        return f"<steerd.Environment: {path} {speed:g} m/s, {self._ticks / 100:g} s>"

    def reset(
        self, *, seed: int | None = None, options: Mapping[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Begin an episode: the car is armed and has begun to drive; a SteerdError if it does not.

        `seed` is that of the simulated hardware's noise, None for the last one; no `options` are
        known.
        """
        if seed is not None:
            self._plan = replace(self._plan, options=replace(self._plan.options, seed=seed))
        self._steered = Steered(lambda t, state, lane: self._action, self._plan.run.boot_id)
        world = World(make_world_config(self._plan))
        self._run = make_virtual_run(self._plan, (self._steered.see,), world)
        self._action = (0.0, 0.0)
        while self._state.mode != SupervisorState.RUNNING:
            self._tick()
            if self._run.t_ns > _WAIT_MAX * 1e9:
                raise SteerdError(f"the car does not come to drive: {self._run.core.loop.fault}")
        self._left = self._ticks
        return self._observe(), {"t": 0.0}

    def step(
        self, action: Sequence[float]
    ) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Hold an action until the next step.

        Gives observation, reward, whether the car was stopped or left its lane, whether time is
        over, and a dictionary: `t` [s] since the start, `fault` in words, `state`, the estimate. A
        SteerdError where the episode is over, or the action is not two finite numbers.
        """
        if self._left <= 0:
            raise SteerdError("the episode is over", "reset() begins the next")
        self._action = (float(action[0]), float(action[1]))
        loop = self._run.core.loop
        for _ in range(min(self._every, self._left)):
            self._tick()
            self._left -= 1
            if loop.faulted:
                break
        seconds = (self._ticks - self._left) * 0.01
        stopped = loop.faulted or abs(self._state.e1) > self._leave
        info = {"t": seconds, "fault": str(loop.fault or ""), "state": self._state}
        over = self._left <= 0 and not stopped
        self._left = 0 if stopped else self._left
        return self._observe(), self._reward(self._state, self._action), stopped, over, info

    @property
    def _state(self) -> StateMessage:
        while self._steered.newest is None:
            self._run.step()
        return self._steered.newest

    def _tick(self) -> None:
        """Answer the newest estimate, and let a period pass."""
        self._steered.command(self._run)
        self._run.step()

    def _observe(self) -> Observation:
        values = [getattr(self._state, name) for name in OBSERVED]
        return np.nan_to_num(np.array(values, np.float32))
