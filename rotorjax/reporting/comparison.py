"""A comparison as people read it: the verdict in a sentence, tables, and the page. Engineering units from here on."""

import math

import numpy as np

from rotorjax.data.measurement import Measurement
from rotorjax.data.rig_sections import Convention
from rotorjax.discovery.compare import Cell, Comparison
from rotorjax.discovery.fit import Fit
from rotorjax.discovery.rivals import TIE, Rival
from rotorjax.discovery.story import CORRELATED, Story
from rotorjax.inference.noise import FEW_RUNS, NO_SCATTER, scatter_share
from rotorjax.model.model import Model
from rotorjax.reporting.critical_speeds import (
    critical_speeds_lines,
    critical_speeds_table,
)
from rotorjax.reporting.healthy import healthy_lines, healthy_table, model_compared
from rotorjax.reporting.page import Headline, Page, Picture
from rotorjax.reporting.sizes import Size, sizes
from rotorjax.reporting.tables import Table, laid_out, number
from rotorjax.reporting.wording import opening, plain_name, said
from rotorjax.units import GRAM_MILLIMETRE, MICROMETRE

WORST = 8
"""Cells shown among the worst."""
SUSPICIOUS_CHI2 = 0.1
"""Reduced chi-square below which the standard errors of a table cannot be right."""
CHI2 = "reduced chi² (1 = noise)"
"""Head of a column: squared residual in squared standard errors per degree of freedom."""
HELPS = 0.95
"""An addition that leaves more than this share of the error has not helped."""


def measurement_line(m: Measurement) -> str:
    """What was measured, in a line."""
    speeds = (
        f"{m.speed_rpm.min():.0f} to {m.speed_rpm.max():.0f} rpm"
        if np.ptp(m.speed_rpm) > 0.5
        else f"{m.speed_rpm[0]:.0f} rpm"
    )
    orders = ", ".join(f"{order:g}X" for order in m.orders)
    if m.sigma is None or m.noise_rms is None:
        noise = "noise unknown: inferred from what the fit leaves"
    else:
        source = "from repeats" if m.noise == "repeats" else "given"
        alone = m.noise_rms / MICROMETRE
        error = number(alone / np.sqrt(2.0))
        noise = f"standard error {error} µm per component ({source}): noise alone is {number(alone)} µm rms"
    runs = "1 run" if len(m.runs) == 1 else f"{len(m.runs)} runs"
    probes = ", ".join(probe if probe in m.probes_read else f"{probe} (not read)" for probe in m.probes)
    return (
        f"{runs}, {speeds}, probes {probes}, {orders}: {int(m.present.sum())} vectors of {number(m.rms / MICROMETRE)} "
        f"µm rms (0-pk amplitudes, rms over all vectors), {noise}"
    )


def verdict(story: Story) -> str:
    """The result in one or two sentences."""
    first = _fails(story.declared, model_compared(story))
    if not story.fits:
        return first
    before, after = story.views[0].rms, story.last.rms
    if story.mistake is not None:
        first += f" If {story.mistake.meaning}, {number(before / MICROMETRE)} µm rms remain ({story.mistake.cure})."
        if not story.additions:
            return f"{first} {_remains(story)}"
    elif _has_uncertain(story):
        first += f" With its uncertain values fitted {number(before / MICROMETRE)} µm remain."
    names = said(story.additions)
    needed = [r for r in story.rivals if r.instead is None and not r.tied]
    if after >= HELPS * before and not needed:
        return f"{first} Adding {names} does not help: {number(after / MICROMETRE)} µm rms remain."
    held = story.fits[-1].held_out_rms
    fall = f"{number(before / after)}-fold to {number(after / MICROMETRE)} µm rms" if after > 0.0 else "to nothing"
    held_text = f" ({number(held / MICROMETRE)} µm on readings left out of the fit)" if held else ""
    return f"{first} With {names} the error falls {fall}{held_text}. {_remains(story)}"


def _remains(story: Story) -> str:
    chi2 = story.fits[-1].reduced_chi2
    if chi2 is None:
        known = story.measurement.sigma is not None
        why = "As many values were fitted as numbers were read" if known else "The noise is unknown"
        return f"{why}, so that nothing says whether what is left is more than noise."
    if _healthy(chi2, story.last):
        return "What is left is what the noise allows."
    return f"What is left is more than noise: reduced chi² {number(chi2)} (1 = noise only)."


