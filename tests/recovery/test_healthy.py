"""A rotor with more detail than the model, measured when healthy and later: what has changed is found, and not what the
healthy rotor has.

The rotor is written out here: a disk off midspan that tilts, with polar and diametral moments, on a massless shaft, in
bearings that differ along x and y (Genta, Dynamics of Rotating Systems, Springer 2005, section 2.6).
"""

import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest

from rotorjax import (
    Conditions,
    InputError,
    Jeffcott,
    Layout,
    Measurement,
    Model,
    calibrated,
    compare,
    effects,
    explain,
    read_measurement,
    read_rig,
    response,
    tell,
)
from rotorjax.batch.explaining import Task, explain_case
from rotorjax.cli import main
from rotorjax.effects.healthy_rotor import HealthyDetail, HealthyExcitation, HealthyRotor, HealthyRunout
from rotorjax.inference.space import make_space
from rotorjax.reporting.comparison import comparison_text
from rotorjax.reporting.explanation import explanation_text
from rotorjax.reporting.explanation_json import explanation_json

MASS, STIFFNESS, DAMPING = 2.0, np.array([2.1e5, 1.9e5]), np.array([14.0, 12.0])
RATIO = DAMPING / (2.0 * np.sqrt(STIFFNESS * MASS))
SPEEDS = np.linspace(0.6, 1.4, 12) * 316.0
WEIGHTS = np.array([[2e-5, 0.0], [4e-5, 1e-5], [-1e-5, 4e-5]])
SIGMA = 2e-7
OWN_UNBALANCE, RUNOUT = 3e-6 + 5e-6j, np.array([2e-6 - 1e-6j, 1e-6 + 2e-6j])
MODEL = Model(Jeffcott(MASS, STIFFNESS, RATIO), layout=Layout(orders=(1.0,)))


def conditions() -> Conditions:
    return Conditions.at(np.tile(SPEEDS, 3), unbalance=np.repeat(WEIGHTS, len(SPEEDS), axis=0)[:, None])


def detailed(*, cross: float = 0.0, unbalance: complex = 0.0, bow: complex = 0.0, heavier: float = 1.05) -> np.ndarray:
    """Vectors of X and Y [m]: coordinates x, y and slopes; ``cross``: k of a force across the motion of the disk;
    ``unbalance``: beside that which the healthy rotor has; ``bow`` of the shaft at the disk, which is inclined there;
    ``heavier``: mass over that of the rig file. Both probes have runout.
    """
    lever, turning = 0.12, 2.2e4
    polar, diametral = 0.012, 0.008
    vectors = []
    for speed, (ux, uy) in zip(np.tile(SPEEDS, 3), np.repeat(WEIGHTS, len(SPEEDS), axis=0), strict=True):
        dynamic = np.zeros((4, 4), complex)
        force = speed**2 * (ux + 1j * uy + OWN_UNBALANCE + unbalance) * np.array([1.0, -1j, 0.0, 0.0])
        for axis in (0, 1):
            own = np.array([[1.0, lever], [lever, lever**2]]) * STIFFNESS[axis] * 1.03
            own = own + np.array([[0.0, 0.0], [0.0, turning]])
            force[axis::2] += own @ np.array([bow, -0.5 * bow]) * [1.0, -1j][axis]
            own = own - speed**2 * np.diag([heavier * MASS, diametral]) + 1j * speed * np.diag([DAMPING[axis], 0.1])
            dynamic[np.ix_([axis, axis + 2], [axis, axis + 2])] = own
        dynamic[0, 1], dynamic[1, 0] = cross, -cross
        dynamic[2, 3], dynamic[3, 2] = 1j * speed**2 * polar, -1j * speed**2 * polar
        vectors.append(np.linalg.solve(dynamic, force)[:2])
    return (np.array(vectors) + RUNOUT)[..., None]


