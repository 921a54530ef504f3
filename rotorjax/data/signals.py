"""Waveform to vectors: displacement records and phase-reference pulses in, vibration vectors out.

The displacement of a probe is Re[Σ z_n e^{i n φ(t)}] + drift + noise, where the shaft angle φ is zero at a pulse and
grows by 2π to the next. Least squares over whole revolutions in φ, not in t, keeps a slowly varying speed from
smearing the orders. Every result carries its standard error.
Source: Huang et al. 2026, Sensors 26:2565, section 2.3 and Figure 7 (two laser probes at 90 degrees, 2 kHz).
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Complex, Float, Int

from rotorjax.arrays import Numbers, numpy_pair
from rotorjax.data.pulses import TURN, record_of, regular, shaft_angle
from rotorjax.units import RPM

FEWEST_REVOLUTIONS = 2
"""One revolution cannot tell a drift from an order."""
MOST_HARMONICS = 20
"""Of the rounding error of hard edges over their place between samples, which falls as one over the harmonic."""
WORST_CONDITION = 1e14
"""Of the normal equations of a fit."""
BAND = 0.4
"""Sidebands reach this far from an order, relative to the order but at most 1: short of a whirl near half the speed."""
PARTS_OF_A_TURN = 32
"""Over which the residual is summed before its sidebands are taken."""
FEWEST_SIDEBANDS, MOST_SIDEBANDS = 2, 16
"""Pairs: with fewer their scatter says too little; more would only widen the band in which noise counts as flat."""


class WaveformVectors(NamedTuple):
    """Vibration vectors of one record, with their errors and what the fit left over."""

    vectors: Complex[np.ndarray, "probe order"]
    """z [m]: displacement Re[z e^{i n φ}], zero-to-peak, phase leading."""
    covariance: Float[np.ndarray, "order 2*probe 2*probe"]
    """Of (Re z, Im z of the first probe, Re z, Im z of the second, ...) at each order [m²]."""
    sidebands: Int[np.ndarray, "order"]
    """Pairs of sidebands that the covariance is from; zero where it is from the residual's variance."""
    speed_rpm: float
    """Mean speed."""
    speed_change: float
    """Change of a linear trend of the speed from first to last pulse, relative to the mean."""
    revolutions: int
    """Whole revolutions used."""
    angle: Float[np.ndarray, "sample"]
    """Shaft angle from the first pulse [rad]; NaN outside the revolutions used."""
    residual: Float[np.ndarray, "sample probe"]
    """Displacement less orders and drift [m]; NaN outside the revolutions used."""
    constant: Float[np.ndarray, "probe"]
    """Order 0: mean displacement [m], the shaft centreline; zero where the measuring chain passes no constant."""
    constant_sigma: Float[np.ndarray, "probe"]
    """Its standard error [m]."""

    @property
    def sigma(self) -> Float[np.ndarray, "probe order"]:
        """Standard error of real and of imaginary part, their root mean square [m]: what a `Measurement` holds."""
        variance = np.diagonal(self.covariance, axis1=1, axis2=2).reshape(len(self.covariance), -1, 2)
        return np.sqrt(variance.mean(axis=-1)).T

    @property
    def residual_rms(self) -> Float[np.ndarray, "probe"]:
        """Root mean square of the residual [m]."""
        return np.sqrt(np.nanmean(self.residual**2, axis=0))


class Folded(NamedTuple):
    """A waveform over one revolution of the shaft."""

    angle_deg: Float[np.ndarray, "_"]
    """Centres of the bins, from 0 to 360 degrees."""
    mean: Float[np.ndarray, "_ probe"]
    """Mean displacement in each bin [m]; NaN where a bin is empty."""
    scatter: Float[np.ndarray, "_ probe"]
    """Standard deviation in each bin [m]; NaN below two samples."""
    samples: Int[np.ndarray, "_"]
    """Number in each bin."""


