"""Every test runs in double precision, with rank promotion refused and warnings as errors; shapes are checked but where
explanations run in series.
"""

import os
from pathlib import Path

import jaxtyping
from jaxtyping import install_import_hook

install_import_hook("rotorjax", "beartype.beartype")

import hypothesis
import jax
import matplotlib
import numpy as np
import pytest
from threadpoolctl import threadpool_limits

from rotorjax.batch.pool import ONE_THREAD

jax.config.update("jax_enable_x64", True)
jax.config.update("jax_numpy_rank_promotion", "raise")
matplotlib.use("Agg")
jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.3)
hypothesis.settings.register_profile("seeded", derandomize=True, deadline=None, max_examples=30)
hypothesis.settings.load_profile("seeded")


def pytest_configure(config):
    """What one process compiles serves the others, those that tests start, and the next run."""
    folder = os.environ.setdefault("JAX_COMPILATION_CACHE_DIR", str(config.rootpath / ".pytest_cache" / "compiled"))
    jax.config.update("jax_compilation_cache_dir", folder)
    if "PYTEST_XDIST_WORKER" in os.environ:
        # One of several processes on this machine: threads of each would wait for those of the others.
        os.environ.update(ONE_THREAD)
        threadpool_limits(1)


SERIES = ("crosscode", "measured", "paper", "recovery")
"""Folders whose tests run code over and over that the others run with shapes checked: the checks took a third of their
time.
"""


@pytest.fixture(autouse=True, scope="module")
def shapes_checked(request):
    jaxtyping.config.update("jaxtyping_disable", request.path.parent.name in SERIES)


MOST_MAPS = 30_000
"""Memory maps of this process from which on compiled programs are dropped: Linux grants 65530 (vm.max_map_count), and a
compilation beyond them ends it (SIGSEGV).
"""


@pytest.fixture(autouse=True)
def spare_memory_maps():
    maps = Path("/proc/self/maps")
    if maps.exists() and maps.read_bytes().count(b"\n") > MOST_MAPS:
        jax.clear_caches()


@pytest.fixture
def paper_rotor():
    """The rig of Huang et al. 2026, table 3, with the mass that reproduces its natural frequencies."""
    from rotorjax import Jeffcott

    return Jeffcott(0.9686, [56538.0, 51282.0], [0.0050, 0.0047])


@pytest.fixture
def rng():
    return np.random.default_rng(20260417)
