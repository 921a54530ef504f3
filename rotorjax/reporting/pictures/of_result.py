"""Pictures of a result by name: ``found.plot.amplitude()``."""

import numpy as np
from matplotlib.axes import Axes

from rotorjax.data.names import one_of, several
from rotorjax.discovery.explanation import Explanation
from rotorjax.discovery.story import Story
from rotorjax.reporting import plots
from rotorjax.reporting.pictures.orbits import (
    OrbitView,
    centrelines,
    draw_campbell,
    natural_frequencies_of,
    orbit_view,
    the_case,
    the_pair,
)
from rotorjax.reporting.pictures.views import draw_before_after, draw_fall, shown_runs, the_reading

MOST_SHOWN = 6
"""Effects in a picture of probabilities."""
AXES = ("x", "y")
OVER = ("displacement", "velocity", "angle")
"""Along what a missing force is drawn, and over what."""


class Plots:
    """Pictures of a comparison or an explanation. Every one returns its axes, new ones where none are given."""

    def __init__(self, result: Explanation | Story) -> None:
        self._found = result if isinstance(result, Explanation) else None
        self._story = result.story if isinstance(result, Explanation) else result

    def error(self, ax: Axes | None = None) -> Axes:
        """The error step by step, with that on data held out."""
        return draw_fall(ax or _new(5.6, 3.2), self._story, short=True)

    def amplitude(
        self, ax: Axes | None = None, *, run: str | None = None, probe: str | None = None, order: float | None = None
    ) -> Axes:
        """Amplitude over speed of one run, by default that with the largest vibration: measured, as declared, and with
        what was added.
        """
        return draw_before_after(ax or _new(5.6, 3.2), self._story, run=run, probe=probe, order=order)

    def polar(
        self, ax: Axes | None = None, *, probe: str | None = None, order: float | None = None, declared: bool = False
    ) -> Axes:
        """Vectors in the polar plane, each tied to where the model puts it; ``declared``: the model before anything
        was added.
        """
        m, view = self._story.measurement, self._story.declared if declared else self._story.last
        probe, order = the_reading(m, probe, order)
        axes = plots.polar(ax or _new(4.6, 4.4), view, probe=probe, order=order, runs=shown_runs(view))
        plots.legend_above(axes, most=3)
        return axes

    def residuals(self, ax: Axes | None = None, *, declared: bool = False) -> Axes:
        """Size of the residual by run, speed and probe."""
        return plots.residual_map(ax or _new(7.0, 3.2), self._story.declared if declared else self._story.last)

    def orbit(
        self,
        ax: Axes | None = None,
        *,
        run: str | None = None,
        speed_rpm: float | None = None,
        probes: tuple[str, str] | None = None,
    ) -> Axes:
        """Path of the shaft's centre in the plane of two probes, all orders measured, with the model's: of a run at the
        speed nearest to that given, by default where the vibration is largest. **Errors.** ``ValueError`` where no two
        probes tell one.
        """
        shown = self._orbit(run, speed_rpm, probes)
        axes = plots.orbit(ax or _new(4.4, 4.8), shown.measured, shown.model, probes=shown.probes)
        axes.set_title(shown.title, fontsize=9, loc="left")
        return axes

    def full_spectrum(
        self,
        ax: Axes | None = None,
        *,
        run: str | None = None,
        speed_rpm: float | None = None,
        probes: tuple[str, str] | None = None,
    ) -> Axes:
        """Amplitudes of forward and of backward circular motion at every order measured; arguments and errors as for
        `orbit`.
        """
        shown = self._orbit(run, speed_rpm, probes)
        axes = plots.full_spectrum(ax or _new(5.6, 3.2), shown.measured, shown.model)
        axes.set_title(shown.title, fontsize=9, loc="left")
        return axes

    def centreline(
        self,
        ax: Axes | None = None,
        *,
        runs: tuple[str, ...] | None = None,
        probes: tuple[str, str] | None = None,
        clearance_um: float | None = None,
    ) -> Axes:
        """Mean position of the shaft over speed, with the model's; ``clearance_um``: radius of a circle about the
        origin. **Errors.** ``ValueError`` where 0X was not measured by two probes in one plane.
        """
        view, pair = self._story.last, the_pair(self._story, probes)
        lines = centrelines(view, self._story.final_model, pair, shown_runs(view) if runs is None else several(runs))
        if not lines:
            raise ValueError("no mean position to show: 0X was not measured by both probes; add order 0 to the table")
        return plots.centreline(ax or _new(5.2, 4.8), lines, clearance_um=clearance_um)

    def campbell(self, ax: Axes | None = None) -> Axes:
        """Natural frequencies over speed with what was added, in the colour of their damping, and as declared.
        **Errors.** ``ValueError`` where an effect depends on frequency as no spring, damper or mass does.
        """
        found = natural_frequencies_of(self._story)
        if found is None:
            raise ValueError("no Campbell diagram: no equation of motion in time stands for this model")
        return draw_campbell(ax or _new(6.2, 4.0), self._story, found)

    def probabilities(self, ax: Axes | None = None, *, step: int = 0) -> Axes:
        """What would be added at a step, 0 the first, -1 the last, "none" among it."""
        rankings = self._explanation("probabilities").rankings
        ranked = rankings[one_of(step if step >= 0 else len(rankings) + step, range(len(rankings)), "step")][
            :MOST_SHOWN
        ]
        return plots.probabilities(ax or _new(5.6, 2.6), [r.effect for r in ranked], [r.probability for r in ranked])

    def missing_force(self, ax: Axes | None = None, *, axis: str = "x", over: str = "displacement") -> Axes:
        """The force that is missing along x or y, over displacement, velocity or angle. **Errors.** ``ValueError``
        where it was not looked into.
        """
        named = self._explanation("the missing force").named_force
        if named is None or named.force.reason is not None:
            raise ValueError(
                f"no missing force to show: {'it was not looked into' if named is None else named.force.reason}"
            )
        dof = AXES.index(one_of(axis, AXES, "axis"))
        one_of(over, OVER, "quantity to draw it over")
        return plots.missing_force(ax or _new(5.6, 3.4), named.force, over=over, dof=dof)  # pyright: ignore

    def correlations(self, ax: Axes | None = None) -> Axes:
        """Correlations of the parameters fitted last. **Errors.** ``ValueError`` where nothing was fitted."""
        if not self._story.fits or not self._story.fits[-1].estimates:
            raise ValueError("nothing was fitted: there are no correlations to show")
        last = self._story.fits[-1]
        unknowns = {e.entry.unknown: e.entry.key for e in last.estimates}
        part = last.covariance[np.ix_(list(unknowns), list(unknowns))]
        spread = np.sqrt(np.diag(part))
        return plots.correlations(ax or _new(5.2, 4.6), list(unknowns.values()), part / spread[:, None] / spread)

    def _orbit(self, run: str | None, speed_rpm: float | None, probes: tuple[str, str] | None) -> OrbitView:
        pair = the_pair(self._story, probes)
        return orbit_view(self._story.last, self._story.final_model, the_case(self._story, pair, run, speed_rpm), pair)

    def _explanation(self, what: str) -> Explanation:
        if self._found is None:
            raise ValueError(f"a comparison has no {what}: explain finds that")
        return self._found


def _new(width: float, height: float) -> Axes:
    return plots.figure(width, height)[1][0]
