"""Training data for networks: fault cases drawn with their features, beside vectorised NumPy and a loop over cases.

Every program runs in a fresh process, which reports the time of its first call, the best of several later ones and the
largest memory that the process held; the features of all three are compared on the same faults first. The loop runs
10,000 cases, and its other times are that one in proportion. Then writing and reading back files. Ratios count, not
seconds.

    python benchmarks/dataset.py
"""

import argparse
import cmath
import json
import math
import random
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from rotorjax.reporting.tables import Table, number

MASS, STIFFNESS, RATIO = 0.9686, (56538.0, 51282.0), (0.0050, 0.0047)
SPEED_RPM, UNBALANCE, BOW = 1500.0, 1e-3, 0.05
COUNTS = (10_000, 100_000, 1_000_000, 10_000_000)
LOOP_COUNT = COUNTS[0]
FILES_COUNT, CHUNK = 4_000_000, 250_000
REPEATS = 5


def axis(k: int) -> tuple[float, float, float]:
    """τ, amplification A and phase lag λ along one axis."""
    tau = SPEED_RPM * math.pi / 30.0 / math.sqrt(STIFFNESS[k] / MASS)
    return tau, 1.0 / math.hypot(1.0 - tau**2, 2.0 * RATIO[k] * tau), math.atan2(2.0 * RATIO[k] * tau, 1.0 - tau**2)


def numpy_features(faults: np.ndarray) -> np.ndarray:
    """The paper's equations as one 4x4 matrix, formed once: the fastest of several ways to write them."""
    (tx, ax, lx), (ty, ay, ly) = axis(0), axis(1)
    x, y = ax * np.array([tx**2 / MASS, 1.0]), ay * np.array([ty**2 / MASS, 1.0])
    matrix = np.empty((4, 4))
    matrix[0] = np.outer(x, [math.cos(lx), math.sin(lx)]).ravel()
    matrix[1] = np.outer(x, [math.sin(lx), -math.cos(lx)]).ravel()
    matrix[2] = np.outer(y, [-math.sin(ly), math.cos(ly)]).ravel()
    matrix[3] = np.outer(y, [math.cos(ly), math.sin(ly)]).ravel()
    return faults @ matrix.T