def _healthy(chi2: float, view: Comparison) -> bool:
    """Within four standard deviations of what noise alone gives."""
    return chi2 <= 1.0 + 4.0 * math.sqrt(2.0 / np.count_nonzero(view.measurement.weights(0.0)))


def _critical_speeds(story: Story) -> list[str]:
    chi2 = story.fits[-1].reduced_chi2 if story.fits else None
    return critical_speeds_lines(story, explains=chi2 is None or _healthy(chi2, story.last))


def misfit_share(view: Comparison) -> str:
    """The rms residual, and its share of what was measured."""
    rms, size = view.rms / MICROMETRE, view.measurement.rms / MICROMETRE
    share = f", {number(100.0 * rms / size, 2)} % of the measured {number(size)} µm" if size > 0.0 else ""
    return f"{number(rms)} µm rms{share}"


def _fails(view: Comparison, subject: str) -> str:
    amount, chi2 = misfit_share(view), view.reduced_chi2
    if chi2 is None:
        return (
            f"{subject} differs from the measurement by {amount}; the noise is unknown, so that nothing says whether "
            "this is much."
        )
    if _healthy(chi2, view):
        return f"{subject} is within the noise: {amount}."
    return (
        f"{subject} fails: it differs from the measurement by {amount}; reduced chi² {number(chi2)} (1 = noise only)."
    )


def worst_cells(view: Comparison, title: str, convention: Convention | None = None, count: int = WORST) -> Table:
    """Where the model fails, worst first; phases as the rig file counts them."""
    cells, phase = view.where(), (convention or Convention()).phase
    headers = [
        "run",
        "rpm",
        "probe",
        "order",
        "measured µm",
        "model µm",
        "residual µm",
        "std. errors",
        "amplitude ratio",
        "phase error °",
    ]
    rows = [_cell_row(cell, -1.0 if phase == "lag" else 1.0) for cell in cells[:count]]
    spare = ["model µm", "amplitude ratio", "phase error °", "std. errors", "measured µm"]
    note = f"Amplitudes zero to peak, phase {phase}."
    if view.standardised is not None:
        note += " Standard errors are those of one component: noise alone gives 1.4 rms."
    return Table(f"{title} (worst {len(rows)} of {len(cells)})", headers, rows, note, spare=spare)


def _cell_row(cell: Cell, sign: float) -> list[str]:
    phase_error = None if cell.phase_error_deg is None else sign * cell.phase_error_deg
    return [
        cell.run, f"{cell.speed_rpm:.0f}", cell.probe, f"{cell.order:g}X", _polar(cell.measured, sign),
        _polar(cell.predicted, sign), number(cell.residual_um),
        number(cell.standardised), number(cell.amplitude_ratio), number(phase_error),
    ]  # fmt: skip


def _polar(z: complex, sign: float) -> str:
    return f"{number(abs(z) / MICROMETRE)} at {sign * math.degrees(math.atan2(z.imag, z.real)) + 0.0:.0f}°"


def share_table(view: Comparison, title: str, most: int = 6) -> Table:
    """Share of the misfit by run, speed, probe and order, the largest of each."""
    rows = []
    units = {"speed": " rpm", "order": "X", "run": "", "probe": ""}
    for kind, shares in view.share().items():
        largest = sorted(shares.items(), key=lambda item: -item[1])
        shown = ", ".join(f"{name}{units[kind]} {100.0 * value:.0f} %" for name, value in largest[:most])
        rows.append([kind, shown + (f", {len(largest) - most} more" if len(largest) > most else "")])
    return Table(title, ["by", "share of the squared misfit"], rows)


def step_labels(story: Story) -> list[str]:
    """Names of the steps: the model as declared, its uncertain values fitted, one per addition."""
    labels = ["as declared"]
    if story.fits:
        uncertain = ["uncertain values"] if _has_uncertain(story) else []
        first = uncertain if story.mistake is None else [f"+ {story.mistake.name}"]
        labels += [*first, *(f"+ {name}" for name in story.additions)]
        if story.beside:
            labels[-1] += f" (with {', '.join(story.beside)})"
    return labels


def steps(story: Story) -> list[tuple[Comparison, Fit | None]]:
    """What stands behind each of `step_labels`."""
    first = 0 if _has_uncertain(story) or story.mistake is not None else 1
    return [(story.declared, None), *zip(story.views[first:], story.fits[first:], strict=True)]


