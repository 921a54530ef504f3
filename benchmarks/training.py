"""Training the fault network: time to a given error, beside what one would use without rotorjax.

The paper's cases at 1500 rpm (7000 to train on, 1500 to test), features and faults scaled to -1 to 1, 4-40-4 neurons,
tanh, seed 0. Every method runs in a fresh process under a time limit, so that one which fails or hangs leaves the
others alone: ours (default, as published, Optax with L2), scikit-learn's `MLPRegressor` with L-BFGS, pyrenn's
Levenberg-Marquardt, optimistix's on the same perceptron, and exact linear least squares, which is no network but what
any of them can hope for. scikit-learn and pyrenn are the extra ``benchmark``; a row says if one is missing. Ratios
count, not seconds.

    python benchmarks/training.py
"""

import argparse
import contextlib
import importlib.util
import io
import json
import math
import os
import re
import subprocess
import sys
import time
import warnings
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from rotorjax.reporting.tables import Table, number

SPEED_RPM, COUNT, SEED, HIDDEN = 1500.0, 10_000, 0, 40
LIMIT_S = 240.0
"""Time after which a method is asked to stop, where it can be; as published, a thousand epochs take a minute."""
GRACE_S = 60.0
"""Further time until its process is ended."""
AGAIN_S = 20.0
"""A method of ours that took no longer runs once more, compiled."""
GOALS = (1e-1, 1e-2, 1e-4)
"""Root mean square errors in scaled targets to which the time is told."""
PYRENN_STEPS, OPTIMISTIX_STEPS, OPTAX_STEPS = 150, 100, 2000
TO_UNITS = np.array([1e6, 1e6, 1e3, 1e3])
"""Faults in kg m and m to g mm and mm."""
HISTORY, RESULT = "history", "result"
"""First words of the lines that a method's process prints."""


class OutOfTimeError(Exception):
    """A method is past its limit and has weights to show."""


class Recorder:
    """Prints the error after every step with the time, for the process that waits."""

    def __init__(self) -> None:
        self.begin = time.perf_counter()
        self.out = sys.stdout

    def seconds(self) -> float:
        """Since the method began."""
        return time.perf_counter() - self.begin

    def __call__(self, rms: float) -> None:
        """After a step."""
        print(HISTORY, f"{self.seconds():.4f} {rms:.6e}", file=self.out, flush=True)

    def limit(self) -> None:
        """Raise when the time is up."""
        if self.seconds() > LIMIT_S:
            raise OutOfTimeError


class Cases(NamedTuple):
    """The same cases for everyone; x and t are features and targets in -1 to 1."""

    x: np.ndarray
    t: np.ndarray
    x_test: np.ndarray
    t_test: np.ndarray
    half: np.ndarray
    """Half ranges of the faults [kg m, kg m, m, m]."""


Predict = Callable[[np.ndarray], np.ndarray]


def paper_cases():
    """Training and test cases, as the study of the paper has them."""
    import jax  # noqa: PLC0415  here and below: a peer's process loads only what it needs

    jax.config.update("jax_enable_x64", True)
    from rotorjax.diagnosis.dataset import make_dataset, split  # noqa: PLC0415
    from rotorjax.paper.printed import rotor  # noqa: PLC0415

    draw, parts = jax.random.split(jax.random.key(SEED))
    data = split(make_dataset(rotor(), SPEED_RPM, COUNT, key=draw), key=parts)
    return data.train, data.test


def scaled(train_cases, test_cases) -> Cases:
    """Both parts, scaled by the range of the first."""
    import jax  # noqa: PLC0415
    import jax.numpy as jnp  # noqa: PLC0415

    from rotorjax.diagnosis.network import Range  # noqa: PLC0415

    inputs, outputs = Range.of(train_cases.features, "features"), Range.of(train_cases.faults, "faults")
    parts = [
        np.asarray(jax.vmap(side.scaled)(jnp.asarray(values)))
        for part in (train_cases, test_cases)
        for side, values in ((inputs, part.features), (outputs, part.faults))
    ]
    return Cases(*parts, np.asarray(outputs.half))


