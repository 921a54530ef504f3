"""Excitations that nearly cancel: each shows far more than both do together, so that another may stand for them."""

import itertools
from collections.abc import Sequence

import numpy as np

from rotorjax.data.measurement import Measurement
from rotorjax.inference.budget import Budget
from rotorjax.inference.descent import End
from rotorjax.inference.prediction import predict
from rotorjax.inference.space import Space
from rotorjax.units import MICROMETRE, figures

LEAST_LEFT = 0.2
"""Of what the smaller of two excitations shows, the share that both show together at least."""


def cancelling(end: End, space: Space, m: Measurement, names: Sequence[str]) -> str | None:
    """What speaks against excitations that act against one another, of a linear rotor. **Arguments:** ``names`` of the
    effects of which any two may.
    """
    if len(names) < 2 or not space.is_linear_at(end.point):
        return None

    def shown(*without: str) -> np.ndarray:
        point = np.where(space.only_of(without), 0.0, end.point)
        return predict(space, m.conditions, point, budget=Budget()).shown

    def size(vectors: np.ndarray) -> float:
        return float(np.sqrt(np.mean(np.abs(vectors[m.present]) ** 2)))

    whole = shown()
    alone = {name: size(whole - shown(name)) for name in names}
    for one, other in itertools.combinations(names, 2):
        both = size(whole - shown(one, other))
        if both < LEAST_LEFT * min(alone[one], alone[other]):
            each = " and ".join(f"{figures(alone[name] / MICROMETRE)} µm" for name in (one, other))
            return (
                f"{one} and {other} nearly cancel: they show by {each} rms, together by "
                f"{figures(both / MICROMETRE)} µm; "
                "what is left of them may be another excitation, such as a force along one direction"
            )
    return None