def _has_uncertain(story: Story) -> bool:
    return bool(story.fits) and any(e.entry.declared_uncertain for e in story.fits[0].estimates)


def fall_table(story: Story) -> Table:
    """The error as effects are added."""
    rows = []
    for label, (view, fitted) in zip(step_labels(story), steps(story), strict=True):
        held = number(fitted.held_out_rms / MICROMETRE) if fitted and fitted.held_out_rms is not None else "-"
        chi2 = fitted.reduced_chi2 if fitted else view.reduced_chi2
        state = "" if fitted is None or fitted.converged else "not converged"
        rows.append([label, number(view.rms / MICROMETRE), held, number(chi2), state])
    reason = story.fits[-1].held_out_reason if story.fits else ""
    note = f"The error on data held out is not known: {reason}." if reason else ""
    headers = ["step", "rms µm", "held out µm", CHI2, ""]
    return Table("The error as effects are added", headers, rows, note, spare=[CHI2, "held out µm"])


def parameter_table(fitted: Fit, convention: Convention | None = None) -> Table:
    """Fitted sizes with 95 % intervals, the names that rig files have for them, and what their prior was."""
    effects = tuple(dict.fromkeys(e.entry.effect for e in fitted.estimates))
    rows = [
        [size.effect, size.what, size.value, size.prior, ", ".join(size.labels), size.remark]
        for size in sizes(fitted, effects, convention)
    ]
    note = "In rig files and with --effect values are in SI, the unit at the end of the name; --write-rig writes them."
    headers = ["effect", "size of", "value (95 % interval)", "prior ±", "in rig files", "remark"]
    return Table("Parameters", headers, rows, note, spare=["prior ±", "in rig files", "remark"])


def findings(story: Story) -> list[str]:
    """What else a user must know: ties, effects without use, combinations, scatter between runs,
    failures to converge.
    """
    lines = [f"{note}." for note in story.measurement.notes]
    if story.undriven:
        names = ", ".join(f"{order:g}X" for order in story.undriven)
        lines.append(
            f"Nothing in this model excites {names}: those vectors were left out of the fit and of the error; "
            "`compare` without effects shows them."
        )
    lines += objections(story.final_model)
    lines += story.steadiness
    for name in dict.fromkeys(story.additions):
        lines += _rival_lines(name, [r for r in story.rivals if r.effect == name], story)
    if tangled := story.correlated():
        pairs = "; ".join(f"{first} with {second}" for first, second, _ in tangled)
        lines.append(f"Fixed by these data in combination only (correlation above {CORRELATED:g}): {pairs}.")
    if story.fits:
        last = story.fits[-1]
        chi2 = story.declared.reduced_chi2 if last.reduced_chi2 is None else last.reduced_chi2
        if chi2 is not None and chi2 < SUSPICIOUS_CHI2:
            lines.append(
                f"Reduced chi² {number(chi2)}: sigma_um looks far too large, so that nothing can be told from noise."
            )
        if last.misfit > 0.0 and len(story.measurement.runs) < FEW_RUNS and story.measurement.sigma is not None:
            lines.append("With fewer than four runs the intervals cannot account for scatter between runs.")
        if not last.converged:
            lines.append(f"The fit has not settled: {last.result}.")
        lines += [
            f"{e.entry.key}, declared uncertain, had to move by {abs(e.pull):.1f} of its standard deviations: the "
            "declaration or something else is wrong."
            for e in last.estimates
            if e.finding
        ]
        if last.run_scatter != NO_SCATTER:
            lines.append(_scatter_line(story))
    return lines


def objections(model: Model) -> list[str]:
    """What speaks against the values of effects on this rotor, and what else is to be known about them."""
    said = ((e.name, words) for e in model.effects for words in (e.objection(model.rotor), e.remark(model.rotor)))
    return [f"{name} {words}." for name, words in said if words is not None]


def _scatter_line(story: Story) -> str:
    """How much unbalance and bow differ between runs beyond what was installed, and what they account for."""
    scatter = story.fits[-1].run_scatter
    share = scatter_share(story.measurement, story.fits[-1].model, story.last.residual, scatter)
    sizes = [f"unbalance of {number(scatter.unbalance_kg_m / GRAM_MILLIMETRE)} g mm"] if scatter.unbalance_kg_m else []
    sizes += [f"bow of {number(scatter.bow_m / MICROMETRE)} µm"] if scatter.bow_m else []
    told = (
        ""
        if len(story.measurement.runs) >= FEW_RUNS
        else " Three runs do not tell that from one run that is other than stated."
    )
    return (
        f"Scatter between runs: a random {' and a '.join(sizes)} per run and component, inferred from what influence "
        "coefficients leave, "
        f"accounts for {100.0 * share:.0f} % of the squared residual.{told}"
    )


