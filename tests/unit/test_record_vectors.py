"""Vectors of recordings against synthetic truth: accuracy, standard errors, run-ups, slow roll, real waveforms."""

import csv
import json
from pathlib import Path

import numpy as np
import pytest
from scipy.signal import cont2discrete, lfilter
from threadpoolctl import threadpool_limits

import rotorjax
from rotorjax import Conditions, Jeffcott
from rotorjax.cli import main
from rotorjax.data.pulses import Trigger, mended, pulse_times
from rotorjax.data.record_vectors import read_recordings
from rotorjax.data.rig import read_rig
from rotorjax.data.signals import vectors_from_waveform
from rotorjax.data.table import read_table
from rotorjax.errors import InputError
from rotorjax.reporting.pictures.recorded import recorded_pictures

from recorded import RATE, Made, Z, as_csv, made, pulse, rig_file

REAL = Path(__file__).parents[3] / "shared" / "real" / "gpl3"
"""Measured by others and not part of the package, by its licence; github.com/hstarmans/rotorbalancer, measurements/."""
MASS, STIFFNESS, ZETA = 0.97, np.array([56500.0, 51300.0]), 0.02
DAMPING = 2 * ZETA * np.sqrt(STIFFNESS * MASS)
TRUTH = np.array(list(Z.values()))


@pytest.fixture(autouse=True)
def one_thread():
    """Products this small gain nothing from threads, which only wait for one another on a busy machine."""
    with threadpool_limits(1, user_api="blas"):
        yield


def draw(rng, *, rpm, correlation, seconds=2.0, rate=12800.0, edge_s=1.5e-4):
    """A record at 40 dB of signal to noise, and its fit: 1X, 2X, 0X and noise of a given colour."""
    time = np.arange(int(rate * seconds)) / rate
    speed = rpm * np.pi / 30
    turned = speed * time - rng.uniform(0.5, 6.0)
    white = rng.standard_normal((len(time) + 400, 2))
    noise = lfilter([np.sqrt(1 - correlation**2)], [1.0, -correlation], white, axis=0)[400:]
    turning = np.exp(1j * turned)[:, None]
    waves = np.real(TRUTH * turning + 0.1 * TRUTH * turning**2) + 100e-6
    waves = waves + 0.01 * np.abs(TRUTH) / np.sqrt(2) * noise
    reference = pulse(turned, edge=edge_s * speed) + 0.01 * rng.standard_normal(len(time))
    return vectors_from_waveform(time, waves, pulse_times(time, reference, threshold=0.5), orders=(1.0, 2.0))


@pytest.mark.parametrize("correlation", [0.0, 0.9])
def test_accuracy_and_coverage_at_40_db(rng, correlation):
    """Amplitude within 0.1 %, phase within 0.1 degree; 95 % intervals hold the truth in 93 to 97 % of draws, which 150
    records, 600 parts of vectors, tell to 0.9 %.
    """
    inside, ratio = [], []
    for _ in range(150):
        fit = draw(rng, rpm=rng.uniform(900.0, 3500.0), correlation=correlation)
        error = fit.vectors[:, 0] - TRUTH
        inside += [np.abs(part) < 1.96 * fit.sigma[:, 0] for part in (error.real, error.imag)]
        ratio.append(fit.vectors[:, 0] / TRUTH)
        assert np.all(np.abs(fit.constant - 100e-6) < 5.0 * fit.constant_sigma)
    assert 0.93 <= np.mean(inside) <= 0.97
    assert np.std(np.abs(ratio)) < 3.5e-4
    assert np.max(np.abs(np.abs(ratio) - 1.0)) < 1.1e-3
    assert np.max(np.abs(np.degrees(np.angle(ratio)))) < 0.1


def test_hard_edges_are_in_the_error(rng):
    """Edges shorter than a sample, at 2 kHz: their rounding is counted, more or less of it as the places change."""
    units = []
    for _ in range(150):
        time = np.arange(2000) / 2000.0
        turned = rng.uniform(900.0, 3500.0) * np.pi / 30 * time - rng.uniform(0.5, 6.0)
        waves = np.real(TRUTH * np.exp(1j * turned)[:, None]) + 0.1e-6 * rng.standard_normal((2000, 2))
        pulses = pulse_times(time, (turned % (2 * np.pi) < 0.6).astype(float))
        fit = vectors_from_waveform(time, waves, pulses)
        units.append(np.abs(fit.vectors[:, 0] - TRUTH) / fit.sigma[:, 0])
    assert 0.4 < np.sqrt(np.mean(np.square(units)) / 2) < 1.1
    assert np.mean(np.array(units) < 2.45) > 0.95


