"""Waveform to features: known motion in, vectors, errors and refusals out.

Records are made from a shaft angle known in closed form, its pulses solved from a quadratic, or from the rotor's
equations of motion integrated in time; none of it is the package's own code.
"""

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.signal import lfilter

from rotorjax.data.pulses import pulse_times, shaft_angle
from rotorjax.data.signals import fold, vectors_from_waveform
from rotorjax.diagnosis.features import features_from_waveform

RATE = 2000.0
"""Sampling rate of the paper's recorder [Hz]."""
Z = np.array([60e-6 * np.exp(-0.5j), 70e-6 * np.exp(-2.1j)])
F = np.array([Z[0].real, -Z[0].imag, Z[1].real, -Z[1].imag])


class Sweep:
    """A shaft whose speed changes linearly: φ = φ0 + ω0 t + a t²/2, in closed form."""

    def __init__(self, revolutions, *, rpm=1500.0, change=0.0, before=1.0, rate=RATE):
        mean = rpm * 2 * np.pi / 60
        span = (2 * np.pi * revolutions + before + 1.0) / mean
        self.start, self.rate, self.before = mean * (1 - change / 2), mean * change / span, before
        self.time = np.arange(0.0, span, 1 / rate)
        self.pulses = self.instants(2 * np.pi * np.arange(revolutions + 1) + before)

    def instants(self, turned):
        """When the shaft has turned this far since t = 0: the root of a quadratic, in the form that survives a = 0."""
        return 2 * turned / (self.start + np.sqrt(self.start**2 + 2 * self.rate * turned))

    def angle(self, time):
        return self.start * time + 0.5 * self.rate * time**2 - self.before

    def speed(self, time):
        return self.start + self.rate * time

    def wave(self, vectors=Z, order=1.0):
        return np.real(vectors * np.exp(1j * order * self.angle(self.time))[:, None])


def coloured(rng, samples, correlation, probes=2):
    """First-order autoregression of unit variance."""
    white = rng.standard_normal((samples + 400, probes))
    return lfilter([np.sqrt(1 - correlation**2)], [1.0, -correlation], white, axis=0)[400:]


# Vectors and features


def test_phase_convention():
    """A cosine that peaks 30 degrees of shaft angle after the pulse lags: its phase is -30 degrees."""
    sweep = Sweep(2)
    wave = 1e-5 * np.cos(sweep.angle(sweep.time) - np.radians(30.0))
    fit = vectors_from_waveform(sweep.time, wave[:, None], sweep.pulses)
    np.testing.assert_allclose(fit.vectors, [[1e-5 * np.exp(-1j * np.radians(30.0))]], rtol=1e-12)
    assert fit.vectors.shape == (1, 1)
    assert fit.vectors.dtype == complex
    assert fit.revolutions == 2
    assert fit.speed_rpm == pytest.approx(1500.0, rel=1e-12)
    assert fit.speed_change == pytest.approx(0.0, abs=1e-12)


def test_exact_without_noise_at_a_varying_speed():
    """Orders, half an order among them, and a quadratic drift come apart to the spline's accuracy, 5 %
    of speed change.
    """
    sweep = Sweep(40, change=0.05)
    sub, twice = np.array([5e-6, 3e-6j]), np.array([8e-6 * np.exp(2j), 2e-6])
    drift = 1e-4 * np.outer(sweep.time**2, [1.0, -2.0]) + 3e-4
    wave = sweep.wave() + sweep.wave(sub, 0.5) + sweep.wave(twice, 2.0) + drift
    fit = vectors_from_waveform(sweep.time, wave, sweep.pulses, orders=(1.0, 0.5, 2.0), drift=2)
    np.testing.assert_allclose(fit.vectors, np.stack([Z, sub, twice], axis=1), atol=1e-14)
    assert np.all(fit.residual_rms < 1e-14)
    assert fit.speed_change == pytest.approx(0.05 * 2 * np.pi * 40 / (2 * np.pi * 40 + 2.0), rel=1e-3)
    inside = (sweep.time >= sweep.pulses[0]) & (sweep.time < sweep.pulses[-1])
    np.testing.assert_array_equal(np.isfinite(fit.angle), inside)
    np.testing.assert_allclose(fit.angle[inside], sweep.angle(sweep.time[inside]), atol=1e-9)