def _rival_lines(name: str, found: list[Rival], story: Story) -> list[str]:
    out = next((r for r in found if r.instead is None), None)
    if out is not None and out.tied:
        how = "as good" if out.loss > -TIE else "better"
        rms = number(out.rms / MICROMETRE)
        return [f"{opening(plain_name(name))} is not needed: without it the fit is {how} ({rms} µm rms)."]
    lines = []
    for rival in found:
        if rival.instead is not None and rival.tied:
            there = f"({number(rival.rms / MICROMETRE)} µm rms){_why(rival, story)}"
            own, other = opening(plain_name(name)), plain_name(rival.instead)
            lines.append(
                f"{own} ties with {other}: with that the fit is as good {there}."
                if rival.loss > -TIE
                else f"{own} fits less well than {other} would: with that the fit is better {there}."
            )
    return lines


def _why(rival: Rival, story: Story) -> str:
    if {rival.effect, rival.instead} == {"residual_unbalance", "residual_bow"} and story.model.slow_roll is not None:
        return "; slow roll was subtracted, and with it what tells a bow from an unbalance"
    return ""


def comparison_text(story: Story, convention: Convention | None = None, *, width: int | None = None) -> str:
    """Everything that `rotorjax compare` prints. **Arguments:** ``convention`` of angles; ``width``: columns of the
    terminal, if it is one.
    """
    parts: list[str | Table] = [measurement_line(story.measurement), *healthy_lines(story), verdict(story)]
    parts += _critical_speeds(story)
    parts += _comparison_tables(story, convention)
    parts += ["\n".join(f"- {line}" for line in findings(story))] if findings(story) else []
    title = "Where it fails" if not story.fits else "Where it still fails"
    parts += [worst_cells(story.last, title, convention), share_table(story.last, "Share of the misfit")]
    return laid_out(parts, width, everything="--report FILE.html")


def _comparison_tables(story: Story, convention: Convention | None) -> list[Table]:
    """What fitting brought, and critical speeds."""
    critical = critical_speeds_table(story)
    healthy = healthy_table(story.healthy)
    more = [table for table in (critical, healthy) if table is not None]
    return [*(step_tables(story, convention) if story.fits else []), *more]


def step_tables(story: Story, convention: Convention | None = None) -> list[Table]:
    """The fall of the error, and the parameters if any were fitted. **Arguments:** ``convention`` of angles."""
    return [fall_table(story), *([parameter_table(story.fits[-1], convention)] if story.fits[-1].estimates else [])]


def sizes_by_effect(
    fitted: Fit, names: tuple[str, ...], convention: Convention | None
) -> list[tuple[str, str, list[Size]]]:
    """Name, meaning and sizes of some effects of a fit."""
    every = sizes(fitted, names, convention)
    present = {effect.name: type(effect) for effect in fitted.model.effects}
    return [
        (name, present[name].meaning if name in present else "", [size for size in every if size.effect == name])
        for name in names
    ]


def comparison_page(
    story: Story,
    *,
    title: str,
    pictures: list[tuple[str, bytes]],
    first: list[tuple[str, bytes]] | None = None,
    convention: Convention | None = None,
) -> Page:
    """The report of `compare`. **Arguments:** ``pictures``: pairs of caption and SVG; ``first``: likewise, to be seen
    without scrolling.
    """
    shares = share_table(story.last, "Share of what is left" if story.fits else "Share of the misfit")
    where = [worst_cells(story.declared, "Where the model as declared fails", convention)] + (
        [worst_cells(story.last, "Where it still fails", convention)] if story.fits else []
    )
    names = tuple(dict.fromkeys(story.additions))
    found = sizes_by_effect(story.fits[-1], names, convention) if story.fits else []
    lines = _critical_speeds(story)
    headline = Headline("compared", verdict(story), "", found, lines, Picture.every(first or []))
    tables = _comparison_tables(story, convention)
    return Page(
        title,
        headline,
        measurement_line(story.measurement),
        [*healthy_lines(story), *findings(story)],
        tables,
        Picture.every(pictures),
        [*where, shares],
        phase=(convention or Convention()).phase,
    )