def vectors_from_waveform(
    time: Numbers,
    displacement: Numbers,
    pulses: Numbers,
    *,
    orders: Sequence[float] = (1.0,),
    drift: int = 1,
    changing: int = 0,
    pulse_error: float | None = None,
) -> WaveformVectors:
    """Vibration vectors z_n by least squares over the whole revolutions of a record.

    displacement = Σ_n (Re z_n cos nφ - Im z_n sin nφ) + polynomial in t, all orders and the drift jointly. The vectors
    are those of the mean speed; where they change with it, that is in their standard error, or is fitted as a
    polynomial in t of degree ``changing``: then they are those of the middle of the record. From five revolutions on
    (ten for a half order) the error is that of coloured noise and uncertain pulses alike; with fewer, it holds the
    residual's noise but not what the pulses got wrong. An error common to all pulses turns all vectors alike and
    leaves no scatter: it is counted only as ``pulse_error``.

    **Arguments:** ``time`` (sample) [s]; ``displacement`` (sample, probe) [m]; ``pulses`` of the phase reference [s],
    those outside the record are left out; ``orders`` to fit: name 2.0 too where a 2X is large, because record ends
    that fall between samples leak about one part in the number of samples; ``drift`` degree of the polynomial, 1 for a
    dwell: a linear drift left out leaks 1/(π n N) of its span over N revolutions into order n, a quadratic one only
    1/(π n N)²; ``changing``, 0 for a dwell; ``pulse_error`` common to all pulses [s], for edges shorter than a sample
    at most one sample / √12, by default what the places of the pulses between samples tell: just that where they are
    the same in every revolution; 0 for pulses known exactly. **Errors.** ``ValueError``, with place and cure, for
    samples not finite, shapes that do not match, time or pulses not rising, missing or double pulses, fewer than two
    whole revolutions, orders that the record cannot resolve. **Source:** Huang et al. 2026, section 2.3.
    """
    instants, waves = record_of(time, displacement, "displacement")
    marks = _within(regular(pulses), instants)
    count = len(marks) - 1
    used = (instants >= marks[0]) & (instants < marks[-1])
    _check_orders(orders, drift, changing, revolutions=count, samples=int(used.sum()))
    angle = np.where(used, shaft_angle(instants, marks), np.nan)
    design = _design(angle[used], instants[used], orders, drift, changing)
    solution = _fitted(design, waves[used], orders, count)
    residual = np.full(waves.shape, np.nan)
    residual[used] = left = waves[used] - design @ solution
    turning = np.asarray(orders, dtype=float)
    cosine, sine = np.moveaxis(solution[: 2 * len(turning)].reshape(len(turning), 2, -1), 1, 0)
    covariance, pairs = _scatter(left, design, angle[used], turning, count, changing)
    level, vectors = 2 * len(turning) * (1 + changing), (cosine - 1j * sine).T
    speed = TURN * count / (marks[-1] - marks[0])
    late = _common_pulse_error(marks, instants) if pulse_error is None else pulse_error
    return WaveformVectors(
        vectors, covariance + _of_late_pulses(vectors, speed * late * turning), pairs,
        float(speed / RPM), _speed_change(marks), count, angle, residual,
        solution[level], _constant_error(left, design, angle[used], turning, count, level),
    )  # fmt: skip


def _fitted(
    design: Float[np.ndarray, "sample _"], waves: Float[np.ndarray, "sample probe"], orders: Sequence[float], count: int
) -> Float[np.ndarray, "_ probe"]:
    """Least squares by normal equations: orders that a record resolves are nearly orthogonal, so that nothing is lost.

    **Errors.** ``ValueError`` for orders that it does not.
    """
    normal = design.T @ design
    if np.linalg.cond(normal) > WORST_CONDITION:
        raise ValueError(
            f"the orders {', '.join(f'{order:g}' for order in orders)} cannot be told apart in {count} revolutions of "
            f"{len(design) / count:.4g} samples: record longer or faster, or leave some out"
        )
    return np.linalg.solve(normal, design.T @ waves)


def _of_late_pulses(
    vectors: Complex[np.ndarray, "probe order"], angle: Float[np.ndarray, "order"]
) -> Float[np.ndarray, "order 2*probe 2*probe"]:
    """Covariance from an error common to all pulses: late by τ they turn z by the angle n Ω τ."""
    common = numpy_pair(1j * angle[:, None] * vectors.T).reshape(len(angle), -1)
    return common[:, :, None] * common[:, None, :]


def _speed_change(marks: Float[np.ndarray, "_"]) -> float:
    """Change of a linear trend of the speed from first to last pulse, relative to the mean."""
    turns, span = np.arange(float(len(marks))), [marks[0], marks[-1]]
    trend = np.polynomial.Polynomial.fit(marks, turns, 2, domain=span, window=[0.0, 1.0]).coef[2]
    return float(2.0 * trend / turns[-1])