def test_a_drift_left_out_leaks_as_documented():
    sweep, span = Sweep(20), 100e-6
    part = (sweep.time - sweep.pulses[0]) / (sweep.pulses[-1] - sweep.pulses[0])

    def leak(power, degree):
        fit = vectors_from_waveform(
            sweep.time, sweep.wave() + span * part[:, None] ** power, sweep.pulses, drift=degree
        )
        return np.abs(fit.vectors[:, 0] - Z)

    np.testing.assert_allclose(leak(1, 0), span / (np.pi * 20), rtol=0.05)
    np.testing.assert_allclose(leak(2, 1), span / (np.pi * 20) ** 2, rtol=0.1)
    assert np.all(leak(2, 2) < 1e-14)


def test_features_are_those_of_the_vectors():
    sweep = Sweep(30)
    found = features_from_waveform(sweep.time, sweep.wave(), sweep.pulses)
    np.testing.assert_allclose(found.features, F, rtol=1e-10)
    u = found.features[0] * np.cos(0.7) + found.features[1] * np.sin(0.7)
    assert u == pytest.approx(np.real(Z[0] * np.exp(0.7j)), rel=1e-10)
    assert found.fit.vectors.shape == (2, 1)


@pytest.mark.parametrize("change", [0.0, 0.01])
def test_jeffcott_rotor_integrated_in_time(change, rng):
    """Equations of motion at a slowly rising speed, a noisy reference channel, coloured noise and drift: the whole
    chain.
    """
    mass, stiffness = 0.9686, np.array([56538.0, 51282.0])
    damping = 2 * 0.03 * np.sqrt(stiffness * mass)
    unbalance, bow = (
        40e-6 * np.exp(0.4j),
        30e-6 * np.exp(-1.0j),
    )  # U [kg m] and bow [m], their angle counted from the pulse
    sweep = Sweep(60, change=change)

    def force(angle, speed):
        turned_u, turned_b = (v * np.exp(1j * angle) for v in (unbalance * speed**2, bow))
        return np.array([turned_u.real, turned_u.imag]) + stiffness * np.array([turned_b.real, turned_b.imag])

    def rates(t, state):
        return np.concatenate(
            [state[2:], (force(sweep.angle(t), sweep.speed(t)) - damping * state[2:] - stiffness * state[:2]) / mass]
        )

    def steady(speed):
        # Along y the force is -i times that along x: its peak comes a quarter turn later.
        return (
            np.array([1.0, -1j])
            * (unbalance * speed**2 + stiffness * bow)
            / (stiffness - mass * speed**2 + 1j * damping * speed)
        )

    start = steady(sweep.speed(0.0)) * np.exp(1j * sweep.angle(0.0))
    state = np.concatenate([start.real, (1j * sweep.speed(0.0) * start).real])
    motion = (
        solve_ivp(rates, (0.0, sweep.time[-1]), state, t_eval=sweep.time, method="DOP853", rtol=1e-8, atol=1e-12)
        .y[:2]
        .T
    )
    recorded = motion + 1e-6 * coloured(rng, len(sweep.time), 0.8) + 2e-5 * sweep.time[:, None] + 1e-4
    reference = smooth_pulse(sweep.angle(sweep.time)) + 0.02 * rng.standard_normal(len(sweep.time))
    found = features_from_waveform(sweep.time, recorded, pulse_times(sweep.time, reference), pulse_error=0.0)
    # Half of a smooth pulse's height is at the angle zero, so the pulses' phase is that of the sweep.
    z = steady(sweep.speed(0.5 * sweep.time[-1]))
    truth = np.array([z[0].real, -z[0].imag, z[1].real, -z[1].imag])
    assert np.all(np.abs(found.features - truth) < 4 * found.standard_error)
    assert np.all(found.standard_error < 0.5e-6)
    assert np.all(np.abs(found.features - truth) < 0.7e-6)


# Standard errors


def standardised(rng, correlation, *, revolutions, jitter=0.0, draws=150):
    """(estimate - truth) / standard error over many seeds, and root mean square error."""
    sweep = Sweep(revolutions, change=0.02)
    wave, errors, units = sweep.wave(), [], []
    for _ in range(draws):
        pulses = sweep.pulses + jitter * rng.standard_normal(len(sweep.pulses))
        found = features_from_waveform(
            sweep.time, wave + 1e-6 * coloured(rng, len(sweep.time), correlation), pulses, pulse_error=0.0
        )
        errors.append(found.features - F)
        units.append(errors[-1] / found.standard_error)
    return np.array(units), np.sqrt(np.mean(np.square(errors)))


