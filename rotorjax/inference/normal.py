"""The normal equations of one descent: a linearisation under some freedom of the motions, on the cases that count."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from rotorjax.inference.linearised import Linearisation, Linearised
from rotorjax.inference.squares import Squares


class Task(NamedTuple):
    """What sets one descent apart from the others."""

    free: Int[np.ndarray, "free"]
    training: Bool[np.ndarray, "case"]
    shift: Float[np.ndarray, "case cell"] | None

    @property
    def kind(self) -> tuple[bytes, bytes]:
        """What it has in common with other descents of the same fit: the unknowns, and the cases that count."""
        return self.free.tobytes(), self.training.tobytes()


class Normal(Squares):
    """The normal equations of one linearisation under one freedom of the motions."""

    def __init__(self, lin: Linearisation, one: Linearised, task: Task, freedom: float) -> None:
        self.one, self.task, self.freedom = one, task, freedom if one.response is not None else 0.0
        counted = task.training[:, None]
        error = (one.error if task.shift is None else one.error + task.shift) * counted
        slopes, common = one.slopes * counted[..., None], lin.data.common * counted[..., None]
        self._factor = None
        if self.freedom > 0.0 and one.response is not None:
            assert one.response.own is not None
            reach = self.freedom * one.response.own.reach * counted[..., None]
            self._factor = np.linalg.cholesky(np.eye(reach.shape[1]) + reach @ np.swapaxes(reach, 1, 2))
            error = np.linalg.solve(self._factor, error[..., None])[..., 0]
            slopes, common = np.linalg.solve(self._factor, slopes), np.linalg.solve(self._factor, common)
        super().__init__(error, slopes, common)

    def motion_step(self, step: Float[np.ndarray, "free"]) -> Float[np.ndarray, "state motion"]:
        """How the motions move with a step of the parameters."""
        free = self.one.response
        assert free is not None
        moved = -(free.newton + free.newton_slopes @ step)
        if self._factor is not None and free.own is not None:
            pull = (
                np.linalg.solve(np.swapaxes(self._factor, 1, 2), self.left(step)[..., None])[..., 0]
                * self.task.training[:, None]
            )
            force = self.freedom**2 * np.swapaxes(free.own.reach, 1, 2) @ pull[..., None]
            moved[: len(force)] -= (free.own.by_force @ force)[..., 0]
        return moved
