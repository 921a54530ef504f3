"""Numbers that no rotor can have are refused where it is made, with what is wrong."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from rotorjax import Conditions, Jeffcott, Model, effects, read_measurement, read_rig, response
from rotorjax.data.example import write_example
from rotorjax.model.rotor import bearing_stiffness

USUAL = {"mass": 1.0, "stiffness": [5e4, 4e4], "damping_ratio": 0.02, "gravity": [0.0, -9.81]}


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({"mass": np.inf}, "mass of a rotor is inf"),
        ({"mass": [1.0]}, r"mass and gravity have shapes \(1,\)"),
        ({"mass": -1.0}, "must be positive"),
        ({"stiffness": [5e4, np.inf]}, r"stiffness of a rotor is \[50000.0, inf\]"),
        ({"stiffness": np.nan}, "stiffness of a rotor is"),
        ({"damping_ratio": np.inf}, "damping ratio of a rotor is"),
        ({"damping_ratio": np.nan}, "damping ratio of a rotor is"),
        ({"damping_ratio": -0.01}, "must not be negative"),
        ({"gravity": np.nan}, "gravity of a rotor is"),
        ({"gravity": [0.0, 0.0, -9.81]}, r"and \(3,\): the mass is one number"),
    ],
)
def test_numbers_that_no_rotor_has(given, words):
    with pytest.raises(ValueError, match=words):
        Jeffcott(**(USUAL | given))


@pytest.mark.parametrize("speed", [-2300.0, 0.0, np.nan, [2300.0, -2200.0]])
def test_a_critical_speed_is_positive(speed):
    with pytest.raises(ValueError, match=r"critical_speed_rpm is .*positive and finite"):
        Jeffcott.from_critical_speed(mass=1.0, critical_speed_rpm=speed, damping_ratio=0.02)
    with pytest.raises(ValueError, match=r"critical_speed_rpm is .*positive and finite"):
        bearing_stiffness(critical_speed_rpm=speed, mass=1.0, shaft_stiffness=1e9)


def test_numbers_that_are_not_known_yet_pass():
    conditions = Conditions.at([150.0], unbalance=[1e-5, 0.0])

    def size(mass, critical, ratio):
        rotor = Jeffcott.from_critical_speed(mass=mass, critical_speed_rpm=critical, damping_ratio=ratio)
        rotor = dataclasses.replace(rotor, gravity=jnp.stack([mass, ratio]))
        return jnp.abs(response(rotor, conditions)).sum()

    assert np.all(np.isfinite(jax.jit(jax.grad(size, argnums=(0, 1, 2)))(1.0, 2000.0, 0.02)))
    many = jax.vmap(lambda mass: Jeffcott(mass, [5e4, 4e4], 0.02).stiffness)(jnp.array([1.0, 2.0]))
    assert many.shape == (2, 2)


def test_what_is_no_rotor_and_what_is_no_effect_is_refused(tmp_path):
    write_example(tmp_path)
    with pytest.raises(TypeError, match="rotor"):
        Model(read_rig(tmp_path / "rig.toml"))
    with pytest.raises(TypeError, match="MassError"):
        Model(Jeffcott(1.0, 1e5, 0.02)) + effects.MassError
    # By name: here types are checked before.
    with pytest.raises(TypeError, match=r"no effect|parameter 'effect'"):
        Model(Jeffcott(1.0, 1e5, 0.02)) + "mass_error"
    with pytest.raises(TypeError, match=r"no rig|parameter 'rig'"):
        read_measurement(tmp_path / "measurement.csv", tmp_path / "rig.toml")
