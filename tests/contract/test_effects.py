"""What every effect of the catalogue owes its users."""

import inspect
import json
from importlib.resources import files

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from rotorjax import Conditions, Effect, Jeffcott, Layout, Model, effects, response
from rotorjax.data.rig import effect_from_labels, read_rig
from rotorjax.effects.terms import TERMS
from rotorjax.model.contract import RestoringEffect, WaveformEffect
from rotorjax.reporting.catalogue import snapshot

CATALOG = effects.CATALOG
LAYOUT = Layout(planes=("disk1", "disk2"), orders=(1.0, 2.0))
NEVER_NULL = {"foundation", "clearance", "rub", "crack", "probe_saturation"}
"""Effects without a slope at their null: they start beside it."""
WEIGHTS = np.array([[3e-6, 1e-6], [1e-6, -2e-6]])


@pytest.fixture
def plain(paper_rotor):
    return Model(paper_rotor, participation=[1.0, 0.9], layout=LAYOUT)


@pytest.fixture
def conditions():
    return Conditions.at([150.0, 300.0], unbalance=WEIGHTS, bow=[1e-5, 2e-5])


@pytest.mark.parametrize("name", CATALOG)
def test_class_data(name, paper_rotor):
    cls = CATALOG[name]
    assert cls.name == name
    assert cls.family in {"excitation", "structure", "restoring", "reading"}
    assert len(cls.meaning) > 20
    assert "\n" not in cls.meaning
    assert any(character.isdigit() for character in cls.source), "a source has a year"
    assert cls.__doc__
    assert cls.parameters()
    for declared in cls.parameters():
        assert declared.prior_scale(paper_rotor) > 0.0
        assert declared.meaning
        assert declared.unit.shown
    assert cls.starts[0] == {} or name in NEVER_NULL or all(v == 0.0 for v in cls.starts[0].values())
    assert set(cls.relatives) <= set(CATALOG)
    names = {p.name for p in cls.parameters()}
    assert all(set(start) <= names for start in cls.starts)


@pytest.mark.parametrize("name", CATALOG)
def test_null_changes_nothing_and_gradients_equal_differences(name, plain, conditions):
    effect = CATALOG[name]().sized(LAYOUT)
    scales = [p.prior_scale(plain.rotor) for p in effect.parameters()]
    start = [1e-3 * jnp.ones_like(v) for v in effect.values()]

    def reading(units):
        values = [scale * unit for scale, unit in zip(scales, units, strict=True)]
        z = response(plain + effect.replaced(values), conditions) * 1e6
        shown = jnp.stack([z.real, z.imag])
        return shown, shown

    # One program for the values and all slopes, at every point.
    both = jax.jit(jax.jacfwd(reading, has_aux=True))
    slopes, shown = both(jax.tree.map(jnp.zeros_like, start))
    assert all(np.all(np.isfinite(g)) for g in jax.tree.leaves(slopes))
    # Orders that depend on one another are computed together, and share their rounding.
    atol = 1e-12 if issubclass(CATALOG[name], RestoringEffect | WaveformEffect) else 0.0
    np.testing.assert_allclose(shown[0] + 1j * shown[1], response(plain, conditions) * 1e6, rtol=1e-13, atol=atol)
    slope = sum(np.tensordot(by, at, at.ndim) for by, at in zip(both(start)[0], start, strict=True))
    step = 1e-4
    up, down = (both(jax.tree.map(lambda a, s=s: a * (1 + s), start))[1] for s in (step, -step))
    np.testing.assert_allclose(slope, (up - down) / (2 * step), atol=1e-6 * float(jnp.max(jnp.abs(slope))) + 1e-9)


@pytest.mark.parametrize("name", CATALOG)
def test_saved_and_loaded_by_a_rig_file(name, tmp_path):
    cls = CATALOG[name]
    source = tmp_path / "rig.toml"
    source.write_text(
        "[rotor]\nmass_kg = 1.0\nstiffness_n_per_m = 5e4\ndamping_ratio = 0.02\n"
        "[probes]\nX = { angle_deg = 0.0 }\nY = { angle_deg = 90.0 }\n[planes]\ndisk1 = {}\ndisk2 = { participation = "
        "0.9 }\n"
    )
    rig = read_rig(source)
    model = rig.model.with_orders((1.0, 2.0))
    labels = [label for p in cls.parameters() for label in p.labels(model.layout)]
    effect = effect_from_labels(cls, model.layout, {label: 0.1 * (k + 1) for k, label in enumerate(labels)})
    rig.write(tmp_path / "new.toml", model + effect)
    again = read_rig(tmp_path / "new.toml").model.with_orders((1.0, 2.0)).find(name)
    assert again is not None
    for old, new in zip(effect.values(), again.values(), strict=True):
        np.testing.assert_array_equal(old, new)