@pytest.mark.parametrize(
    ("correlation", "revolutions", "jitter", "low", "high"),
    [
        (0.0, 3, 0.0, 0.9, 1.1),
        (0.0, 6, 0.0, 0.85, 1.15),
        (0.0, 12, 0.0, 0.9, 1.1),
        (0.0, 40, 0.0, 0.9, 1.1),
        (0.9, 4, 0.0, 0.9, 1.35),  # a handful of revolutions hardly show a correlation over a third of one
        (0.9, 12, 0.0, 0.9, 1.15),
        (0.9, 40, 0.0, 0.9, 1.1),
        (0.98, 40, 0.0, 0.8, 1.1),
        (0.0, 20, 1e-4, 0.9, 1.15),  # pulses uncertain by a fifth of a sample, seven times the noise's share
    ],
)
def test_standard_errors_are_calibrated(correlation, revolutions, jitter, low, high, rng):
    units, _ = standardised(rng, correlation, revolutions=revolutions, jitter=jitter)
    assert low < units.std() < high
    assert abs(units.mean()) < 0.2


def test_white_noise_error_is_the_bound(rng):
    """2 σ² / M for each part: no unbiased estimate does better."""
    sweep = Sweep(40)
    _, error = standardised(rng, 0.0, revolutions=40, draws=100)
    assert error == pytest.approx(1e-6 * np.sqrt(2 / (40 * 80)), rel=0.1)
    found = features_from_waveform(sweep.time, sweep.wave() + 1e-6 * coloured(rng, len(sweep.time), 0.0), sweep.pulses)
    assert found.fit.sidebands.tolist() == [16]
    np.testing.assert_allclose(found.fit.residual_rms, 1e-6, rtol=0.05)
    np.testing.assert_allclose(found.fit.sigma[:, 0] ** 2, np.mean(found.standard_error.reshape(2, 2) ** 2, axis=1))


def test_pulse_errors_are_common_to_both_probes(rng):
    """A late pulse turns both vectors alike: the covariance says so where independent errors would not."""
    sweep = Sweep(40)
    pulses = sweep.pulses + 1e-4 * rng.standard_normal(len(sweep.pulses))
    c = vectors_from_waveform(sweep.time, sweep.wave(), pulses).covariance[0]
    along = np.array([(1j * z).real if part == 0 else (1j * z).imag for z in Z for part in (0, 1)])
    along /= np.linalg.norm(along)
    assert along @ c @ along > 0.97 * np.trace(c)


def test_an_error_common_to_all_pulses_must_be_named(rng):
    """Hard edges at 80 samples per revolution are all late alike: nothing scatters, and by default a sample is allowed
    for.
    """
    blind, told = [], []
    for _ in range(150):
        sweep = Sweep(20, before=rng.uniform(0.5, 1.5))
        pulses = pulse_times(sweep.time, (sweep.angle(sweep.time) % (2 * np.pi) < 0.3).astype(float))
        recorded = sweep.wave() + 0.1e-6 * coloured(rng, len(sweep.time), 0.0)
        for units, error in ((blind, 0.0), (told, None)):
            found = features_from_waveform(sweep.time, recorded, pulses, pulse_error=error)
            units.append((found.features - F) / found.standard_error)
    assert np.std(blind) > 10.0
    assert 0.85 < np.std(told) < 1.15


def test_a_harmonic_not_fitted_is_no_noise(rng):
    """2X stays out of the sidebands of 1X, and a fitted neighbour out of those of its neighbour."""
    sweep = Sweep(40)
    noise = 1e-6 * coloured(rng, len(sweep.time), 0.0)
    plain = vectors_from_waveform(sweep.time, sweep.wave() + noise, sweep.pulses)
    other = vectors_from_waveform(sweep.time, sweep.wave() + sweep.wave(Z, 2.0) + noise, sweep.pulses)
    np.testing.assert_allclose(other.sigma, plain.sigma, rtol=0.1)
    np.testing.assert_allclose(other.vectors, plain.vectors, atol=1e-7)
    whirl = sweep.wave(Z, 0.9) + sweep.wave() + noise
    both = vectors_from_waveform(sweep.time, whirl, sweep.pulses, orders=(0.9, 1.0))
    np.testing.assert_allclose(both.sigma, np.repeat(plain.sigma, 2, axis=1), rtol=0.4)


