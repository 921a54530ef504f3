"""rotorjax beside what one would use without it, in one run on one machine: ratios count, not seconds.

    python benchmarks/run.py

Response of 100,000 rotors at 7 speeds, with its Jacobian, beside vectorised NumPy with central differences; one fit
beside `scipy.optimize.least_squares` on a vectorised NumPy model; the catalogue ranked on 60 conditions beside one such
fit per hypothesis and start; harmonic balance beside integration in time; the whole of `explain`; import time; commands
from start to end, with an empty and with a filled compilation cache. Best of several runs each, but for the longest;
the results of both sides are compared first.
"""

import os
import subprocess
import sys
import tempfile
from importlib.resources import as_file, files
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
from explaining import DATA
from harmonic_balance import rows as balance_rows
from ranking import HIDDEN, LINEAR, rank, rank_with_scipy, sixty_conditions
from scipy.optimize import least_squares
from timing import best

from rotorjax import Conditions, Jeffcott, Model, effects, fit, read_measurement, read_rig
from rotorjax.physics.response import vectors
from rotorjax.reporting.tables import Table

ROTORS, SPEEDS = 100_000, np.linspace(60.0, 360.0, 7)


def numpy_response(p: np.ndarray, speed: np.ndarray) -> np.ndarray:
    """(M, kx, ky, ζx, ζy, Ux, Uy, sx, sy) per rotor -> vectors, rotor x speed x probe."""
    mass, stiffness, ratio = p[:, 0, None, None], p[:, None, 1:3], p[:, None, 3:5]
    forward = np.array([1.0, -1j])
    unbalance, bow = (
        (p[:, 5] + 1j * p[:, 6])[:, None, None] * forward,
        (p[:, 7] + 1j * p[:, 8])[:, None, None] * forward,
    )
    omega = speed[None, :, None]
    dynamic = stiffness - mass * omega**2 + 2j * omega * ratio * np.sqrt(stiffness * mass)
    return (unbalance * omega**2 + stiffness * bow) / dynamic


def numpy_jacobian(p: np.ndarray, speed: np.ndarray) -> np.ndarray:
    """Central differences over the nine parameters."""
    columns = []
    for k in range(p.shape[1]):
        step = 1e-6 * np.abs(p[:, k])
        up, down = p.copy(), p.copy()
        up[:, k] += step
        down[:, k] -= step
        columns.append((numpy_response(up, speed) - numpy_response(down, speed)) / (2.0 * step)[:, None, None])
    return np.stack(columns, axis=-1)


def jax_response(p: jax.Array) -> jax.Array:
    conditions = Conditions(
        jnp.asarray(SPEEDS), jnp.tile(p[5:7], (len(SPEEDS), 1, 1)), jnp.tile(p[7:9], (len(SPEEDS), 1))
    )
    return vectors(Model(Jeffcott(p[0], p[1:3], p[3:5])), conditions)[:, :, 0]


def split(p: jax.Array) -> jax.Array:
    z = jax_response(p)
    return jnp.stack([z.real, z.imag])


def response_rows() -> list[list[str]]:
    rng = np.random.default_rng(0)
    centre = np.array([0.9686, 56538.0, 51282.0, 0.02, 0.02, 6e-6, 2e-6, 1e-4, 2e-4])
    many = centre * (1.0 + 0.1 * rng.standard_normal((ROTORS, 9)))
    ours, slopes = jax.jit(jax.vmap(jax_response)), jax.jit(jax.vmap(jax.jacfwd(split)))
    p = jnp.asarray(many)
    np.testing.assert_allclose(ours(p), numpy_response(many, SPEEDS), rtol=1e-9)
    some = many[:100]
    found = np.asarray(slopes(jnp.asarray(some)))
    peer = numpy_jacobian(some, SPEEDS)
    scale = np.max(np.abs(peer), axis=(0, 1, 2))
    np.testing.assert_allclose((found[:, 0] + 1j * found[:, 1]) / scale, peer / scale, atol=1e-6)
    pairs = [
        ("response, 1e5 rotors x 7 speeds", lambda: ours(p).block_until_ready(), lambda: numpy_response(many, SPEEDS)),
        (
            "the same with Jacobian (9 parameters)",
            lambda: slopes(p).block_until_ready(),
            lambda: numpy_jacobian(many, SPEEDS),
        ),
    ]
    return [row(name, best(mine), "NumPy", best(peer, 2)) for name, mine, peer in pairs]


def row(name: str, ours: float, peer_name: str, peer: float | None) -> list[str]:
    ratio = "" if peer is None else f"{peer / ours:.1f}"
    return [name, f"{ours:.3f}", peer_name, "" if peer is None else f"{peer:.3f}", ratio]