def _scatter(
    left: np.ndarray, design: np.ndarray, angle: np.ndarray, orders: np.ndarray, count: int, changing: int
) -> tuple[np.ndarray, np.ndarray]:
    """Covariance of each order's vectors by what is left beside it, and from how many pairs of sidebands."""
    covariance, pairs = [], []
    for k, order in enumerate(orders):
        near = _sidebands(order, orders, count, changing + 1)
        pairs.append(len(near))
        if len(near):
            moved = np.empty(left.T.shape, complex)
            moved.real, moved.imag = left.T * design[:, 2 * k], -left.T * design[:, 2 * k + 1]
            covariance.append(_scatter_of_sidebands(moved, angle, near, count))
        else:
            step = order * TURN * count / len(left)
            covariance.append(_variance_of_residual(left, design, slice(2 * k, 2 * k + 2), step))
    return np.array(covariance), np.array(pairs)


def _constant_error(
    left: np.ndarray, design: np.ndarray, angle: np.ndarray, orders: np.ndarray, count: int, level: int
) -> Float[np.ndarray, "probe"]:
    """Standard error of the mean: half a Fourier coefficient near order 0 scatters as the mean does."""
    # The drift takes the slowest with it.
    near = _sidebands(0.0, orders, count, design.shape[1] - level)
    if len(near):
        both = _scatter_of_sidebands(left.T, angle, near, count)
        return 0.5 * np.sqrt(np.diagonal(both).reshape(-1, 2).sum(axis=1))
    return np.sqrt(np.diagonal(_variance_of_residual(left, design, slice(level, level + 1), 0.0))[::2])


def fold(angle: Numbers, displacement: Numbers, bins: int = 72) -> Folded:
    """Displacement over the shaft angle, all revolutions laid over one: the picture in which Y lags X by 90 degrees.

    **Arguments:** ``angle`` (sample) [rad], NaN where it is unknown; ``displacement`` (sample, probe) [m]; ``bins``
    from 0 to 360 degrees. A bin's mean shows sin(x)/x of order n, x = π n / bins: 0.03 % less at 1X with 72 bins;
    its scatter holds the waveform's slope across the bin besides the noise. **Returns** `Folded`.
    **Errors.** ``ValueError`` for shapes that do not match, no known angle, or fewer than one bin.
    **Source:** Huang et al. 2026, Figure 7b.
    """
    turned, waves = np.asarray(angle, dtype=float), np.asarray(displacement, dtype=float)
    if turned.ndim != 1 or waves.ndim != 2 or len(turned) != len(waves):
        raise ValueError(
            f"angle must have shape (sample,) and displacement (sample, probe); they have {turned.shape} and "
            f"{waves.shape}"
        )
    known = np.isfinite(turned)
    if bins < 1 or not known.any():
        raise ValueError(
            f"folding needs at least one bin and one known angle; there are {bins} and {known.sum()}: take the angle "
            "from shaft_angle"
        )
    turned, waves = turned[known], waves[known]
    index = np.floor(turned / TURN % 1.0 * bins).astype(int) % bins
    count = np.bincount(index, minlength=bins)

    def total(columns: np.ndarray) -> np.ndarray:
        return np.stack([np.bincount(index, column, minlength=bins) for column in columns.T], axis=1)

    mean = total(waves) / np.where(count > 0, count, np.nan)[:, None]
    scatter = np.sqrt(total((waves - mean[index]) ** 2) / np.where(count > 1, count - 1.0, np.nan)[:, None])
    return Folded((np.arange(bins) + 0.5) * 360.0 / bins, mean, scatter, count)


def _common_pulse_error(marks: Float[np.ndarray, "_"], time: Float[np.ndarray, "sample"]) -> float:
    """Standard error of the mean of the pulses [s] where edges are shorter than a sample: one sample / √12 for each,
    less for their mean where places differ. How short edges are is seen from the pulses as they were found: those of
    short edges all stand at one place between samples, the middle.
    """
    step = float(time[-1] - time[0]) / (len(time) - 1)
    short = float(np.abs(np.mean(np.exp(2j * np.pi * marks / step))))
    return step / np.sqrt(12.0) * short * common_share(marks, step)