def test_catalogue_file_is_due():
    """`python -m rotorjax.reporting.catalogue` writes it anew."""
    stored = json.loads((files("rotorjax") / "data" / "catalogue.json").read_text(encoding="utf-8"))
    assert stored == snapshot()


def test_effects_are_final_and_hooks_abstract():
    for cls in CATALOG.values():
        assert not inspect.isabstract(cls)
        assert all(base is Effect or inspect.isabstract(base) for base in cls.__mro__[1:] if issubclass(base, Effect))


def test_sets_of_effects_commute(plain, conditions):
    some = [CATALOG[n]() for n in CATALOG]
    some = [
        e.sized(LAYOUT).replaced(
            [0.3 * p.prior_scale(plain.rotor) + jnp.zeros(p.shape(LAYOUT)) for p in e.parameters()]
        )
        for e in some
    ]
    forth, back = sum(some, plain), sum(reversed(some), plain)
    np.testing.assert_array_equal(response(forth, conditions), response(back, conditions))


def test_wrong_shape_names_the_entries(plain):
    with pytest.raises(
        ValueError,
        match=r"probe_angle: angle_rad has shape \(3,\); give one number, or one each for angle_rad.X, angle_rad.Y",
    ):
        plain + effects.ProbeAngle([0.1, 0.2, 0.3])


@pytest.mark.parametrize(
    ("effect", "words"),
    [
        (effects.Clearance(2e4, 1e4), "the rotor lies in it even at rest"),
        (effects.Rub(2e4, 1e4, 0.1), "the rotor lies in it even at rest"),
        (effects.Clearance(2e4, 1e3), None),
        (effects.Clearance(), None),
        (effects.Clearance(-2e4, 1e3), "a stop that pulls"),
        (effects.Rub(2e4, 1e3, -0.2), "a negative friction"),
        (effects.Rub(2e4, 1e3, 0.2), None),
        (effects.CoulombFriction(-1.0), "a negative friction"),
        (effects.Crack(3e4, -5e4), "deeper than the shaft"),
        (effects.Crack(3e4, -3e4), None),
        (
            effects.AsymmetricShaft(6e4, 0.0),
            "takes 6e+04 N/m on its soft side, more than the 5.13e+04 N/m that the shaft has",
        ),
        (TERMS["term_dead_band_x"](-1e3, 1e3), "a stop that pulls"),
        (TERMS["term_one_sided_stop_y"](-1e3, -1e3), "a stop that pulls"),
        (TERMS["term_one_sided_stop_y"](1e3, -1e3), None),
        (effects.Duffing(1e10), None),
        (effects.StiffnessError(-0.9, 0.5), None),
        (effects.StiffnessError(0.1, -1.1), "makes a stiffness negative"),
        (effects.MassError(-1.2), "makes the mass negative"),
        (effects.DampingError(2.0, -1.0), None),
        (effects.DampingError(3.6, 0.0), "makes the damping along x 1.1 times the critical one"),
    ],
)
def test_values_that_can_hardly_be_are_objected_to(effect, words):
    """A shaft that its weight bends by 178 µm."""
    rotor = Jeffcott(0.9686, [56538.0, 51282.0], [0.03, 0.05], gravity=[0.0, -9.81])
    told = [text for text in (effect.objection(rotor), effect.remark(rotor)) if text is not None]
    assert not told if words is None else len(told) == 1 and words in told[0]


def test_runout_may_be_a_quarter_of_the_vibration_that_is_allowed():
    """6.35 µm on a turbocharger; a quarter of 103 µm, which is grade G6.3 at 585 rpm, on a fan."""
    (declared, _) = CATALOG["runout"].parameters()
    assert declared.prior_scale(Jeffcott(0.3, 1e7, 0.05)) == pytest.approx(6.35e-6)
    assert declared.prior_scale(Jeffcott(2.0, 7500.0, 0.05)) == pytest.approx(0.25 * 6.3e-3 / np.sqrt(7500.0 / 2.0))
