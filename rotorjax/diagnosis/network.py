"""The network that turns features into faults: one hidden layer of tanh, between min-max scaled inputs and outputs."""

import dataclasses
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Bool, Float, Shaped

from rotorjax.arrays import AnyArray, as_float, require_float64
from rotorjax.data.files import read_text, write_whole
from rotorjax.diagnosis.features import checked_features

SLACK = 1e-9
"""Of half a range: what rounding may put outside it."""


class Perceptron(eqx.Module):
    """y = W₂ tanh(W₁ x + b₁) + b₂."""

    weight_in: Float[Array, "hidden feature"] = eqx.field(converter=as_float)
    bias_in: Float[Array, "hidden"] = eqx.field(converter=as_float)
    weight_out: Float[Array, "target hidden"] = eqx.field(converter=as_float)
    bias_out: Float[Array, "target"] = eqx.field(converter=as_float)

    def __call__(self, x: Float[Array, "feature"]) -> Float[Array, "target"]:
        """y for one case."""
        return self.weight_out @ jnp.tanh(self.weight_in @ x + self.bias_in) + self.bias_out

    @property
    def size(self) -> int:
        """Number of weights and biases."""
        return sum(leaf.size for leaf in jax.tree.leaves(self))


class Range(eqx.Module):
    """Smallest and largest value of each column of some data: what -1 and 1 stand for."""

    low: Float[Array, "feature"] = eqx.field(converter=as_float)
    high: Float[Array, "feature"] = eqx.field(converter=as_float)

    @classmethod
    def of(cls, data: Float[AnyArray, "sample feature"], what: str) -> "Range":
        """The range of data. **Errors.** ``ValueError`` for a column that is constant or not finite."""
        values = np.asarray(data)
        if len(values) == 0:
            raise ValueError(f"{what}: there are no cases; give at least two that differ")
        low, high = values.min(axis=0), values.max(axis=0)
        if not np.all(np.isfinite(values)):
            raise ValueError(f"{what}: not all numbers are finite; leave those cases out")
        if np.any(high <= low):
            column = int(np.argmax(high <= low)) + 1
            raise ValueError(
                f"{what}: column {column} is constant ({low[column - 1]:g}), so that nothing can be learned of it; "
                "draw cases that vary it"
            )
        return cls(low, high)

    @property
    def half(self) -> Float[Array, "feature"]:
        """Half the range."""
        return 0.5 * (self.high - self.low)

    def scaled(self, values: Float[Array, "feature"]) -> Float[Array, "feature"]:
        """Values of one case in -1 to 1."""
        return (values - self.low) / self.half - 1.0

    def unscaled(self, values: Float[Array, "feature"]) -> Float[Array, "feature"]:
        """The inverse of `scaled`."""
        return (values + 1.0) * self.half + self.low

    def holds(self, values: Float[Array, "feature"]) -> Bool[Array, "feature"]:
        """Which values of one case lie in the range, rounding (`SLACK`) granted; NaN does not."""
        return jnp.abs(self.scaled(values)) <= 1.0 + SLACK


class Parts(NamedTuple):
    """What every network is made of, and what its file holds."""

    perceptron: Perceptron
    inputs: Range
    outputs: Range


class Format(NamedTuple):
    """What a kind of network is called in its file, the version of the layout, and how many numbers lead in and out
    (None: any).
    """

    kind: str
    version: int
    ends: tuple[int, int] | None = None

    @property
    def mark(self) -> str:
        """What the file begins with."""
        return f"rotorjax {self.kind} {self.version}"


def write_parts(path: Path | str, form: Format, parts: Parts) -> None:
    """Write all numbers as JSON, to the last digit. **Errors.** `InputError` where the path cannot be written to."""
    numbers = {
        name: {field.name: np.asarray(getattr(part, field.name)).tolist() for field in dataclasses.fields(part)}
        for name, part in parts._asdict().items()
    }
    write_whole(Path(path), json.dumps({"format": form.mark, **numbers}, indent=1) + "\n")