def exact(cases: Cases, recorder: Recorder) -> tuple[Predict, str]:
    """Affine least squares."""
    weights = np.linalg.lstsq(extended(cases.x), cases.t, rcond=None)[0]
    return lambda x: extended(x) @ weights, "no network"


def extended(x: np.ndarray) -> np.ndarray:
    return np.concatenate([x, np.ones((len(x), 1))], axis=1)


def rotorjax_default(cases: Cases, recorder: Recorder) -> tuple[Predict, str]:
    from rotorjax.diagnosis.training import Whitened  # noqa: PLC0415

    return rotorjax_method(Whitened(), cases, recorder)


def rotorjax_published(cases: Cases, recorder: Recorder) -> tuple[Predict, str]:
    from rotorjax.diagnosis.training import BayesianRegularisation  # noqa: PLC0415

    return rotorjax_method(BayesianRegularisation(), cases, recorder)


def rotorjax_optax(cases: Cases, recorder: Recorder) -> tuple[Predict, str]:
    from rotorjax.diagnosis.training import OptaxL2  # noqa: PLC0415

    return rotorjax_method(OptaxL2(steps=OPTAX_STEPS), cases, recorder)


def rotorjax_method(method, cases: Cases, recorder: Recorder) -> tuple[Predict, str]:
    import jax  # noqa: PLC0415
    import jax.numpy as jnp  # noqa: PLC0415

    from rotorjax.diagnosis.evidence_steps import Scaled  # noqa: PLC0415

    data = Scaled(jnp.asarray(cases.x), jnp.asarray(cases.t))
    perceptron, _, stopped = method.fit(data, HIDDEN, jax.random.key(SEED), lambda epoch, rms: recorder(rms))
    return many(perceptron), stopped


def many(perceptron) -> Predict:
    """A perceptron for many cases."""
    import jax  # noqa: PLC0415
    import jax.numpy as jnp  # noqa: PLC0415

    return lambda x: np.asarray(jax.vmap(perceptron)(jnp.asarray(x)))


def scikit_learn(cases: Cases, recorder: Recorder) -> tuple[Predict, str]:
    return mlp(cases, recorder)


def scikit_learn_long(cases: Cases, recorder: Recorder) -> tuple[Predict, str]:
    return mlp(cases, recorder, max_iter=5000, tol=0.0, max_fun=1_000_000)


def mlp(cases: Cases, recorder: Recorder, **settings: float) -> tuple[Predict, str]:
    from sklearn.exceptions import ConvergenceWarning  # noqa: PLC0415
    from sklearn.neural_network import MLPRegressor  # noqa: PLC0415

    network = MLPRegressor(
        hidden_layer_sizes=(HIDDEN,), activation="tanh", solver="lbfgs", random_state=SEED, **settings
    )
    evaluate = getattr(network, "_loss_grad_lbfgs", None)
    if evaluate is not None:  # private, but L-BFGS has no other history; without it the row has none

        def recorded(*arguments: object) -> tuple:
            loss, gradient = evaluate(*arguments)
            recorder(
                math.sqrt(2.0 * loss)
            )  # the loss is half the mean square, with a weight decay that is small beside it
            return loss, gradient

        network._loss_grad_lbfgs = recorded
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ConvergenceWarning)
        network.fit(cases.x, cases.t)
    return network.predict, f"after {network.n_iter_} steps"


class FromPrint(io.TextIOBase):
    """Takes what pyrenn prints after every step to the recorder: it has no other way to look on."""

    def __init__(self, recorder: Recorder, numbers: int) -> None:
        self.recorder, self.numbers, self.line, self.steps = recorder, numbers, "", 0

    def write(self, text: str) -> int:
        """A piece of a printed line."""
        self.line += text
        if self.line.endswith("\n"):
            told = re.search(r"Error:\s+(\S+)", self.line)
            if told:
                self.recorder(math.sqrt(float(told[1]) / self.numbers))
                self.steps += 1
                self.recorder.limit()
            self.line = ""
        return len(text)


