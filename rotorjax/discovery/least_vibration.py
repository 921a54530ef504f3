"""The unbalance whose removal leaves least vibration, where a bow or a force excites the rotor beside it."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from rotorjax.arrays import numpy_pair
from rotorjax.discovery.fit import Fit
from rotorjax.effects.excitation import PlaneParticipation, ResidualUnbalance
from rotorjax.effects.reading import Runout
from rotorjax.inference.faults import fault_sensitivity, response_to
from rotorjax.model.conditions import Conditions
from rotorjax.model.contract import ExcitationEffect
from rotorjax.model.model import Model

Pair = Float[np.ndarray, "2"]


class Left(NamedTuple):
    """Vibration at 1X with nothing installed, rms over probes and speeds [m]; without runout."""

    before: float
    after: float
    """With the unbalance removed that leaves least."""
    unbalance_alone: float
    """With the residual unbalance removed and nothing else."""

    @classmethod
    def of(
        cls, vibration: Float[np.ndarray, "number"], slopes: Float[np.ndarray, "number 2"], *removed: Pair
    ) -> "Left":
        """With nothing and with each of two unbalances ``removed``."""
        return cls(*(float(np.sqrt(2.0 * np.mean((vibration - slopes @ u) ** 2))) for u in (np.zeros(2), *removed)))


class Together(NamedTuple):
    """What excites a rotor at 1X, as one unbalance on the disk."""

    effects: tuple[str, ...]
    unbalance: Pair
    """Its removal leaves least [kg m]."""
    by_unknown: Float[np.ndarray, "2 param"]
    """Its change with each unknown of what excites."""
    left: Left


def excites_at_1x(fitted: Fit) -> tuple[str, ...]:
    """Effects fitted that excite the rotor at 1X, the residual unbalance among them; none where 1X was not measured."""
    if 1.0 not in fitted.model.layout.orders:
        return ()
    names = dict.fromkeys(e.entry.effect for e in fitted.estimates)
    of_planes = PlaneParticipation.name
    return tuple(name for name in names if isinstance(fitted.model.find(name), ExcitationEffect) and name != of_planes)


def together(fitted: Fit, speed_rpm: Float[np.ndarray, "speed"]) -> Together:
    """The unbalance U for which Σ |z - J U|² over probes and speeds is least, z the vibration at 1X with nothing
    installed and J the response to an unbalance; of a linear rotor.
    """
    names, space, point = excites_at_1x(fitted), fitted.stage.space, fitted.end.point
    found, before, slopes = _equivalent(fitted.model, speed_rpm)
    which = [e.entry.unknown for e in fitted.estimates if e.entry.effect in names]
    by_unknown = np.zeros((2, len(point)))
    for unknown in which:
        there = point.copy()
        there[unknown] += 1.0
        by_unknown[:, unknown] = _equivalent(space.model_at(there), speed_rpm)[0] - found
    own = {e.entry.label: e.value for e in fitted.estimates if e.entry.effect == ResidualUnbalance.name}
    alone = np.array([own[f"unbalance_{axis}_kg_m"] for axis in "xy"])
    return Together(names, found, by_unknown, Left.of(before, slopes, found, alone))


def against(
    model: Model, speed_rpm: Float[np.ndarray, "speed"], faults: Float[np.ndarray, "4"]
) -> tuple[Pair, Float[np.ndarray, "2 4"], Left]:
    """The same for an unbalance and a bow (U_x, U_y, s_x, s_y) on the disk: that unbalance, its derivative by them, and
    what it leaves.
    """
    slopes = fault_sensitivity(*_nothing_installed(model, speed_rpm))[:, :, model.layout.orders.index(1.0)]
    slopes = slopes.reshape(-1, 4)
    by_fault = np.linalg.lstsq(slopes[:, :2], slopes)[0]
    return by_fault @ faults, by_fault, Left.of(slopes @ faults, slopes[:, :2], by_fault @ faults, faults[:2])


def _equivalent(
    model: Model, speed_rpm: Float[np.ndarray, "speed"]
) -> tuple[Float[np.ndarray, "2"], Float[np.ndarray, "number"], Float[np.ndarray, "number 2"]]:
    """That unbalance, the vibration in real numbers, and its slopes by an unbalance."""
    first, (shaft, conditions) = model.layout.orders.index(1.0), _nothing_installed(model, speed_rpm)
    vectors = np.asarray(response_to(shaft, conditions, np.zeros((len(speed_rpm), 4))))[:, :, first]
    slopes = fault_sensitivity(shaft, conditions)[:, :, first, :, :2].reshape(-1, 2)
    numbers = numpy_pair(vectors).ravel()
    return np.linalg.lstsq(slopes, numbers)[0], numbers, slopes


def _nothing_installed(model: Model, speed_rpm: Float[np.ndarray, "speed"]) -> tuple[Model, Conditions]:
    """The rotor read without runout, and these speeds."""
    conditions = Conditions.at_rpm(speed_rpm, unbalance=np.zeros((len(model.layout.planes), 2)))
    return model.without(Runout.name), conditions