def read_parts(path: Path | str, form: Format) -> Parts:
    """Read what `write_parts` wrote. **Errors.** ``ValueError`` for another format, numbers missing, or shapes that do
    not fit.
    """
    text = read_text(Path(path))
    try:
        content: dict[str, Any] = json.loads(text)
        if content["format"] != form.mark:
            raise ValueError(f"its format is {content['format']!r} instead of {form.mark!r}")
        parts = Parts(Perceptron(**content["perceptron"]), Range(**content["inputs"]), Range(**content["outputs"]))
        (hidden, features), (targets,) = parts.perceptron.weight_in.shape, parts.perceptron.bias_out.shape
        expected = [
            (hidden, features),
            (hidden,),
            (targets, hidden),
            (targets,),
            (features,),
            (features,),
            (targets,),
            (targets,),
        ]
        if [leaf.shape for leaf in jax.tree.leaves(parts)] != expected:
            raise ValueError("shapes do not fit together")
        if form.ends not in (None, (features, targets)):
            raise ValueError(
                f"it leads from {features} numbers to {targets} instead of {form.ends[0]} to {form.ends[1]}"
            )
    except (KeyError, TypeError, AttributeError, ValueError) as error:
        raise ValueError(
            f"{path}: not a {form.kind} that rotorjax wrote ({error}); train it anew and save it"
        ) from error
    return parts


FORMAT = Format("network", 2)


class FaultNetwork(eqx.Module):
    """Faults (U_x, U_y, s_x, s_y) [kg m, m] from features (f1, f2, f3, f4) [m] of one speed, by a trained perceptron.

    Called with the features of one case; differentiable; `diagnose` takes many and checks them. Source: Huang et al.
    2026, Sensors 26:2565, section 2.2 (4-40-4 neurons).
    """

    perceptron: Perceptron
    inputs: Range
    outputs: Range

    def __call__(self, features: Float[Array, "feature"]) -> Float[Array, "target"]:
        """Faults of one case."""
        return self.outputs.unscaled(self.perceptron(self.inputs.scaled(features)))

    def diagnose(self, features: Float[AnyArray, "*case feature"]) -> Float[np.ndarray, "*case target"]:
        """Faults [kg m, kg m, m, m] of many cases, from features [m]; both (..., 4).

        It knows nothing beyond the range it was trained in, and answers there all the same: ask `within` which cases to
        believe.

        **Errors.** ``ValueError`` in single precision, for features that are not finite or not four to a case.
        """
        return _each(self, self._checked(features))

    def within(self, features: Float[AnyArray, "*case feature"]) -> Bool[np.ndarray, "*case"]:
        """Which cases have every feature [m] in the range trained, with a margin of 1e-9 of half that range.
        **Errors.** As for `diagnose`.
        """
        return np.asarray(np.all(_each(self.inputs.holds, self._checked(features)), axis=-1))

    def save(self, path: Path | str) -> None:
        """Write all numbers as JSON, to the last digit. **Errors.** `InputError` where the path cannot be
        written to.
        """
        write_parts(path, FORMAT, Parts(self.perceptron, self.inputs, self.outputs))

    @classmethod
    def load(cls, path: Path | str) -> "FaultNetwork":
        """Read what `save` wrote. **Errors.** ``ValueError`` for another file."""
        return cls(*read_parts(path, FORMAT))

    def _checked(self, features: Float[AnyArray, "*case feature"]) -> Float[np.ndarray, "*case feature"]:
        require_float64("a diagnosis")
        return checked_features(features, self.inputs.low.shape[0])


@eqx.filter_jit
def _many(one: Callable[[Array], Array], features: Float[Array, "sample feature"]) -> Shaped[Array, "sample target"]:
    return jax.vmap(one)(features)


def _each(
    one: Callable[[Array], Array], features: Float[np.ndarray, "*case feature"]
) -> Shaped[np.ndarray, "*case target"]:
    """A function of one case, of many."""
    found = np.asarray(_many(one, jnp.asarray(features.reshape(-1, features.shape[-1]))))
    return found.reshape(*features.shape[:-1], found.shape[-1])