def test_edges_of_a_sample_or_two_are_in_the_error(rng):
    """What a cubic leaves open on an edge: as large as it is, whatever the place of the pulse between samples."""
    found, said = [], []
    for rpm in rng.uniform(1500.0, 3000.0, 60):
        time = np.arange(1000) / 2000.0
        speed = rpm * np.pi / 30
        turned = speed * time - 1.0
        trigger = Trigger(pulse(turned, edge=3e-4 * speed), threshold=0.5)
        fired = trigger.feed(time, pulse(turned, edge=3e-4 * speed))
        error = (fired * speed - 1.0 + np.pi) % (2 * np.pi) - np.pi
        found.append(np.mean((error / speed) ** 2))
        said.append(trigger.edge_error**2)
    assert np.sqrt(np.mean(said) / np.mean(found)) == pytest.approx(1.0, abs=0.3)


def test_mended_pulses():
    pulses = np.linspace(0.0, 1.0, 51) ** 1.05
    whole = mended(pulses)
    np.testing.assert_array_equal(whole.pulses, pulses)
    assert len(whole.missing) == len(whole.double) == 0
    broken = np.sort(np.append(np.delete(pulses, [20, 21]), [0.7 * pulses[33] + 0.3 * pulses[34], pulses[41] + 1e-3]))
    found = mended(broken)
    np.testing.assert_allclose(found.pulses, pulses, atol=2e-5)
    np.testing.assert_allclose(found.missing, pulses[[20, 21]], atol=2e-5)
    assert len(found.double) == 2
    with pytest.raises(ValueError, match=r"none came for 5.96 revolutions: cut the record there"):
        mended(np.delete(pulses, [20, 21, 22, 23, 24]))
    with pytest.raises(
        ValueError, match=r"do not come once per revolution: among \d+ revolutions 8 pulses are missing"
    ):
        mended(np.delete(pulses, np.arange(3, 51, 6)))
    with pytest.raises(ValueError, match=r"none came for 1.6 revolutions"):
        mended(np.concatenate([pulses[:25], pulses[25:] + 0.6 * (pulses[25] - pulses[24])]))


# Run-ups


def response(speed, force=6e-6):
    """Steady x and y of the rig of `helpers` to an unbalance [kg m], here in closed form."""
    return np.array([1.0, -1j]) * force * speed**2 / (STIFFNESS - MASS * speed**2 + 1j * DAMPING * speed)


def run_up(rng, folder, *, seconds, low, high, grows=0.0):
    """A rotor in time through its criticals, as a recording with noise: exact for a force that is straight between
    samples. The rate of its speed grows by a share of itself on the way.
    """
    time = np.arange(int(RATE * (seconds + 2.0))) / RATE
    rate = (high - low) * np.pi / 30 / seconds
    after = time - 2.0  # of the start from rest, which has died out by then
    part = rate * grows / seconds
    speed = low * np.pi / 30 + (1.0 - 0.5 * grows) * rate * after + 0.5 * part * after**2
    turned = low * np.pi / 30 * after + 0.5 * (1.0 - 0.5 * grows) * rate * after**2 + part * after**3 / 6.0
    # U e^{iφ} seen from the mass centre: d²/dt² of e^{iφ}, along x and y a quarter turn later.
    pushed = 6e-6 * (speed**2 - 1j * ((1.0 - 0.5 * grows) * rate + part * after)) * np.exp(1j * turned)
    motion = []
    for each, k, c in zip((1.0, -1j), STIFFNESS, DAMPING, strict=True):
        top, bottom, _ = cont2discrete(([1.0], [MASS, c, k]), 1.0 / RATE, method="foh")
        motion.append(lfilter(top.ravel(), bottom, np.real(each * pushed)))
    keep = after > 0.0
    time, waves = time[keep], np.stack(motion, axis=1)[keep]
    waves = waves + 1e-6 * rng.standard_normal(waves.shape)
    record = Made(time, 5.0 * pulse(turned[keep]), waves)
    as_csv(record, folder / "up.csv")
    return read_rig(rig_file(folder, "up.csv=baseline"))


def parts(found):
    """Speeds [rad/s], vectors, noise, and what is left of the sweep."""
    speeds = np.array([point.speed_rpm for point in found.points]) * np.pi / 30
    return speeds, *(np.array([getattr(p, part)[:, 0] for p in found.points]) for part in ("vectors", "sigma", "bias"))