def pyrenn_lm(cases: Cases, recorder: Recorder) -> tuple[Predict, str]:
    import pyrenn  # noqa: PLC0415

    np.random.seed(SEED)  # noqa: NPY002  pyrenn draws its first weights from here
    network = pyrenn.CreateNN([cases.x.shape[1], HIDDEN, cases.t.shape[1]])
    printed = FromPrint(recorder, cases.t.size)
    stopped = ""
    with contextlib.redirect_stdout(printed):
        try:
            # Features times samples; a step is only printed once its weights are in the network.
            network = pyrenn.train_LM(cases.x.T, cases.t.T, network, k_max=PYRENN_STEPS, E_stop=0.0, verbose=True)
        except OutOfTimeError:
            stopped = f", stopped at {LIMIT_S:.0f} s"
    return lambda x: pyrenn.NNOut(x.T, network).T, f"after {max(printed.steps - 1, 0)} steps{stopped}"


def optimistix_lm(cases: Cases, recorder: Recorder) -> tuple[Predict, str]:
    """Step by step, as optimistix's page on interactive solves shows, so that every step can be timed."""
    import equinox as eqx  # noqa: PLC0415
    import jax  # noqa: PLC0415
    import jax.numpy as jnp  # noqa: PLC0415
    import optimistix as optx  # noqa: PLC0415

    from rotorjax.diagnosis.training import nguyen_widrow  # noqa: PLC0415

    x, t = jnp.asarray(cases.x), jnp.asarray(cases.t)

    def residual(perceptron, _: None) -> tuple:
        return jax.vmap(perceptron)(x) - t, None

    start = nguyen_widrow(jax.random.key(SEED), x.shape[1], HIDDEN, t.shape[1])
    solver = optx.LevenbergMarquardt(rtol=0.0, atol=0.0)
    tags: frozenset = frozenset()
    state = solver.init(residual, start, None, {}, jax.eval_shape(lambda: t), None, tags)
    step = eqx.filter_jit(lambda y, state: solver.step(residual, y, None, {}, state, tags)[:2])
    squares = eqx.filter_jit(lambda y: jnp.mean(residual(y, None)[0] ** 2))
    weights, made = start, 0
    while made < OPTIMISTIX_STEPS and recorder.seconds() < LIMIT_S:
        weights, state = step(weights, state)
        recorder(math.sqrt(float(squares(weights))))
        made += 1
    return many(weights), f"after {made} steps" + ("" if made == OPTIMISTIX_STEPS else f", stopped at {LIMIT_S:.0f} s")


class Contender(NamedTuple):
    """A method: name in the table, how it is run, the module that it needs."""

    name: str
    fit: Callable[[Cases, Recorder], tuple[Predict, str]]
    needs: str = "rotorjax"
    compiled: bool = False


CONTENDERS = {
    "default": Contender("rotorjax, default", rotorjax_default, compiled=True),
    "published": Contender("rotorjax, as published", rotorjax_published, compiled=True),
    "optax": Contender("rotorjax, Optax L2", rotorjax_optax, compiled=True),
    "exact": Contender("exact linear least squares", exact),
    "sklearn": Contender("scikit-learn L-BFGS, defaults", scikit_learn, "sklearn"),
    "sklearn-long": Contender("scikit-learn L-BFGS, long", scikit_learn_long, "sklearn"),
    "pyrenn": Contender("pyrenn LM", pyrenn_lm, "pyrenn"),
    "optimistix": Contender("optimistix LM", optimistix_lm, "optimistix"),
}