# Pulses and angle


def smooth_pulse(angle, width=2.0):
    """A pulse with edges of a third of a radian, as a band-limited recorder shows it; half its height at angle zero."""
    turned = (angle + np.pi) % (2 * np.pi) - np.pi
    return 0.5 * (np.tanh(turned / 0.15) - np.tanh((turned - width) / 0.15))


def test_pulses_within_hundredths_of_a_sample():
    sweep = Sweep(30, change=0.03)
    found = pulse_times(sweep.time, 5.0 * smooth_pulse(sweep.angle(sweep.time)) - 1.0, threshold=1.5)
    assert len(found) == 31
    assert np.max(np.abs(found - sweep.pulses)) * RATE < 0.03
    automatic = pulse_times(sweep.time, 5.0 * smooth_pulse(sweep.angle(sweep.time)) - 1.0)
    assert np.max(np.abs(automatic - sweep.pulses)) * RATE < 0.03


def test_hard_edges_are_known_to_half_a_sample():
    sweep = Sweep(30, change=0.03)
    phase = sweep.angle(sweep.time) % (2 * np.pi)
    late = pulse_times(sweep.time, (phase < 0.2).astype(float)) - sweep.pulses
    assert np.max(np.abs(late)) * RATE <= 0.5 + 1e-9
    assert abs(np.mean(late)) * RATE < 0.15
    falling = pulse_times(sweep.time, (phase >= 0.2).astype(float), edge="falling")
    np.testing.assert_allclose(falling - sweep.pulses, late, atol=1e-12)


