"""Training data of the paper's rotor: fault cases and their features at one speed, in files.

Huang et al. 2026, Sensors 26:2565, section 2.2. May be stopped at any moment: the same call goes on where it was, and a
repeat gives the same files to the byte.

    python experiments/make_dataset.py --output output/dataset --count 10000 --speed-rpm 1500
"""

import argparse
import dataclasses
from pathlib import Path

import jax
from tqdm import tqdm

from rotorjax import Jeffcott
from rotorjax.batch.dataset_files import Recipe, stream


@dataclasses.dataclass(frozen=True)
class Config:
    """What is made: by default the paper's 10,000 cases (table 3, with the mass that reproduces its natural
    frequencies).
    """

    output: Path = Path("output/dataset")
    count: int = 10_000
    speed_rpm: float = 1500.0
    chunk: int = 250_000
    seed: int = 0
    mass_kg: float = 0.9686
    stiffness_n_per_m: tuple[float, float] = (56538.0, 51282.0)
    damping_ratio: tuple[float, float] = (0.0050, 0.0047)


def make(config: Config) -> None:
    rotor = Jeffcott(config.mass_kg, config.stiffness_n_per_m, config.damping_ratio)
    recipe = Recipe(rotor, config.speed_rpm, config.count, key=jax.random.key(config.seed), chunk=config.chunk)
    with tqdm(total=config.count, unit=" cases", unit_scale=True) as bar:
        stream(recipe, config.output, progress=lambda done, total: bar.update(done - bar.n))
    print(f"{config.count} cases at {config.speed_rpm:g} rpm are in {config.output}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--output", type=Path, default=Config.output, help="folder for the files (%(default)s)")
    parser.add_argument("--count", type=int, default=Config.count, help="cases (%(default)s)")
    parser.add_argument("--speed-rpm", type=float, default=Config.speed_rpm, help="speed of the shaft (%(default)s)")
    parser.add_argument("--chunk", type=int, default=Config.chunk, help="cases per file (%(default)s)")
    parser.add_argument("--seed", type=int, default=Config.seed, help="of JAX's random key (%(default)s)")
    jax.config.update("jax_enable_x64", True)
    try:
        make(Config(**vars(parser.parse_args())))
    except ValueError as error:
        parser.exit(2, f"{error}\n")
    except KeyboardInterrupt:
        parser.exit(130, "stopped; the same call goes on\n")


if __name__ == "__main__":
    main()