@pytest.mark.parametrize(("seconds", "shift"), [(40.0, 50.0), (6.0, 90.0)], ids=["slow", "fast"])
def test_a_run_up_at_a_steady_rate_is_what_the_model_shows_at_that_rate(rng, tmp_path, seconds, shift):
    """A steady state misses the vectors by some hundred standard errors; where fast, free vibration beats with 1X."""
    found = read_recordings(run_up(rng, tmp_path, seconds=seconds, low=1500.0, high=3000.0)).records[0]
    assert not found.steady
    assert found.rate == pytest.approx(1500.0 * np.pi / 30 / seconds, rel=1e-4)
    speeds, z, noise, left = parts(found)
    assert 30 < len(speeds) < 120
    assert np.all(np.diff(speeds) > 0.0)
    steady = np.array([response(speed) for speed in speeds])
    assert np.sqrt(np.mean(np.abs((z - steady) / noise) ** 2)) > shift
    rotor = Jeffcott(MASS, STIFFNESS, ZETA)
    at = Conditions.at(speeds, unbalance=[6e-6, 0.0], sweep=found.rate)
    swept = np.asarray(rotorjax.response(rotor, at))[..., 0]
    assert np.mean(np.abs(z - swept) < 2.45 * np.hypot(noise, left)) > 0.9
    assert "takes it into account" in found.notes[0]


def test_a_run_up_at_a_changing_rate_says_that_it_is_biased(rng, tmp_path):
    """The shift near the resonance is far above the noise, and is counted as an error."""
    found = read_recordings(run_up(rng, tmp_path, seconds=6.0, low=1500.0, high=3000.0, grows=0.6)).records[0]
    assert found.rate is None
    speeds, z, noise, left = parts(found)
    truth = np.array([response(speed) for speed in speeds])
    near = int(np.argmax(np.abs(truth[:, 0])))
    assert np.abs(z - truth)[near, 0] > 5.0 * noise[near, 0]
    # What the resonance leaves rings on beyond it, by no more than said.
    assert np.mean(np.abs(z - truth) < 2.45 * np.hypot(left, noise)) > 0.9
    assert np.mean(np.abs(z - truth) < 2.45 * noise) < 0.7
    assert "looks like a split resonance" in found.notes[0]


def test_a_run_up_is_compared_with_its_rate_and_says_so(rng, tmp_path, capsys):
    """The unbalance as it is: what is left is noise."""
    rig = run_up(rng, tmp_path, seconds=6.0, low=1500.0, high=3000.0).path
    stated = "[runs.baseline]\nunbalance = { magnitude_g_mm = 6.0, angle_deg = 0.0 }\n"
    rig.write_text(rig.read_text().replace("[runs.baseline]\n", stated))
    report, told = tmp_path / "c.html", tmp_path / "c.json"
    assert main(["compare", "--recordings", str(rig), "--json", str(told), "--report", str(report)]) == 0
    assert json.loads(told.read_text())["reduced_chi2"] < 2.0
    assert "the speed changes by 250 rpm/s" in capsys.readouterr().err
    assert "probe X: spectra, each raised to its speed" in report.read_text(encoding="utf-8")


def test_a_table_of_a_run_up_keeps_its_rate(rng, tmp_path):
    rig = run_up(rng, tmp_path, seconds=6.0, low=1500.0, high=3000.0)
    main(["vectors", str(rig.path), "--output", str(tmp_path / "v.csv")])
    rows = read_table(tmp_path / "v.csv").rows
    assert [row.sweep_rpm_per_s for row in rows] == pytest.approx([250.0] * len(rows), rel=1e-4)
    like = ["--like", str(tmp_path / "v.csv"), "--output", str(tmp_path / "w.csv")]
    assert main(["simulate", "--rig", str(rig.path), *like]) == 0
    assert {row.sweep_rpm_per_s for row in read_table(tmp_path / "w.csv").rows} == {rows[0].sweep_rpm_per_s}


# Pictures


def test_a_run_up_has_vectors_over_speed_cascades_and_a_waterfall(rng, tmp_path):
    rig = run_up(rng, tmp_path, seconds=6.0, low=1500.0, high=3000.0)
    captions = [caption for caption, _ in recorded_pictures(rig, read_recordings(rig))]
    assert captions == [
        "Amplitude and phase of 1X over speed, as the recordings give them.",
        "baseline, probe X: spectra, each raised to its speed; dashed: orders.",
        "baseline, probe Y: spectra, each raised to its speed; dashed: orders.",
        "baseline (up.csv): spectra, each raised to its time; dashed: orders.",
    ]