def common_share(marks: Float[np.ndarray, "_"], step: float) -> float:
    """Standard error of the mean of the pulses over that of one of them, for errors that depend on where between two
    samples a pulse falls.

    A short edge is put in the middle of its sample, wherever in it it was: late by (1/2 - x) steps for a place x from 0
    to 1, a sawtooth of Fourier coefficients 1/(2πm). Its mean over the pulses is Σ_m |R_m|² / (2π²m²) in mean square,
    R_m = mean of e^{2πi m x} over places x that a smoothly turning shaft has: 1/12 where all are alike, as with a whole
    number of samples per revolution; little where the places change.
    """
    count = np.linspace(-1.0, 1.0, len(marks))
    smooth = np.polynomial.Polynomial.fit(count, marks, min(2, len(marks) - 1))(count)
    harmonic = np.arange(1, MOST_HARMONICS + 1)
    alike = np.abs(np.mean(np.exp(2j * np.pi * harmonic[:, None] * smooth / step), axis=1))
    return float(np.sqrt(np.sum((alike / harmonic) ** 2) / np.sum(1.0 / harmonic**2)))


def _within(pulses: Float[np.ndarray, "_"], time: Float[np.ndarray, "sample"]) -> Float[np.ndarray, "_"]:
    """The pulses that the record spans, to within a sample, if they bound enough revolutions."""
    step = float(np.median(np.diff(time)))
    marks = pulses[(pulses >= time[0] - step) & (pulses <= time[-1] + step)]
    if len(marks) <= FEWEST_REVOLUTIONS:
        raise ValueError(
            f"a record must hold at least {FEWEST_REVOLUTIONS} whole revolutions, {FEWEST_REVOLUTIONS + 1} pulses; "
            f"this one holds {len(marks)} pulse(s) "
            f"from t = {time[0]:.6g} to {time[-1]:.6g} s: record longer, or check that pulses and samples share one "
            "clock"
        )
    return marks


def _check_orders(orders: Sequence[float], drift: int, changing: int, *, revolutions: int, samples: int) -> None:
    """Refuse what the record cannot resolve."""
    known = np.sort(np.asarray(orders, dtype=float))
    if known.ndim != 1 or not len(known) or not np.all(np.isfinite(known)) or known[0] <= 0.0:
        raise ValueError(
            f"orders must be positive numbers, at least one; they are {list(orders)}: order 0 is the constant, which "
            "is always fitted"
        )
    if not 0 <= drift <= revolutions:
        raise ValueError(
            f"drift must be a polynomial degree from 0 to the {revolutions} revolutions of the record; it is {drift}: "
            "1 is good for a dwell"
        )
    apart = np.diff(known, prepend=0.0)
    if np.any(apart * revolutions < 1.0 - 1e-9):
        k = int(np.argmin(apart))
        low = f"{known[k - 1]:g}" if k else "0"
        raise ValueError(
            f"orders {low} and {known[k]:g} must be one period apart over the record, 1/{revolutions} for "
            f"{revolutions} revolutions: "
            "leave one out, or record longer"
        )
    each = samples / revolutions
    if known[-1] >= 0.5 * each:
        raise ValueError(
            f"order {known[-1]:g} needs more than {2.0 * known[-1]:g} samples per revolution; the record has "
            f"{each:.4g}: sample faster, or leave it out"
        )
    unknowns = 2 * len(known) * (1 + changing) + drift + 1
    if samples <= unknowns:
        raise ValueError(
            f"{unknowns} unknowns need more than the {samples} samples of the whole revolutions: record longer, or fit "
            "fewer orders"
        )


def _design(
    angle: Float[np.ndarray, "sample"],
    time: Float[np.ndarray, "sample"],
    orders: Sequence[float],
    drift: int,
    changing: int,
) -> Float[np.ndarray, "sample _"]:
    """Columns cos and sin of each order, the same times powers of time from the middle of the record up to
    ``changing``, then Legendre polynomials of time over the record.
    """
    scaled = 2.0 * (time - time[0]) / (time[-1] - time[0]) - 1.0
    waves = numpy_pair(np.stack(_turned(angle, orders), axis=1)).reshape(len(angle), -1)
    powers = [waves * scaled[:, None] ** k for k in range(1, changing + 1)]
    return np.concatenate([waves, *powers, np.polynomial.legendre.legvander(scaled, drift)], axis=1)


def _turned(angle: Float[np.ndarray, "sample"], orders: Sequence[float]) -> list[Complex[np.ndarray, "sample"]]:
    """e^{i n φ} of every order n; whole ones as powers of the first, which costs a tenth."""
    whole = {order for order in orders if float(order).is_integer()}
    found = {order: _cis(order * angle) for order in orders if order not in whole}
    once = power = _cis(angle)
    for n in range(1, int(max(whole, default=0.0)) + 1):
        found |= {n: power} if n in whole else {}
        power = power * once
    return [found[order] for order in orders]


