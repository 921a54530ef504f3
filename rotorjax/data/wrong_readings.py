"""Single readings that do not agree with all others: a decimal point, a sign or a digit, or a line copied wrongly."""

import cmath
import dataclasses
import math
from collections.abc import Iterable
from functools import partial

import numpy as np
from jaxtyping import Complex

from rotorjax.data.declarations import KINDS, MIL, Mistake, Stated
from rotorjax.data.measurement import Measurement
from rotorjax.model.model import Model

WRONG = "wrong_reading"
"""Kind of the mistake."""
MOST_WRONG = 3
"""Readings that may be wrong at once."""
NEAR_TURN, NEAR_FACTOR = math.radians(5.0), 0.05
"""How near a difference of phase is to half a turn, and a ratio of amplitudes to a likely one, to be called that."""
LIKELY = ((10.0, "a decimal point"), (100.0, "a decimal point"), (MIL, "mil"))
"""Ratios of amplitudes, one over them too, and where they may come from."""

Cell = tuple[int, int, int]
"""Case, probe and order of one vector."""


def wrong_readings(m: Measurement, cells: Iterable[Cell]) -> Mistake:
    """That some readings are wrong: beside it they count as if their standard error were as large as the vectors."""
    places = tuple(sorted(cells))
    return Mistake(WRONG, _about(m, places), *_told(m, places), partial(_with_doubt, cells=places))


def every_wrong_reading(m: Measurement, kinds: Iterable[str] = KINDS) -> list[Mistake]:
    """The same of each reading by itself, left out."""
    if WRONG not in kinds:
        return []
    cells: list[Cell] = [(int(case), int(probe), int(order)) for case, probe, order in np.argwhere(m.present)]
    return [_left_out(m, (cell,), *_told(m, (cell,))) for cell in cells]


def with_ratios(mistake: Mistake, m: Measurement, shown: Complex[np.ndarray, "case probe order"]) -> Mistake:
    """The same with what the readings should be beside everything else, left out of the measurement. **Arguments:**
    ``shown`` by the model fitted.
    """
    cells = cells_of(mistake)
    sign = m.half_order_sign(np.where(np.isfinite(shown), shown, 0.0))
    said = [_compared(m, cell, complex((m.vectors * sign)[cell]), complex(shown[cell])) for cell in cells]
    return _left_out(m, cells, f"{_readings(m, cells)} {'; '.join(said)}", _cure(m, cells))


def log_odds_of(m: Measurement, cells: Iterable[Cell], odds: float) -> float:
    """Logarithm of the prior odds. **Arguments:** ``odds`` of the kind, which all readings share."""
    return math.log(odds) - len(tuple(cells)) * math.log(float(np.count_nonzero(m.present)))


def doubt(m: Measurement, cells: Iterable[Cell]) -> Measurement:
    """With readings that may be anything as large as was measured."""
    deviation = np.zeros(m.vectors.shape)
    for cell in cells:
        deviation[cell] = max(abs(complex(m.vectors[cell])), m.rms)
    return dataclasses.replace(m, doubted=deviation)


def _left_out(m: Measurement, cells: tuple[Cell, ...], meaning: str, cure: str) -> Mistake:
    return Mistake(WRONG, _about(m, cells), meaning, cure, partial(_without, cells=cells))


def cells_of(mistake: Mistake) -> tuple[Cell, ...]:
    """Readings that are called wrong."""
    assert isinstance(mistake.corrected, partial)
    return mistake.corrected.keywords["cells"]


def _with_doubt(model: Model, m: Measurement, *, cells: tuple[Cell, ...]) -> Stated:
    return model, doubt(m, cells)


def _without(model: Model, m: Measurement, *, cells: tuple[Cell, ...]) -> Stated:
    present = m.present.copy()
    for cell in cells:
        present[cell] = False
    return model, dataclasses.replace(m, present=present, vectors=np.where(present, m.vectors, 0.0), doubted=None)


def _about(m: Measurement, cells: tuple[Cell, ...]) -> tuple[str, ...]:
    """One word for each: run, speed to the rpm, probe, the order if there are several, and what tells it from another
    reading of that name.
    """
    rounded = np.round(m.speed_rpm)
    words = []
    for case, probe, order in cells:
        parts = [m.runs[m.run[case]], f"{rounded[case]:.0f}rpm", m.probes[probe]]
        parts += [f"{m.orders[order]:g}X"] if len(m.orders) > 1 else []
        alike = np.flatnonzero((m.run == m.run[case]) & (rounded == rounded[case]))
        parts += [f"{int(np.flatnonzero(alike == case)[0]) + 1}"] if len(alike) > 1 else []
        words.append(".".join(parts))
    return tuple(words)


def _told(m: Measurement, cells: tuple[Cell, ...]) -> tuple[str, str]:
    does = "does" if len(cells) == 1 else "do"
    return f"{_readings(m, cells)} {does} not agree with all others", _cure(m, cells)


def _readings(m: Measurement, cells: tuple[Cell, ...]) -> str:
    places = [
        f"probe {m.probes[probe]} in run {m.runs[m.run[case]]} at {m.speed_rpm[case]:.6g} rpm"
        + (f" ({m.orders[order]:g}X)" if len(m.orders) > 1 else "")
        for case, probe, order in cells
    ]
    return f"the {'reading' if len(cells) == 1 else 'readings'} of {' and of '.join(places)}"


def _cure(m: Measurement, cells: tuple[Cell, ...]) -> str:
    lines = "that line" if len(cells) == 1 else f"those {len(cells)} lines"
    return f"the table: check {lines} against the record, measure again, or leave {lines} out"


def _compared(m: Measurement, cell: Cell, measured: complex, shown: complex) -> str:
    """A reading beside what it should be: neither ratio nor difference depends on conventions."""
    if not abs(shown) > 0.0 or measured == 0.0:
        return "does not agree with all others"
    ratio, turn = abs(measured / shown), abs(cmath.phase(measured / shown))
    hint = next((f" ({words}?)" for by, words in LIKELY if abs(math.log(ratio * by)) < NEAR_FACTOR), "")
    hint = next((f" ({words}?)" for by, words in LIKELY if abs(math.log(ratio / by)) < NEAR_FACTOR), hint)
    half = " (a sign?)" if math.pi - turn < NEAR_TURN and m.orders[cell[2]] != 0.0 else ""
    return (
        f"is {ratio:.3g} times{hint} what all others lead to, its phase {math.degrees(turn):.3g}°{half} off"
        if m.orders[cell[2]] != 0.0
        else f"is {ratio:.3g} times{hint} what all others lead to"
    )
