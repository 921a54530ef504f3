"""The correction beside a bow leaves least vibration, by the closed form of a rotor equal along x and y."""

import numpy as np

from rotorjax import Conditions, Jeffcott, Measurement, Model, diagnose, effects, fit, read_rig
from rotorjax.discovery.least_vibration import excites_at_1x, together
from rotorjax.reporting.to_correct import balance_of_diagnosis

from helpers import RIG, write

MASS, STIFFNESS, RATIO = 2.0, 80e3, 0.03
OMEGA = np.sqrt(STIFFNESS / MASS)
SPEEDS = OMEGA * np.linspace(0.4, 1.5, 14)
UNBALANCE, BOW = 24e-6 * np.exp(3.2j), 30e-6 + 0j


def vibration(unbalance, bow):
    """Of the disk, on a circular orbit: (k - m Ω² + i c Ω) z = Ω² U + k s."""
    impedance = STIFFNESS - MASS * SPEEDS**2 + 2j * RATIO * np.sqrt(STIFFNESS * MASS) * SPEEDS
    return (SPEEDS**2 * unbalance + STIFFNESS * bow) / impedance


def fitted(*added):
    z = vibration(UNBALANCE, BOW)
    vectors = np.stack([z, -1j * z], axis=-1)[:, :, None]
    m = Measurement.from_arrays(vectors, Conditions.at(SPEEDS), sigma=0.1e-6)
    return fit(sum(added, Model(Jeffcott(MASS, STIFFNESS, RATIO))), m, held_out=False)


def test_the_correction_beside_a_bow_leaves_least_vibration():
    found = fitted(effects.ResidualUnbalance(), effects.ResidualBow(), effects.DampingError())
    assert set(excites_at_1x(found)) == {"residual_unbalance", "residual_bow"}
    least = together(found, SPEEDS * 30.0 / np.pi)
    z, each = vibration(UNBALANCE, BOW), vibration(1.0, 0.0)
    expected = np.vdot(each, z) / np.vdot(each, each)
    np.testing.assert_allclose(complex(*least.unbalance), expected, rtol=1e-3)
    for size, left in (
        (least.left.before, z),
        (least.left.after, z - each * expected),
        (least.left.unbalance_alone, z - each * UNBALANCE),
    ):
        np.testing.assert_allclose(size, np.sqrt(np.mean(np.abs(left) ** 2)), rtol=2e-3)
    assert least.left.after < least.left.before


def test_its_error_is_that_of_unbalance_and_bow_together():
    """Where both are known to be nearly opposite, their sum is known better than each."""
    found = fitted(effects.ResidualUnbalance(), effects.ResidualBow())
    least = together(found, SPEEDS * 30.0 / np.pi)
    own = found.estimate("residual_unbalance", "unbalance_x_kg_m").standard_error
    assert 0.0 < np.sqrt((least.by_unknown @ found.covariance @ least.by_unknown.T)[0, 0]) < own


def test_an_error_of_the_rotor_excites_nothing():
    assert excites_at_1x(fitted(effects.ResidualUnbalance(), effects.StiffnessError())) == ("residual_unbalance",)


def test_what_was_diagnosed_is_corrected_against_unbalance_and_bow_together(tmp_path):
    """Installed as told, the correction leaves what is told, and no more than before."""
    shares = "[planes.disk]\nparticipation = 0.5\n[runs.baseline]"
    rotor = f"mass_kg = {MASS}\nstiffness_n_per_m = {STIFFNESS}\ndamping_ratio = {RATIO}\n"
    rest = RIG[RIG.index("[probes]") :].replace("[runs.baseline]", shares)
    rig = read_rig(write(tmp_path, rig=f"[rotor]\n{rotor}{rest}")[1])
    z = vibration(UNBALANCE, BOW)
    vectors = np.stack([z, -1j * z], axis=-1)[:, :, None]
    m = Measurement.from_arrays(vectors, Conditions.at(SPEEDS), sigma=0.1e-6, runs=("baseline",))
    balance = balance_of_diagnosis(diagnose(rig.model, m), rig, m)
    (found,) = balance.corrections
    assert found.beside == ("residual_bow",)
    left = z - vibration(0.5 * complex(*found.unbalance.pair), 0.0)
    size = 1e6 * np.sqrt(np.mean(np.abs(left) ** 2))
    assert size < 1e6 * np.sqrt(np.mean(np.abs(z) ** 2))
    assert f"{size:.2f} of" in balance.leaves or f"{size:.1f} of" in balance.leaves