def measured(vectors: np.ndarray, seed: int, sigma: float | None = SIGMA) -> Measurement:
    rng = np.random.default_rng(seed)
    noise = SIGMA * (rng.standard_normal(vectors.shape) + 1j * rng.standard_normal(vectors.shape))
    run = np.repeat(np.arange(3), len(SPEEDS))
    return Measurement.from_arrays(
        vectors + noise, conditions(), run=run, runs=("baseline", "trial-a", "trial-b"), sigma=sigma
    )


@pytest.mark.parametrize("sigma", [SIGMA, None], ids=["noise given", "noise unknown"])
def test_a_tilting_disk_is_calibrated_to_the_noise(sigma):
    found = calibrated(MODEL, measured(detailed(), 1, sigma))
    assert found.declared.rms > 20.0 * SIGMA
    assert found.calibrated.rms < 1.6 * SIGMA
    assert found.tolerance < 2e-3


def test_what_the_calibration_leaves_open_is_as_large_as_said():
    later, counted = measured(detailed(), 100), []
    for seed in range(12):
        found = calibrated(MODEL, measured(detailed(), seed))
        beside = found.beside(later)
        assert beside.calibration is not None
        error = np.asarray(response(found.model, later.conditions)) - detailed()
        pairs = np.stack([error.real, error.imag], axis=-1).ravel() / SIGMA
        columns = (
            beside.calibration.columns(found.model, later.conditions, later.orders).reshape(len(pairs), -1) / SIGMA
        )
        # Along the directions that the data determine: the others have the prior's width.
        directions, sizes, _ = np.linalg.svd(columns, full_matrices=False)
        counted.append(np.mean((directions.T @ pairs / np.hypot(sizes, 0.05))[:6] ** 2))
    assert 0.3 < np.mean(counted) < 1.6


@pytest.mark.parametrize(
    ("change", "name"),
    [({"cross": 1500.0}, "cross_coupling"), ({"unbalance": 6e-6 - 4e-6j}, "residual_unbalance")],
)
def test_what_has_changed_since_is_found(change, name):
    found = explain(MODEL, measured(detailed(**change), 2), healthy=measured(detailed(), 1))
    assert found.effects == (name,)
    values = [e for e in found.story.fits[-1].estimates if e.entry.effect == name]
    true = [1500.0] if name == "cross_coupling" else [6e-6, -4e-6]
    for estimate, value in zip(values, true, strict=True):
        assert abs(estimate.value - value) < 3.5 * estimate.standard_error
    text, content = explanation_text(found), explanation_json(found)
    assert "nstable" not in text
    assert "decrement" not in text.partition("Parameters")[0]
    assert "Healthy rotor, 72 vectors" in text
    assert content["healthy"]["rms_um"] < 0.4 < content["healthy"]["as_stated_rms_um"]


def test_a_bow_of_a_shaft_that_bends_otherwise_than_the_model_is_a_bow():
    healthy, later = measured(detailed(), 1), measured(detailed(bow=1.2e-5 + 6e-6j), 2)
    found = explain(MODEL, later, healthy=healthy)
    assert (found.verdict, found.effects) == ("explained", ("residual_bow",))


def test_an_error_of_the_mass_is_compared_where_it_has_moved_the_resonance():
    """What the healthy rotor leaves open moves the vectors there otherwise than it moved those of the healthy rotor; a
    stiffness that changes with speed does nearly the same.
    """
    healthy, later = measured(detailed(), 1), measured(detailed(heavier=1.12), 2)
    few = [
        dataclasses.replace(m, present=m.present & (np.arange(36) % 3 == 0)[:, None, None]) for m in (healthy, later)
    ]
    likely = ["mass_error", "speed_dependent_stiffness", "stiffness_error", "damping_error", "gyroscopic"]
    found = explain(MODEL, few[1], only=likely, healthy=few[0], thorough=False)
    first = found.races[0].contenders
    mass, stiffness = (first[frozenset({name})].best for name in ("mass_error", "speed_dependent_stiffness"))
    assert abs(mass.data_cost - stiffness.data_cost) < 10.0
    tied = [set(found.effects), *(set(t.effects) for t in found.ties.tied)]
    assert {"mass_error"} in tied