def test_a_report_of_recordings_is_one_file(rng, tmp_path):
    as_csv(made(rng), tmp_path / "a.csv")
    rig = rig_file(tmp_path, "a.csv=baseline")
    report = tmp_path / "report.html"
    main(["vectors", str(rig), "--output", str(tmp_path / "v.csv"), "--report", str(report)])
    html = report.read_text(encoding="utf-8")
    assert html.count("<figure>") == 1
    assert "orbit, x to the right and y up" in html
    assert "http" not in html.replace("http-equiv", "")


# Slow roll


SLOW = 'slow_roll = "slow.csv"\n'
DECLARED = "[convention]\nslow_roll_subtracted = true\nslow_roll_rpm = 300\n"


def test_slow_roll_is_subtracted_on_request_only(rng, tmp_path):
    as_csv(made(rng), tmp_path / "a.csv")
    as_csv(made(rng, rpm=301.0, seconds=3.0), tmp_path / "slow.csv")

    def rig(waveform, before=""):
        return read_rig(rig_file(tmp_path, "a.csv=baseline slow.csv=baseline", waveform, before))

    plain = read_recordings(rig(""))
    assert len(plain.records) == 2
    np.testing.assert_allclose(plain.records[1].points[0].vectors[:, 0], TRUTH, rtol=1e-3)
    less = read_recordings(rig("[waveform]\n" + SLOW, DECLARED))
    assert [record.file for record in less.records] == ["a.csv"]
    assert np.all(np.abs(less.records[0].points[0].vectors) < 1e-3 * np.abs(TRUTH[:, None]))
    assert "most of what a bow shows" in less.notes[0]
    with pytest.raises(InputError, match=r"write slow_roll_subtracted = true and slow_roll_rpm = 301.0 under"):
        read_recordings(rig("[waveform]\n" + SLOW))
    with pytest.raises(InputError, match="vectors of recordings still hold it; name the recording"):
        read_recordings(rig("", DECLARED))


def test_rows_follow_the_conventions_of_the_rig_file(rng, tmp_path):
    as_csv(made(rng, noise=1e-6), tmp_path / "a.csv")
    as_csv(made(rng, noise=1e-6), tmp_path / "b.csv")
    lag = '[convention]\namplitude = "peak-to-peak"\nphase = "lag"\n'
    rig = read_rig(rig_file(tmp_path, "a.csv=baseline b.csv=baseline", "[waveform]\norders = [0, 1]\n", lag))
    found = read_recordings(rig)
    rows = found.rows()
    assert {row.order for row in rows} == {0.0, 1.0}
    assert {row.phase_deg for row in rows if row.order == 0.0} == {180.0}
    measurement = found.measurement(rig)
    assert measurement.noise == "given"
    np.testing.assert_allclose(measurement.vectors[:, :, 1], [TRUTH, TRUTH], rtol=1e-2)
    first = rig.convention.to_table(rows[1])
    assert first.amplitude_um == pytest.approx(100.0, rel=1e-2)
    assert first.phase_deg == pytest.approx(-np.degrees(0.7), abs=0.5)


# Real waveforms


@pytest.mark.skipif(not REAL.exists(), reason="the recordings, under another licence, are not here")
def test_real_waveforms_with_and_without_a_weight():
    """30 records of R. Starmans: 1X as found elsewhere by another angle, within the standard error of each; the known
    weight shows beyond the scatter from record to record.
    """
    with (REAL / "rotorbalancer_waveforms.csv").open() as file:
        names = next(csv.reader(file))
        table = np.genfromtxt(file, delimiter=",")
    groups = {}
    with (REAL / "rotorbalancer_1x.csv").open() as file:
        for row in csv.DictReader(file):
            wave, marks = (table[:, names.index(f"{row['group']}_{row['record']}_{kind}")] for kind in ("ac", "ir"))
            time = np.arange(len(wave)) / 952.0
            pulses = mended(pulse_times(time, marks)).pulses
            fit = vectors_from_waveform(time, wave[:, None], pulses, orders=(1.0, 2.0, 3.0))
            there = float(row["re_counts"]) + 1j * float(row["im_counts"])
            assert fit.speed_rpm / 60.0 == pytest.approx(float(row["rotor_hz"]), rel=1e-3)
            assert abs(fit.vectors[0, 0] - there) < fit.sigma[0, 0]
            groups.setdefault(row["group"], []).append(fit.vectors[0, 0])
    bare, loaded = (np.array(groups[name]) for name in ("without_weight", "weight"))
    centre = np.median(bare.real) + 1j * np.median(bare.imag)
    assert abs(centre) == pytest.approx(180.0, rel=0.1)
    assert abs(np.mean(loaded)) == pytest.approx(32.0, rel=0.1)
    assert abs(centre - np.mean(loaded)) > 5.0 * np.std(loaded)