def test_noise_on_an_edge_counts_once(rng):
    """A slow edge with noise crosses the threshold many times, and a spike is no level."""
    sweep = Sweep(50, rate=50 * RATE)
    channel = smooth_pulse(sweep.angle(sweep.time)) + 0.05 * rng.standard_normal(len(sweep.time))
    crossings = np.sum((channel[:-1] < 0.5) & (channel[1:] >= 0.5))
    channel[len(channel) // 3] = 40.0
    found = pulse_times(sweep.time, channel, threshold=0.5)
    assert crossings > 100
    assert len(found) == 51 + 1, "the spike is a pulse of its own, for the angle to refuse"
    channel[len(channel) // 3] = -40.0
    found = pulse_times(sweep.time, channel)
    assert len(found) == 51
    assert np.max(np.abs(found - sweep.pulses)) < 3e-4


@pytest.mark.parametrize("spike", [0.0, -40.0, 12.0])
def test_pulses_of_a_thousandth_of_a_turn_may_rise_or_fall(spike):
    time = np.arange(3 * 25600) / 25600.0
    channel = 5.0 * ((10.3 * time + 0.3) % 1.0 < 0.001)
    channel[1000] = spike
    found = pulse_times(time, channel)
    np.testing.assert_allclose(found[-31:], (np.arange(1, 32) - 0.3) / 10.3, atol=1.0 / 25600.0)
    np.testing.assert_array_equal(pulse_times(time, 5.0 - channel, edge="falling"), found)


def test_integers_and_lists_are_taken():
    times = [0.1 * k for k in range(12)]
    np.testing.assert_allclose(pulse_times(times, [0, 0, 4, 4] * 3), [0.15, 0.55, 0.95])


def test_angle_by_pulse_counts():
    """Straight between two pulses, a parabola through three, and no angle outside."""
    np.testing.assert_allclose(
        shaft_angle([0.0, 1.0, 1.5, 2.0, 2.1], [1.0, 2.0]), [np.nan, 0.0, np.pi, 2 * np.pi, np.nan]
    )
    sweep = Sweep(2, change=0.2)
    found = shaft_angle(sweep.time, sweep.pulses)
    inside = np.isfinite(found)
    assert np.max(np.abs(found - sweep.angle(sweep.time))[inside]) < 3e-3
    long = Sweep(30, change=0.2)
    found = shaft_angle(long.time, long.pulses)
    inside = np.isfinite(found)
    assert np.max(np.abs(found - long.angle(long.time))[inside]) < 1e-6


def test_angle_always_rises(rng):
    """Also where the periods jump so that a cubic spline would turn back."""
    tried = 0
    for _ in range(300):
        pulses = np.concatenate([[0.0], np.cumsum(np.exp(rng.choice([-0.4, 0.4], rng.integers(1, 9))))])
        try:
            angle = shaft_angle(np.linspace(0.0, pulses[-1], 400), pulses)
        except ValueError:
            continue
        tried += 1
        assert np.all(np.diff(angle) > 0.0)
    assert tried > 100


def test_a_run_up_has_no_broken_pulses():
    """From 600 to 3000 rpm the period falls fivefold, yet slowly."""
    sweep = Sweep(60, rpm=1800.0, change=4 / 3)
    assert np.all(
        np.diff(shaft_angle(sweep.time, sweep.pulses)[np.isfinite(shaft_angle(sweep.time, sweep.pulses))]) > 0.0
    )


# The phase picture


def test_fold_shows_y_a_quarter_turn_behind_x(rng):
    sweep = Sweep(60)
    wave = sweep.wave(np.array([50e-6, -50e-6j])) + 1e-6 * rng.standard_normal((len(sweep.time), 2))
    folded = fold(shaft_angle(sweep.time, sweep.pulses), wave, 36)
    assert folded.mean.shape == (36, 2)
    np.testing.assert_allclose(folded.angle_deg[[0, -1]], [5.0, 355.0])
    # The centre of gravity of the first harmonic, rather than the highest bin.
    turned = np.exp(1j * np.radians(folded.angle_deg)) @ folded.mean
    assert np.degrees(np.angle(turned[1] / turned[0])) == pytest.approx(90.0, abs=0.5)
    np.testing.assert_allclose(folded.mean[:, 0], 50e-6 * np.cos(np.radians(folded.angle_deg)), atol=1.5e-6)
    # At the crest only the noise scatters.
    assert folded.scatter[0, 0] == pytest.approx(1.2e-6, rel=0.3)
    assert folded.samples.sum() == np.isfinite(shaft_angle(sweep.time, sweep.pulses)).sum()


def test_fold_leaves_empty_bins_open():
    folded = fold([0.0, 0.1, np.nan, 2 * np.pi], np.array([[1.0], [3.0], [9.0], [5.0]]), 4)
    np.testing.assert_allclose(folded.mean[:, 0], [3.0, np.nan, np.nan, np.nan])
    np.testing.assert_allclose(folded.scatter[:, 0], [2.0, np.nan, np.nan, np.nan])
    np.testing.assert_array_equal(folded.samples, [3, 0, 0, 0])
    with pytest.raises(
        ValueError,
        match=r"angle must have shape \(sample,\) and displacement \(sample, probe\); they have \(2,\) and \(3, 1\)",
    ):
        fold([0.0, 1.0], np.zeros((3, 1)))
    with pytest.raises(ValueError, match="at least one bin and one known angle"):
        fold([np.nan], np.zeros((1, 1)))


# Refusals


def refused(match, *, time=None, wave=None, pulses=None, **settings):
    sweep = Sweep(8)
    with pytest.raises(ValueError, match=match):
        vectors_from_waveform(
            sweep.time if time is None else time,
            sweep.wave() if wave is None else wave,
            sweep.pulses if pulses is None else pulses,
            **settings,
        )


def test_records_that_do_not_fit_together():
    sweep = Sweep(8)
    broken, early = sweep.wave(), sweep.time.copy()
    broken[100, 1], early[7] = np.nan, early[3]
    refused(
        r"displacement must have one row per sample; it has shape \(2, \d+\) beside \d+ times: take both",
        wave=sweep.wave().T,
    )
    refused(r"displacement\[:, None\] for a single probe", wave=sweep.wave()[:, 0])
    refused(r"displacement must be finite; column 1 is not at t = 0.05 s: cut the record", wave=broken)
    refused(r"time must rise; entry 7 = 0.0015 s does not: sort the record", time=early)
    refused(r"time must be finite; entry 2 is not", time=np.where(np.arange(len(early)) == 2, np.inf, sweep.time))
    refused(r"time must be a list of at least two instants .* shape \(\d+, 2\)", time=sweep.wave())


def test_broken_pulses():
    pulses = Sweep(8).pulses
    middle = 0.5 * (pulses[3] + pulses[4])
    refused(
        rf"missing pulse at t = {pulses[4]:.6g} s, a revolution lasts 2 times the usual 0.04 s: cut the record",
        pulses=np.delete(pulses, 4),
    )
    refused(rf"missing pulse at t = {pulses[1]:.6g} s", pulses=np.delete(pulses, 1))
    refused(
        rf"a double pulse near t = {middle:.6g} s ends a revolution of 0.5 times", pulses=np.insert(pulses, 4, middle)
    )
    refused(r"a double pulse near t = .* of 0.05 times the usual", pulses=np.insert(pulses, 4, pulses[3] + 0.002))
    refused(r"pulses must rise; entry 1 = ", pulses=pulses[::-1])
    refused(r"pulses must rise", pulses=np.repeat(pulses, 2))
    refused(r"missing pulse", pulses=pulses[[0, 1, 3]])


def test_records_too_short():
    pulses = Sweep(8).pulses
    refused(
        r"at least 2 whole revolutions, 3 pulses; this one holds 2 pulse\(s\) from t = 0 to .*: record longer",
        pulses=pulses[:2],
    )
    refused(r"holds 0 pulse\(s\) .* share one clock", pulses=pulses + 100.0)
    refused(r"pulses must be a list of at least two", pulses=pulses[:1])


def test_pulses_outside_the_record_are_left_out():
    sweep = Sweep(8)
    more = np.concatenate([sweep.pulses[:1] - 0.04, sweep.pulses, sweep.pulses[-1:] + 0.04])
    assert vectors_from_waveform(sweep.time, sweep.wave(), more).revolutions == 8


def test_orders_that_the_record_cannot_resolve():
    refused(r"orders must be positive numbers, .* order 0 is the constant", orders=(0.0, 1.0))
    refused(r"orders must be positive numbers, at least one", orders=())
    refused(r"order 40 needs more than 80 samples per revolution; the record has 80: sample faster", orders=(1.0, 40.0))
    refused(r"orders 1 and 1.05 must be one period apart over the record, 1/8 for 8 revolutions", orders=(1.05, 1.0))
    refused(r"orders 0 and 0.1 must be one period apart", orders=(0.1,))
    refused(r"drift must be a polynomial degree from 0 to the 8 revolutions of the record; it is 9", drift=9)
    refused(r"drift must be .* it is -1", drift=-1)
    few = Sweep(2, rate=62.0)
    refused(r"5 unknowns need more than the 5 samples", time=few.time, wave=few.wave(), pulses=few.pulses, drift=2)


def test_features_need_two_probes_at_a_right_angle():
    sweep = Sweep(8)
    with pytest.raises(
        ValueError,
        match=r"two probes, X then Y, of shape \(sample, 2\); this one has shape \(\d+, 1\): choose two columns",
    ):
        features_from_waveform(sweep.time, sweep.wave()[:, :1], sweep.pulses)
    with pytest.raises(
        ValueError, match="second probe 90 degrees on from the first; here it is 270 degrees on: swap the columns"
    ):
        features_from_waveform(sweep.time, sweep.wave(), sweep.pulses, probe_angle_deg=(90.0, 0.0))
    turned = features_from_waveform(sweep.time, sweep.wave(), sweep.pulses, probe_angle_deg=(315.0, 45.0))
    np.testing.assert_allclose(turned.features, F, rtol=1e-10)


def test_channels_without_pulses(rng):
    time = np.arange(2000) / RATE
    one = (np.abs(time - 0.5) < 0.05).astype(float)
    for channel, match in [
        (np.full(2000, 1.2), "reference channel is constant at 1.2: check that the phase reference is connected"),
        (rng.standard_normal(2000), "shows noise and no two levels"),
        (one, r"has 1 rising edge\(s\) through 0.5; a shaft angle needs at least two pulses: record more revolutions"),
        (np.where(time == 0.5, np.nan, one), r"reference must be finite; column 0 is not at t = 0.5 s"),
        (one[:-1], r"reference must have one row per sample; it has shape \(1999, 1\) beside 2000 times"),
    ]:
        with pytest.raises(ValueError, match=match):
            pulse_times(time, channel)
    with pytest.raises(
        ValueError, match="never crosses the threshold 3, it stays from 0 to 1: give a threshold inside"
    ):
        pulse_times(time, one, threshold=3.0)


def test_orders_that_a_record_cannot_tell_apart_are_refused():
    """2X at hardly more than four samples per revolution, with vectors that change."""
    time = np.arange(0.0, 12.0, 1.0 / 4.0001)
    with pytest.raises(ValueError, match="record longer or faster"):
        vectors_from_waveform(time, np.sin(time)[:, None], np.arange(13.0), orders=(1.0, 2.0), changing=2)
