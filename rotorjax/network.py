"""The network that turns features into faults: one hidden layer of tanh, between min-max scaled inputs and outputs."""

import json
from pathlib import Path
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Float

from rotorjax._core import AnyArray, as_float, require_float64
from rotorjax.features import checked_features
from rotorjax.io.files import read_text, write_whole

FORMAT = "rotorjax network 1"


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
            raise ValueError(f"{what}: column {column} is constant ({low[column - 1]:g}), so that nothing can be learned of it; draw cases that vary it")
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
        """Faults [kg m, kg m, m, m] of many cases, from features [m]; both (..., 4). It knows nothing beyond the range it was trained in.

        **Errors.** ``ValueError`` in single precision, for features that are not finite or not four to a case.
        """
        require_float64("a diagnosis")
        f = checked_features(features, self.inputs.low.shape[0])
        return np.asarray(_many(self, jnp.asarray(f.reshape(-1, f.shape[-1])))).reshape(*f.shape[:-1], -1)

    def save(self, path: Path | str) -> None:
        """Write all numbers as JSON, to the last digit."""
        path = Path(path)
        numbers = {name: np.asarray(leaf).tolist() for name, leaf in _named(self).items()}
        write_whole(path, json.dumps({"format": FORMAT, **numbers}, indent=1) + "\n")

    @classmethod
    def load(cls, path: Path | str) -> "FaultNetwork":
        """Read what `save` wrote. **Errors.** ``ValueError`` for another file."""
        path = Path(path)
        text = read_text(path)
        try:
            content: dict[str, Any] = json.loads(text)
            if content.pop("format") != FORMAT:
                raise KeyError("format")
            perceptron = Perceptron(*(content[name] for name in ("weight_in", "bias_in", "weight_out", "bias_out")))
            inputs, outputs = (Range(content[f"{side}_low"], content[f"{side}_high"]) for side in ("inputs", "outputs"))
            hidden, features = perceptron.weight_in.shape
            shapes = [np.shape(leaf) for leaf in (perceptron.bias_in, perceptron.weight_out, inputs.low, inputs.high, outputs.low, outputs.high)]
            targets = perceptron.bias_out.shape
            if shapes != [(hidden,), (*targets, hidden), (features,), (features,), targets, targets]:
                raise ValueError("shapes do not fit together")
        except (KeyError, TypeError, AttributeError, ValueError) as error:
            raise ValueError(f"{path}: not a network that rotorjax wrote ({error}); train it anew and save it") from error
        return cls(perceptron, inputs, outputs)


@eqx.filter_jit
def _many(network: FaultNetwork, features: Float[Array, "sample feature"]) -> Float[Array, "sample target"]:
    return jax.vmap(network)(features)


def _named(network: FaultNetwork) -> dict[str, Array]:
    p = network.perceptron
    sides = {"inputs": network.inputs, "outputs": network.outputs}
    ranges = {f"{side}_{end}": getattr(values, end) for side, values in sides.items() for end in ("low", "high")}
    return {"weight_in": p.weight_in, "bias_in": p.bias_in, "weight_out": p.weight_out, "bias_out": p.bias_out, **ranges}
