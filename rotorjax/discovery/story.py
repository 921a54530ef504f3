"""The whole of one comparison: the model as declared, effects added one after the other, what fits as well, what is
left.
"""

import dataclasses
import functools

import numpy as np

from rotorjax.data.declarations import Mistake
from rotorjax.data.measurement import Measurement
from rotorjax.data.pairing import paired
from rotorjax.diagnosis.lateral import Lateral, lateral
from rotorjax.discovery.compare import Comparison, compare, compare_vectors
from rotorjax.discovery.driven_orders import undriven_orders, without_orders
from rotorjax.discovery.fit import Fit, fit_steps
from rotorjax.discovery.healthy import Healthy, calibrated
from rotorjax.discovery.odd_run import fitted_in_one_run
from rotorjax.discovery.rivals import Rival, rivals
from rotorjax.effects.structure import DampingError
from rotorjax.model.contract import AbstractRotor, Effect
from rotorjax.model.model import Model
from rotorjax.physics.stability import steadiness
from rotorjax.shown import Reported
from rotorjax.units import MICROMETRE

FAR = 5.0
"""Times what was measured that the model as declared moves at least where the rotor is said hardly to move."""
CORRELATED = 0.95
"""Correlation of two estimates above which the data fix a combination of them only."""


@dataclasses.dataclass(frozen=True, eq=False)
class Story(Reported):
    """A model compared as declared, and after every effect added."""

    model: Model
    measurement: Measurement
    declared: Comparison
    additions: tuple[str, ...]
    fits: tuple[Fit, ...]
    """The first with the declared uncertain values alone, then one per addition; empty where nothing was fitted."""
    views: tuple[Comparison, ...]
    """The comparison after each fit."""
    rivals: tuple[Rival, ...]
    undriven: tuple[float, ...] = ()
    """Orders that nothing in the model drives, left out once effects are fitted: they would only pose as noise."""
    mistake: Mistake | None = None
    """What was written down wrongly: put right from the first fit on."""
    beside: tuple[str, ...] = ()
    """Effects too small to matter by themselves that are in the last fit."""
    healthy: Healthy | None = None
    """The model calibrated on the healthy rotor, where that was measured: what differs from it has changed since."""

    def __repr__(self) -> str:
        steps = [
            ("as declared", self.declared.rms),
            *zip(self.additions, (view.rms for view in self.views[1:]), strict=False),
        ]
        return f"Story({', '.join(f'{what}: {rms / MICROMETRE:.3g} µm' for what, rms in steps)})"

    @property
    def last(self) -> Comparison:
        """The comparison at the end."""
        return self.views[-1] if self.views else self.declared

    @property
    def final_model(self) -> Model:
        """The fitted model, or the declared one if nothing was added."""
        return self.fits[-1].model if self.fits else self.model

    @property
    def changed(self) -> bool:
        """Whether anything was fitted, so that there is a before and an after."""
        return self.mistake is not None or any(fitted.estimates for fitted in self.fits)

    @property
    def hardly_moves(self) -> bool:
        """Whether no more than noise was measured, where the model as declared moves far: that has many causes."""
        measurement = self.declared.measurement
        return measurement.shows_nothing and self.declared.rms > FAR * measurement.rms

    @property
    def confirmed(self) -> bool:
        """Whether what was added makes the error fall on data held out too, as far as that was looked into."""
        first, last = (self.fits[k].held_out_rms if self.fits else None for k in (0, -1))
        return len(self.fits) == 1 or first is None or last is None or last < first

    @functools.cached_property
    def steadiness(self) -> list[str]:
        """Where the final model's steady state does not exist, is unstable or is not the only one."""
        return steadiness(self.final_model.with_orders(self.measurement.orders), self.measurement.conditions)

    @functools.cached_property
    def lateral(self) -> Lateral:
        """Critical speeds, separation margins and stability of the final model."""
        if not self.changed:
            return self.lateral_declared
        damping = (e for e in self.fits[-1].estimates if e.entry.effect == DampingError.name and not e.determined)
        found = self._of(self.final_model)
        return found._replace(open_axes=frozenset(e.entry.label[-1] for e in damping))

    @functools.cached_property
    def lateral_declared(self) -> Lateral:
        """The same of the model as declared."""
        return self._of(self.model)

    def _of(self, model: Model) -> Lateral:
        """Without stability where the model was calibrated: that leaves damping open away from the resonance."""
        found = lateral(model, self.measurement)
        return found if self.healthy is None else found._replace(stability=None)

    def noise_um(self) -> float | None:
        """Root mean square of pure noise, |z| over the cells [µm]; none where it is unknown."""
        noise = self.measurement.noise_rms
        return None if noise is None else noise / MICROMETRE

    def correlated(self) -> list[tuple[str, str, float]]:
        """Pairs of fitted parameters that the data fix in combination only, with their correlation."""
        if not self.fits:
            return []
        fitted = self.fits[-1]
        deviation = np.sqrt(np.diag(fitted.covariance))
        correlation = fitted.covariance / np.outer(deviation, deviation)
        entries = {e.entry.unknown: e.entry for e in fitted.estimates}
        return [
            (entries[i].key, entries[j].key, float(correlation[i, j]))
            for i in sorted(entries)
            for j in sorted(entries)
            if i < j and abs(correlation[i, j]) > CORRELATED
        ]


def tell(
    model: Model | AbstractRotor,
    measurement: Measurement,
    additions: list[Effect],
    *,
    fixed: frozenset[str] = frozenset(),
    mistake: Mistake | None = None,
    healthy: Measurement | None = None,
) -> Story:
    """Compare a model as it is; then add effects one after the other, fitting what is not fixed, and compare again.

    **Arguments:** ``model``, or a rotor alone; ``additions`` in the order of adding; ``fixed``: entries of theirs that
    keep their value; ``mistake``: what is taken to be written down wrongly (`rotorjax.data.declarations.mistakes`), put
    right before anything is added; ``healthy``: a measurement of the healthy rotor, on which the model is calibrated
    first (`rotorjax.discovery.healthy.calibrated`).
    """
    if healthy is not None:
        known = calibrated(model, healthy)
        story = tell(known.model, known.beside(measurement), additions, fixed=fixed, mistake=mistake)
        return dataclasses.replace(story, healthy=known)
    model = paired(model, measurement)
    names = tuple(effect.name for effect in additions)
    if not additions and mistake is None:
        return Story(model, measurement, compare(model, measurement), names, (), (), ())
    stated = None if mistake is None else compare(model, measurement)
    if mistake is not None:
        mistake = fitted_in_one_run(mistake, model, measurement, names)
        model, measurement = mistake.put_right(model, measurement)
    undriven = undriven_orders(model.plus(additions), measurement) if additions else ()
    measurement = without_orders(measurement, undriven)
    stated = stated or compare(model, measurement)
    fits = fit_steps(model, additions, measurement, fixed=fixed)
    views = tuple(compare_vectors(f.predicted, measurement, f.model) for f in fits)
    others = tuple(rivals(fits[-1])) if additions else ()
    return Story(model, measurement, stated, names, tuple(fits), views, others, undriven, mistake)