def _cis(phase: Float[np.ndarray, "sample"]) -> Complex[np.ndarray, "sample"]:
    """e^{i phase}, in half the time that the exponential function of a complex number takes."""
    return np.stack([np.cos(phase), np.sin(phase)], axis=-1).view(complex)[:, 0]


def _sidebands(
    order: float, orders: Float[np.ndarray, "order"], revolutions: int, first: int = 1
) -> Int[np.ndarray, "_"]:
    """Offsets k of the sidebands order ± k / revolutions that hold noise alone, from the ``first`` that the fit leaves;
    none where they are too few.
    """
    offsets = np.arange(first, int(BAND * (min(order, 1.0) or 1.0) * revolutions) + 1)
    # A harmonic that was not fitted is no noise either.
    others = np.concatenate([orders, np.arange(np.ceil(order) + 2.0)])
    others = others[np.abs(others - order) * revolutions > 0.5]
    both = order + np.stack([offsets, -offsets])[..., None] / revolutions
    free = np.all(np.abs(both - others) * revolutions > 0.99, axis=(0, 2))
    offsets = offsets[free][:MOST_SIDEBANDS]
    return offsets if len(offsets) >= FEWEST_SIDEBANDS else offsets[:0]


def _scatter_of_sidebands(
    moved: Complex[np.ndarray, "probe sample"] | Float[np.ndarray, "probe sample"],
    angle: Float[np.ndarray, "sample"],
    offsets: Int[np.ndarray, "_"],
    revolutions: int,
) -> Float[np.ndarray, "2*probe 2*probe"]:
    """Covariance of (Re z, Im z) of every probe from the residual's Fourier coefficients beside the order.

    Over N whole revolutions the coefficients at order ± k/N are as scattered as that at the order itself where the
    noise spectrum is flat across them, whatever it is elsewhere: white and coloured noise, and the sidebands that
    uncertain pulses and a varying vector make, are all counted. It does what the scatter of blocks of revolutions
    does, without the leak of low frequencies into short blocks. With b(φ) e^{i n φ} the residual, c_k the
    coefficient of b: those of Re b and Im b are (c_k + c̄_-k)/2 and (c_k - c̄_-k)/2i.

    **Arguments:** ``moved``: the residual times e^{-i n φ}. It is summed over 1/32 of a turn first, across which a
    sideband turns by some five degrees at most: coefficients come out a few parts in 10,000 too small.
    """
    width = TURN / PARTS_OF_A_TURN
    edges = np.arange(angle[0], angle[-1], width)
    first = np.unique(np.searchsorted(angle, edges))
    sums = np.add.reduceat(moved, first, axis=1)
    middle = angle[0] + width * (np.floor((angle[first] - angle[0]) / width) + 0.5)
    # Sidebands are powers of the first.
    each = np.broadcast_to(_cis(-middle / revolutions), (int(offsets[-1]), len(middle)))
    turn = np.multiply.accumulate(each, axis=0)[offsets - 1].T
    upper, lower = ((2.0 / len(angle) * (sums @ side)).T for side in (turn, turn.conj()))
    parts = np.stack([0.5 * (upper + lower.conj()), -0.5j * (upper - lower.conj())], axis=-1).reshape(len(offsets), -1)
    freedoms = 2 * len(offsets)
    # The variance of Student's t: an error in units of an estimated standard error scatters by more than one.
    return np.real(parts.conj().T @ parts) / len(offsets) * freedoms / (freedoms - 2)


def _variance_of_residual(
    residual: Float[np.ndarray, "sample probe"], design: Float[np.ndarray, "sample _"], columns: slice, step: float
) -> Float[np.ndarray, "2*probe 2*probe"]:
    """The same for few revolutions: least squares with the residual's variance, as noise of first order.

    A first-order autoregression with correlation a has, at ``step`` radians of the order per sample, the density
    (1 - a²)/(1 + a² - 2a cos step) times that of white noise; below one it is not believed.
    """
    spread = residual.T @ residual / (len(residual) - design.shape[1])
    power = np.sum(residual**2, axis=0)
    product = np.sum(residual[1:] * residual[:-1], axis=0)
    a = np.divide(product, power, out=np.zeros_like(power), where=power > 0.0)
    colour = np.sqrt(np.maximum((1.0 - a**2) / (1.0 + a**2 - 2.0 * a * np.cos(step)), 1.0))
    sign = np.array([1.0, -1.0])  # Im z is minus the coefficient of the sine
    unit = sign[:, None] * np.linalg.inv(design.T @ design)[columns, columns] * sign
    return np.kron(spread * colour[:, None] * colour, unit)
