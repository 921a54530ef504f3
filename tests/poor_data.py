"""Less of a measurement."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np


def cut(measurement, cases: list[int], *, probe: int | None = None):
    """Some cases of a measurement, of all probes but one."""
    present = measurement.present[cases].copy()
    if probe is not None:
        present[:, probe] = False
    used = sorted(set(measurement.run[cases].tolist()))
    return dataclasses.replace(
        measurement,
        runs=tuple(measurement.runs[k] for k in used),
        run=np.array([used.index(k) for k in measurement.run[cases]]),
        repeat=("",) * len(cases),
        conditions=jax.tree.map(lambda values: values[jnp.array(cases)], measurement.conditions),
        vectors=np.where(present, measurement.vectors[cases], 0.0),
        present=present,
        sigma=measurement.sigma[cases],
    )