def test_what_is_left_open_is_felt_alike_from_a_model_and_from_a_space():
    known = calibrated(MODEL, measured(detailed(), 1))
    later = known.beside(measured(detailed(), 2))
    space = make_space(known.model.with_orders(later.orders), later.knowledge)
    assert later.calibration is not None
    one = later.calibration.columns(known.model, later.conditions, later.orders)
    (other,) = later.calibration.columns_at(space, later.conditions, [space.given_unknowns()])
    np.testing.assert_allclose(other, one, rtol=1e-9, atol=1e-15)


def test_what_has_changed_has_a_tolerance_of_its_own():
    known = calibrated(MODEL, measured(detailed(), 1))
    later = known.beside(measured(detailed(cross=1500.0), 2))
    change = later.vectors - np.asarray(response(known.model, later.conditions))
    assert known.tolerance_of_changes > 5.0 * known.tolerance
    np.testing.assert_allclose(later.form[:, :2], known.tolerance * later.vectors)
    np.testing.assert_allclose(later.form[:, 2:], known.tolerance_of_changes * change, rtol=1e-6)


def test_nothing_has_changed():
    found = explain(MODEL, measured(detailed(), 3), healthy=measured(detailed(), 1))
    assert found.verdict == "nothing missing"
    own = ["gyroscopic", "mass_error", "stiffness_error", "damping_error"]
    assert explain(MODEL, measured(detailed(), 3), only=own, thorough=False).verdict != "nothing missing"


def test_compare_begins_with_the_healthy_rotor():
    story = tell(MODEL, measured(detailed(cross=1500.0), 2), [effects.CrossCoupling()], healthy=measured(detailed(), 1))
    assert story.fits[-1].reduced_chi2 < 1.5
    assert story.last.rms < 2.5 * SIGMA < 0.1 * story.declared.rms
    assert "calibrated" in comparison_text(story)


def test_what_the_healthy_table_lacks_is_said():
    healthy = measured(detailed(), 1)
    one = dataclasses.replace(healthy, present=healthy.present & np.array([True, False])[:, None])
    story = tell(MODEL, measured(detailed(), 2), [], healthy=one)
    assert "not read at Y" in comparison_text(story)
    with pytest.raises(InputError, match="another day"):
        tell(MODEL, healthy, [], healthy=healthy)


def test_another_rotor_is_refused():
    healthy = measured(detailed(), 1)
    exchanged = dataclasses.replace(healthy, vectors=healthy.vectors[::-1])
    with pytest.raises(InputError, match="explain it first"):
        calibrated(MODEL, exchanged)
    doubled = dataclasses.replace(healthy, vectors=2.0 * healthy.vectors)
    with pytest.raises(InputError, match="another unit or convention"):
        calibrated(MODEL, doubled)


@pytest.mark.parametrize(
    ("part", "same"),
    [
        (HealthyRotor(stiffness_x=0.1, stiffness_y=-0.05), effects.StiffnessError(0.1, -0.05)),
        (HealthyDetail(stiffening_x=0.1, stiffening_y=-0.05), effects.SpeedDependentStiffness(0.1, -0.05)),
        (HealthyDetail(cross_stiffness_n_per_m=900.0), effects.CrossCoupling(900.0)),
        (HealthyRotor(damping_x=0.3, damping_y=-0.2), effects.DampingError(np.log(1.3), np.log(0.8))),
        (HealthyDetail(falling_damping=0.3), effects.SpeedDependentDamping(0.3)),
        (HealthyDetail(turning_damping_n_s_per_m=5.0), effects.InternalDamping(5.0)),
        (HealthyRotor(mass=0.1), effects.MassError(0.1)),
        (HealthyDetail(inertia_ratio_kg=0.1), effects.Gyroscopic(0.1)),
        (HealthyExcitation(unbalance_x_kg_m=1e-6, unbalance_y_kg_m=2e-6), effects.ResidualUnbalance(1e-6, 2e-6)),
        (HealthyExcitation(bow_x_m=1e-6, bow_y_m=2e-6), effects.ResidualBow(1e-6, 2e-6)),
        (HealthyRunout(real_m=[[1e-6], [2e-6]]), effects.Runout([[1e-6], [2e-6]])),
    ],
    ids=lambda part: part.name,
)
def test_each_part_is_that_of_the_catalogue(part, same):
    one, other = (np.asarray(response(MODEL + effect, conditions())) for effect in (part, same))
    np.testing.assert_allclose(one, other, rtol=1e-9)