def fit_row() -> list[str]:
    with as_file(files("rotorjax") / "data" / "example") as folder:
        rig = read_rig(folder / "rig.toml")
        measurement = read_measurement(folder / "measurement.csv", rig)
    model = rig.model + effects.ResidualUnbalance() + effects.CrossCoupling()
    ours = fit(model, measurement, held_out=False)
    entries = [e for e in ours.stage.space.entries if ours.stage.free[e.unknown]]
    scale = np.array([e.scale for e in entries])
    keys = [e.key for e in entries]
    speed = np.asarray(measurement.conditions.speed)
    installed = np.asarray(measurement.conditions.unbalance)[:, 0] @ np.array([1.0, 1j])
    mass, stiffness, damping = (np.asarray(getattr(rig.model.rotor, n)) for n in ("mass", "stiffness", "damping"))

    def residual(u: np.ndarray) -> np.ndarray:
        value = dict(zip(keys, scale * u, strict=True))
        k = stiffness * np.exp([value["stiffness_error.error_x"], value["stiffness_error.error_y"]])
        c = damping * np.exp([value["damping_error.log_ratio_x"], value["damping_error.log_ratio_y"]])
        unbalance = (
            installed + value["residual_unbalance.unbalance_x_kg_m"] + 1j * value["residual_unbalance.unbalance_y_kg_m"]
        )
        cross = value["cross_coupling.cross_stiffness_n_per_m"]
        d = k - mass * speed[:, None] ** 2 + 1j * speed[:, None] * c
        force = (unbalance * speed**2)[:, None] * np.array([1.0, -1j])
        determinant = d[:, 0] * d[:, 1] + cross**2
        z = (
            np.stack([d[:, 1] * force[:, 0] - cross * force[:, 1], d[:, 0] * force[:, 1] + cross * force[:, 0]], 1)
            / determinant[:, None]
        )
        error = ((z - measurement.vectors[:, :, 0]) / measurement.sigma[:, :, 0]).ravel()
        return np.concatenate([error.real, error.imag, u])

    peer = least_squares(residual, np.zeros(len(keys)), method="lm")
    point = ours.end.point[[e.unknown for e in entries]]
    np.testing.assert_allclose(0.5 * np.sum(residual(point) ** 2), peer.cost, rtol=1e-4)
    np.testing.assert_allclose(point, peer.x, atol=0.02)
    mine = best(lambda: fit(model, measurement, held_out=False), 3)
    theirs = best(lambda: least_squares(residual, np.zeros(len(keys)), method="lm"), 3)
    return row("one fit, 7 parameters x 72 vectors, warm", mine, "SciPy least_squares", theirs)


def ranking_rows() -> list[list[str]]:
    model, measurement = sixty_conditions()
    contest, contenders = rank(model, measurement, LINEAR)
    costs, evaluations = rank_with_scipy(contest, model)
    for name, cost in costs.items():
        np.testing.assert_allclose(contenders[frozenset([name])].best.cost, cost, rtol=1e-3, atol=0.05, err_msg=name)
    mine = best(lambda: rank(model, measurement, LINEAR))
    theirs = best(lambda: rank_with_scipy(contest, model), 3)
    rows = [
        row(
            f"21 linear effects on 60 conditions, warm ({evaluations} peer evaluations)",
            mine,
            "SciPy per hypothesis",
            theirs,
        )
    ]
    for hidden in HIDDEN:
        sixty = sixty_conditions(hidden)
        rank(*sixty)
        rows.append(
            row(
                f"whole catalogue with restoring forces, {hidden} hidden, warm",
                best(lambda sixty=sixty: rank(*sixty), 2),
                "",
                None,
            )
        )
    with tempfile.TemporaryDirectory() as cache:
        environment = {
            **os.environ,
            "JAX_COMPILATION_CACHE_DIR": cache,
            "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS": "0.1",
        }
        program = [sys.executable, str(Path(__file__).parent / "ranking.py")]

        for hidden in HIDDEN:

            def call(hidden: str = hidden) -> object:
                return subprocess.run([*program, hidden], check=True, env=environment, capture_output=True)

            for path in Path(cache).iterdir():
                path.unlink()
            rows.append(row(f"a new process that ranks twice, {hidden} hidden, empty cache", best(call, 1), "", None))
            rows.append(row("the same, filled cache", best(call, 2), "", None))
        said = subprocess.run(program, check=True, env=environment, capture_output=True, text=True).stdout
        rows.append(["its peak memory [GB]", said.split(",")[2].split()[0], "", "", ""])
    return rows


def command_rows() -> list[list[str]]:
    with as_file(files("rotorjax") / "data" / "example") as folder, tempfile.TemporaryDirectory() as cache:
        data = [str(folder / "measurement.csv"), "--rig", str(folder / "rig.toml")]
        commands = {
            "rotorjax effects": ["effects"],
            "rotorjax compare": ["compare", *data],
            "rotorjax compare --effect residual_unbalance": ["compare", *data, "--effect", "residual_unbalance"],
            "rotorjax explain": ["explain", *data],
        }
        environment = {**os.environ, "JAX_COMPILATION_CACHE_DIR": cache}
        rows = [
            row(
                "import rotorjax",
                best(lambda: python("import rotorjax", environment), 3),
                "import jax",
                best(lambda: python("import jax", environment), 3),
            )
        ]
        for name, arguments in commands.items():
            for path in Path(cache).iterdir():
                path.unlink()

            def call(arguments: list[str] = arguments) -> object:
                return subprocess.run(
                    [sys.executable, "-m", "rotorjax.cli", *arguments], check=True, capture_output=True, env=environment
                )

            rows.append(row(f"{name}, empty cache", best(call, 1), "", None))
            rows.append(row(f"{name}, filled cache", best(call, 3), "", None))
    return rows


def explain_rows() -> list[list[str]]:
    rows = []
    for name in DATA:
        program = [sys.executable, str(Path(__file__).parent / "explaining.py"), name]
        with tempfile.TemporaryDirectory() as cache:
            environment = {**os.environ, "JAX_COMPILATION_CACHE_DIR": cache}
            said = subprocess.run(program, check=True, env=environment, capture_output=True, text=True).stdout
        first, again = (float(s) for s in said.split())
        rows += [row(f"explain, {name}: first in a process", first, "", None), row("the same again", again, "", None)]
    return rows


def python(code: str, environment: dict[str, str]) -> object:
    return subprocess.run([sys.executable, "-c", code], check=True, env=environment)


def main() -> None:
    jax.config.update("jax_enable_x64", True)
    rows = [*response_rows(), fit_row(), *ranking_rows(), *balance_rows(), *explain_rows(), *command_rows()]
    print(Table("", ["what", "rotorjax s", "peer", "peer s", "peer / ours"], rows).text())


if __name__ == "__main__":
    main()
