"""What a user hands over as the arrays of a measurement, checked one by one."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from jaxtyping import Bool, Complex, Float, Int

from rotorjax.arrays import Numbers
from rotorjax.model.conditions import Conditions

SAME = 1e-6
"""Relative difference up to which what is installed in two cases is the same."""


def as_numbers(value: Numbers, what: str, kind: type) -> np.ndarray:
    """The value as an array of numbers of some kind; ``ValueError`` where it is none."""
    try:
        return np.asarray(value, kind)
    except (TypeError, ValueError) as error:
        raise ValueError(f"{what} is no array of {kind.__name__} numbers: {error}") from error


def _listed(values: Any, what: str, example: str) -> tuple[Any, ...]:
    try:
        listed = () if isinstance(values, str) else tuple(values)
    except TypeError:
        listed = ()
    if not listed:
        raise ValueError(f"{what} is {values!r}: write a list that is not empty, like {what}={example}")
    return listed


def _each_once(values: tuple[Any, ...], what: str) -> None:
    if twice := [value for k, value in enumerate(values) if value in values[:k]]:
        raise ValueError(f"{what} names {twice[0]!r} twice: every one of them needs a name of its own")


def checked_names(names: Sequence[str], what: str) -> tuple[str, ...]:
    """Names of runs or of probes, each once."""
    listed = _listed(names, what, '("a", "b")')
    if odd := [name for name in listed if not isinstance(name, str)]:
        raise ValueError(f"{what} holds {odd[0]!r}, which is no text: write names, like {what}=('a', 'b')")
    _each_once(listed, what)
    return tuple(str(name) for name in listed)


def checked_orders(orders: Numbers) -> tuple[float, ...]:
    """Orders, each once, none of them negative."""
    listed = tuple(float(n) for n in as_numbers(_listed(orders, "orders", "(1.0, 2.0)"), "orders", float))
    if odd := [n for n in listed if not (np.isfinite(n) and n >= 0.0)]:
        raise ValueError(f"orders holds {odd[0]:g}: an order is a multiple of the shaft's speed, zero or above")
    _each_once(listed, "orders")
    return listed


def measured_cells(
    vectors: Complex[np.ndarray, "case probe order"], conditions: Conditions, probes: int, orders: int
) -> Bool[np.ndarray, "case probe order"]:
    """Where something was measured, at conditions that there can be."""
    speed = np.asarray(conditions.speed)
    if speed.ndim != 1:
        raise ValueError(f"speeds have shape {speed.shape}: give one for each case, as Conditions.at does")
    if np.any(odd := ~(np.isfinite(speed) & (speed > 0.0))):
        case = int(np.argmax(odd))
        raise ValueError(f"the speed of case {case} is {speed[case]:g} rad/s: it must be positive and finite")
    for what, installed in (("unbalance", conditions.unbalance), ("bow", conditions.bow)):
        if not np.all(np.isfinite(np.asarray(installed))):
            raise ValueError(f"the {what} of the conditions must be finite, zero where nothing is installed")
    expected = (len(speed), probes, orders)
    if vectors.shape != expected:
        raise ValueError(
            f"vectors have shape {vectors.shape}; {expected[0]} conditions, {expected[1]} probes and {expected[2]} "
            f"orders need {expected}"
        )
    present = np.isfinite(vectors)
    if not present.any():
        raise ValueError("vectors holds no finite number: nothing was measured")
    return present


def checked_runs(run: Numbers | None, runs: tuple[str, ...], conditions: Conditions) -> Int[np.ndarray, "case"]:
    """The index of every case's run: each has a case, and the same is installed in all of its cases."""
    count = len(conditions.speed)
    index = np.zeros(count, int) if run is None else np.asarray(run)
    if index.shape != (count,) or not np.issubdtype(index.dtype, np.integer):
        raise ValueError(
            f"run has shape {index.shape} and type {index.dtype}: give each of {count} cases the index of its run in "
            "runs, a whole number, like run=[0, 0, 1]"
        )
    if np.any(odd := (index < 0) | (index >= len(runs))):
        raise ValueError(
            f"run {int(index[np.argmax(odd)])} is not among {', '.join(runs)}: give each of {count} cases the index of "
            "its run, from 0"
        )
    installed = np.asarray(conditions.unbalance), np.asarray(conditions.bow)
    for k, name in enumerate(runs):
        if not np.any(there := index == k):
            raise ValueError(f"run {name!r} has no case: leave it out of runs, or give its cases the index {k} in run")
        if any(np.ptp(v[there], axis=0).max() > SAME * np.abs(v[there]).max() for v in installed):
            raise ValueError(
                f"run {name!r} holds different installed unbalance or bow: give each its own run (run=, runs=)"
            )
    return index.astype(int)


def checked_sigma(sigma: Numbers, present: Bool[np.ndarray, "case probe order"]) -> Float[np.ndarray, "..."]:
    """The standard error of every cell."""
    given = as_numbers(sigma, "sigma", float)
    try:
        deviation = np.broadcast_to(given, present.shape).copy()
    except ValueError as error:
        raise ValueError(
            f"sigma has shape {given.shape}: give one number, or an array like the vectors, of shape {present.shape}"
        ) from error
    if not np.all((deviation[present] > 0.0) & np.isfinite(deviation[present])):
        raise ValueError("sigma must be positive and finite where something was measured; None where it is unknown")
    return deviation


def checked_repeat(repeat: Sequence[str] | None, count: int) -> tuple[str, ...]:
    """The label of every case's reading."""
    if repeat is None:
        return ("",) * count
    labels = _listed(repeat, "repeat", '("1", "2")')
    if len(labels) != count:
        raise ValueError(f"repeat has {len(labels)} labels for {count} cases: give one for each, '' for none")
    return tuple(str(label) for label in labels)