def test_the_sag_grows_by_a_part_of_the_weight():
    heavy = Model(Jeffcott(MASS, STIFFNESS, RATIO, gravity=(0.0, -9.81)), layout=Layout(orders=(0.0, 1.0)))
    more = heavy + HealthyExcitation(sag_along=0.1, sag_across=0.05)
    plain, bent = (np.asarray(response(model, conditions())) for model in (heavy, more))
    np.testing.assert_allclose(bent[..., 1], plain[..., 1])
    np.testing.assert_allclose(bent[:, 1, 0], 1.1 * plain[:, 1, 0])
    np.testing.assert_allclose(bent[:, 0, 0], 0.05 * 9.81 * MASS / STIFFNESS[0])


RIG = """
[rotor]
mass_kg = 2.0
stiffness_n_per_m = { x = 2.1e5, y = 1.9e5 }
damping_ratio = { x = 0.0108, y = 0.0097 }
[probes]
X = { angle_deg = 0.0 }
Y = { angle_deg = 90.0 }
[model]
healthy = "healthy.csv"
[runs.baseline]
unbalance = { magnitude_g_mm = 20.0, angle_deg = 0.0 }
[runs.trial-a]
unbalance = [{ magnitude_g_mm = 40.0, angle_deg = 0.0 }, { magnitude_g_mm = 10.0, angle_deg = 90.0 }]
[runs.trial-b]
unbalance = [{ magnitude_g_mm = 10.0, angle_deg = 180.0 }, { magnitude_g_mm = 40.0, angle_deg = 90.0 }]
"""


@pytest.fixture
def files(tmp_path):
    path = tmp_path / "rig.toml"
    path.write_text(RIG, encoding="utf-8")
    rig = read_rig(path)
    rig.write_measurement(tmp_path / "healthy.csv", measured(detailed(), 1))
    rig.write_measurement(tmp_path / "later.csv", measured(detailed(cross=1500.0), 2))
    return tmp_path


def compared(folder: Path, *more: str) -> dict:
    """What `compare` writes."""
    report = folder / "compared.json"
    main(["compare", str(folder / "later.csv"), "--rig", str(folder / "rig.toml"), "--json", str(report), *more])
    return json.loads(report.read_text(encoding="utf-8"))


def test_the_rig_file_may_name_the_healthy_table(files):
    by_key = compared(files, "--effect", "cross_coupling", "--write-rig", str(files / "now.toml"))
    text = (files / "rig.toml").read_text(encoding="utf-8").replace('healthy = "healthy.csv"', "")
    (files / "rig.toml").write_text(text, encoding="utf-8")
    assert compared(files)["healthy"] is None
    assert compared(files, "--healthy", str(files / "healthy.csv"), "--effect", "cross_coupling") == by_key
    assert by_key["healthy"]["tolerance"] < 2e-3
    now = read_rig(files / "now.toml")
    assert now.healthy is None
    assert compare(now.model, read_measurement(files / "later.csv", now)).rms < 2.5 * SIGMA


@pytest.mark.parametrize(("key", "words"), [("3", "is no file"), ('"none.csv"', "none.csv")])
def test_a_healthy_table_that_is_not_there_is_refused(files, key, words, capsys):
    text = (files / "rig.toml").read_text(encoding="utf-8").replace('"healthy.csv"', key)
    (files / "rig.toml").write_text(text, encoding="utf-8")
    assert main(["compare", str(files / "later.csv"), "--rig", str(files / "rig.toml")]) == 2
    assert words in capsys.readouterr().err


def test_a_fleet_is_explained_since_it_was_healthy(files):
    row = explain_case(Task(files / "later.csv", files / "rig.toml", only=("cross_coupling", "gyroscopic")))
    assert row["effects"] == ["cross_coupling"]