def compete(contender: Contender) -> dict[str, object]:
    """Run a method in this process and measure what it reached on the test cases."""
    if importlib.util.find_spec(contender.needs) is None:
        return {"missing": contender.needs}
    cases = scaled(*paper_cases())
    recorder = Recorder()
    predict, stopped = contender.fit(cases, recorder)
    seconds = recorder.seconds()
    missed = np.asarray(predict(cases.x_test)) - cases.t_test
    errors = np.sqrt(np.mean((missed * cases.half * TO_UNITS) ** 2, axis=0))
    unbalance, bow = (float(np.sqrt(np.mean(pair**2))) for pair in (errors[:2], errors[2:]))
    again = None
    if contender.compiled and seconds < AGAIN_S:
        silent = Recorder()
        silent.out = io.StringIO()
        contender.fit(cases, silent)
        again = silent.seconds()
    rms = float(np.sqrt(np.mean(missed**2)))
    return {"seconds": seconds, "again": again, "rms": rms, "unbalance": unbalance, "bow": bow, "stopped": stopped}


def first_below(goal: float, history: list[tuple[float, float]], result: dict) -> float | None:
    """Seconds until the error was below a goal; the whole time where only the end is known to be."""
    within = next((seconds for seconds, rms in history if rms <= goal), None)
    return result["seconds"] if within is None and result.get("rms", math.inf) <= goal else within


def read(lines: list[str]) -> tuple[list[tuple[float, float]], dict]:
    """History and result of what a method's process printed, however far it came."""
    history, result = [], {}
    for line in lines:
        kind, _, rest = line.partition(" ")
        if kind == HISTORY and len(rest.split()) == 2:
            seconds, rms = map(float, rest.split())
            history.append((seconds, rms))
        elif kind == RESULT:
            result = json.loads(rest)
    return history, result


def row(key: str) -> list[str]:
    """A method in a fresh process, which compiles all anew."""
    name, limit = CONTENDERS[key].name, LIMIT_S + GRACE_S
    environment = {k: v for k, v in os.environ.items() if k != "JAX_COMPILATION_CACHE_DIR"}
    failed = "its process ended without a result"
    try:
        done = subprocess.run(
            [sys.executable, __file__, key], capture_output=True, text=True, timeout=limit, env=environment, check=False
        )
        said = done.stdout
        if done.returncode != 0:
            failed = (done.stderr.strip().splitlines() or [failed])[-1]
    except subprocess.TimeoutExpired as late:
        # Bytes even where text was asked for.
        said = late.stdout.decode() if isinstance(late.stdout, bytes) else late.stdout or ""
        failed = f"ended after {limit:.0f} s"
    history, result = read(said.splitlines())
    if "missing" in result:
        failed = f"{result['missing']} is not installed; pip install rotorjax[benchmark]"
    goals = [number(first_below(goal, history, result)) for goal in GOALS]
    if "rms" not in result:
        return [name, "-", "-", "-", "-", "-", *goals, f"not measured: {failed}"]
    told = [number(result[key]) for key in ("seconds", "again", "rms", "unbalance", "bow")]
    return [name, *told, *goals, result["stopped"]]


def table(keys: tuple[str, ...] = tuple(CONTENDERS)) -> Table:
    """All methods, one after the other: some minutes."""
    heads = [
        "method",
        "s",
        "s again",
        "normalised RMSE",
        "U g mm",
        "s mm",
        *(f"s to {goal:.0e}" for goal in GOALS),
        "ended",
    ]
    note = (
        "s: the first call in a new process, with compilation; again: the second call. Normalised RMSE: in targets "
        "scaled to -1 to 1, on noise-free test\n"
        "cases; U and s: of both components together. Seconds to an error follow the training cases, of nearly the "
        "same error."
    )
    return Table(
        "Training the 4-40-4 network on 7000 noise-free cases at 1500 rpm", heads, [row(key) for key in keys], note
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument(
        "method",
        nargs="?",
        choices=tuple(CONTENDERS),
        help="one method in this process, its history and result as lines",
    )
    parser.add_argument(
        "--only", nargs="+", choices=tuple(CONTENDERS), default=tuple(CONTENDERS), help="methods of the table (all)"
    )
    arguments = parser.parse_args()
    if arguments.method:
        print(RESULT, json.dumps(compete(CONTENDERS[arguments.method])))
    else:
        print(table(tuple(arguments.only)).text())


if __name__ == "__main__":
    main()