def numpy_dataset(count: int, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    faults = np.empty((count, 4))
    for column, largest in ((0, UNBALANCE), (2, BOW)):
        size, angle = rng.uniform(0.0, largest, count), rng.uniform(0.0, 2.0 * np.pi, count)
        np.multiply(size, np.cos(angle), out=faults[:, column])
        np.multiply(size, np.sin(angle), out=faults[:, column + 1])
    return numpy_features(faults), faults


def loop_case(unbalance: complex, bow: complex) -> tuple[float, float, float, float]:
    """One case as equations 1-9 read, z = (k s + U Ω²) / (k - M Ω² + i c Ω), with no array in it."""
    speed = SPEED_RPM * math.pi / 30.0
    x, y = (
        (k * bow + unbalance * speed**2) / complex(k - MASS * speed**2, 2.0 * ratio * math.sqrt(k * MASS) * speed)
        for k, ratio in zip(STIFFNESS, RATIO, strict=True)
    )
    return x.real, -x.imag, y.imag, y.real


def loop_dataset(
    count: int, seed: int = 0
) -> list[tuple[tuple[float, float, float, float], tuple[float, float, float, float]]]:
    draw = random.Random(seed).random
    cases = []
    for _ in range(count):
        unbalance, bow = (cmath.rect(largest * draw(), 2.0 * math.pi * draw()) for largest in (UNBALANCE, BOW))
        cases.append((loop_case(unbalance, bow), (unbalance.real, unbalance.imag, bow.real, bow.imag)))
    return cases


def ours() -> Callable[[int], object]:
    import jax  # noqa: PLC0415  here and below: the peers' memory is without it

    from rotorjax import Jeffcott  # noqa: PLC0415
    from rotorjax.diagnosis.dataset import make_dataset  # noqa: PLC0415

    jax.config.update("jax_enable_x64", True)
    rotor, key = Jeffcott(MASS, STIFFNESS, RATIO), jax.random.key(0)
    return lambda count: jax.block_until_ready(make_dataset(rotor, SPEED_RPM, count, key=key))


def agree() -> None:
    """Raise unless all three give the same features for the same faults."""
    features, faults = map(np.asarray, ours()(LOOP_COUNT))  # pyright: ignore
    loop = np.array([loop_case(complex(*fault[:2]), complex(*fault[2:])) for fault in faults])
    for peer in (numpy_features(faults), loop):
        np.testing.assert_allclose(features, peer, rtol=0.0, atol=1e-12 * np.max(np.abs(peer)))


def files() -> dict[str, float]:
    """Seconds and bytes of a stream to a folder and back."""
    import jax  # noqa: PLC0415

    from rotorjax import Jeffcott  # noqa: PLC0415
    from rotorjax.batch.dataset_files import Recipe, read_dataset, stream  # noqa: PLC0415

    jax.config.update("jax_enable_x64", True)
    recipe = Recipe(Jeffcott(MASS, STIFFNESS, RATIO), SPEED_RPM, FILES_COUNT, key=jax.random.key(0), chunk=CHUNK)
    with tempfile.TemporaryDirectory() as folder:
        begin = time.perf_counter()
        stream(recipe, Path(folder))
        wrote = time.perf_counter()
        for _ in read_dataset(Path(folder)):
            pass
        read = time.perf_counter()
        size = sum(path.stat().st_size for path in Path(folder).iterdir())
    return {"write": wrote - begin, "read": read - wrote, "bytes": size, "peak": peak_mb()}


def peak_mb() -> float:
    """Largest memory that this process held [MB].

    On Linux from /proc: `resource` counts there what the parent held when it started this process.
    """
    status = Path("/proc/self/status")
    if status.exists():
        return (
            next(int(line.split()[1]) for line in status.read_text().splitlines() if line.startswith("VmHWM")) / 1024.0
        )
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / (1024.0**2 if sys.platform == "darwin" else 1024.0)


def timed(program: str, count: int) -> dict[str, float]:
    """First call, best later call and peak memory, in this process."""
    run = {"rotorjax": ours, "numpy": lambda: numpy_dataset, "loop": lambda: loop_dataset}[program]()
    times = []
    for _ in range(1 + REPEATS):
        begin = time.perf_counter()
        run(count)
        times.append(time.perf_counter() - begin)
    return {"first": times[0], "best": min(times[1:]), "peak": peak_mb()}


def fresh(*arguments: str) -> dict[str, float]:
    said = subprocess.run([sys.executable, __file__, *arguments], check=True, capture_output=True, text=True).stdout
    return json.loads(said)


def rows() -> list[list[str]]:
    """Cases; ours first call, later calls, peak; NumPy's; the loop's; ratios."""
    fresh("agree")
    loop = fresh("loop", str(LOOP_COUNT))
    table = []
    for count in COUNTS:
        mine, peer = fresh("rotorjax", str(count)), fresh("numpy", str(count))
        slow = loop["best"] * count / LOOP_COUNT
        table.append(
            [
                f"{count:.0e}".replace("+0", ""), number(mine["first"]), number(mine["best"]), number(peer["best"]),
                number(slow) + ("" if count == LOOP_COUNT else " (extrapolated)"),
                number(peer["best"] / mine["best"]), number(slow / mine["best"]), number(mine["peak"]),
                number(peer["peak"]),
            ]
        )  # fmt: skip
    return table


def file_rows() -> list[list[str]]:
    """Writing and reading back: seconds, cases per second, bytes per case, peak, seconds for 1e8 cases."""
    told = fresh("files")
    size, peak = number(told["bytes"] / FILES_COUNT), number(told["peak"])
    return [
        [
            what,
            number(told[what]),
            number(FILES_COUNT / told[what] / 1e6),
            size,
            peak,
            number(told[what] * 1e8 / FILES_COUNT),
        ]
        for what in ("write", "read")
    ]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument(
        "program",
        nargs="?",
        choices=("agree", "rotorjax", "numpy", "loop", "files"),
        help="one program in this process, as JSON",
    )
    parser.add_argument("count", nargs="?", type=int, default=COUNTS[0])
    arguments = parser.parse_args()
    if arguments.program == "agree":
        agree()
        print("{}")
    elif arguments.program == "files":
        print(json.dumps(files()))
    elif arguments.program:
        print(json.dumps(timed(arguments.program, arguments.count)))
    else:
        heads = [
            "cases",
            "first s",
            "rotorjax s",
            "NumPy s",
            "loop s",
            "NumPy / ours",
            "loop / ours",
            "rotorjax MB",
            "NumPy MB",
        ]
        print(Table("Fault cases with features, in memory", heads, rows()).text(), end="\n\n")
        heads = [
            f"{FILES_COUNT / 1e6:g}e6 cases",
            "s",
            "1e6 cases/s",
            "bytes/case",
            "peak MB",
            "s for 1e8, in proportion",
        ]
        print(Table(f"Files, {CHUNK:,} cases each", heads, file_rows()).text())


if __name__ == "__main__":
    main()
