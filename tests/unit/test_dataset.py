"""Training data: what is drawn, the paper's equations written out, parts, and files that survive being killed."""

import dataclasses
import hashlib
import json
import os
import signal
import subprocess
import sys
import zipfile

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import stats

from rotorjax import Jeffcott
from rotorjax.batch.dataset_files import Recipe, read_dataset, stream
from rotorjax.diagnosis import dataset
from rotorjax.diagnosis.dataset import Dataset, FaultPrior, make_dataset, sample_faults, split, with_noise
from rotorjax.diagnosis.features import fault_features, fault_values
from rotorjax.errors import InputError
from rotorjax.units import RPM

MASS, STIFFNESS, RATIO = 0.9686, (56538.0, 51282.0), (0.0050, 0.0047)
COUNT, CHUNK = 23, 5
KEY = jax.random.key(7)


@pytest.fixture
def recipe(paper_rotor):
    return Recipe(paper_rotor, 1500.0, COUNT, key=KEY, chunk=CHUNK)


@pytest.fixture
def whole(recipe, tmp_path):
    """Bytes of the files of an undisturbed stream."""
    stream(recipe, tmp_path / "whole")
    return contents(tmp_path / "whole")


def contents(folder) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in folder.iterdir()}


class Killed(BaseException):
    pass


# What is drawn


def test_prior_is_uniform_in_magnitudes_and_angles():
    faults = sample_faults(jax.random.key(1), 20_000)
    assert faults.shape == (20_000, 4)
    assert faults.dtype == np.float64
    values = fault_values(faults)
    for drawn, largest in zip(values, (1000.0, 360.0, 50.0, 360.0), strict=True):
        assert np.min(drawn) >= 0.0
        assert np.max(drawn) < largest * (1.0 + 1e-12)
        assert stats.kstest(drawn, stats.uniform(0.0, largest).cdf).pvalue > 0.01
    correlation = np.corrcoef(np.stack(values)) - np.eye(4)
    assert np.max(np.abs(correlation)) < 4.0 / np.sqrt(20_000)


def test_prior_of_other_sizes():
    values = fault_values(sample_faults(jax.random.key(1), 1000, FaultPrior(2e-6, 0.0)))
    assert 1.99 < np.max(values.unbalance_g_mm) < 2.0
    np.testing.assert_array_equal(values.bow_mm, 0.0)


@pytest.mark.parametrize("sizes", [(-1e-6, 0.05), (1e-3, np.inf), (np.nan, 0.05), (0.0, 0.0)])
def test_prior_refuses(sizes):
    with pytest.raises(
        ValueError,
        match=r"must be finite and not negative, and one of them positive, but are .*; give zero for the one that is "
        r"absent",
    ):
        FaultPrior(*sizes)


@pytest.mark.parametrize("speed_rpm", [1500.0, 2500.0])
def test_features_are_those_of_the_papers_equations(paper_rotor, speed_rpm):
    made = make_dataset(paper_rotor, speed_rpm, 200, key=KEY)
    unbalance_g_mm, alpha_deg, bow_mm, theta_deg = fault_values(made.faults)
    u, alpha, s, theta = unbalance_g_mm * 1e-6, np.radians(alpha_deg), bow_mm * 1e-3, np.radians(theta_deg)
    tau_x, tau_y = (speed_rpm * np.pi / 30.0 / np.sqrt(k / MASS) for k in STIFFNESS)
    a_x = 1.0 / np.sqrt((1.0 - tau_x**2) ** 2 + (2.0 * RATIO[0] * tau_x) ** 2)
    a_y = 1.0 / np.sqrt((1.0 - tau_y**2) ** 2 + (2.0 * RATIO[1] * tau_y) ** 2)
    lag_x = np.arctan2(2.0 * RATIO[0] * tau_x, 1.0 - tau_x**2)
    lag_y = np.arctan2(2.0 * RATIO[1] * tau_y, 1.0 - tau_y**2)
    f1 = a_x * (u * tau_x**2 / MASS * np.cos(alpha - lag_x) + s * np.cos(theta - lag_x))
    f2 = -a_x * (u * tau_x**2 / MASS * np.sin(alpha - lag_x) + s * np.sin(theta - lag_x))
    f3 = a_y * (u * tau_y**2 / MASS * np.sin(alpha - lag_y) + s * np.sin(theta - lag_y))
    f4 = a_y * (u * tau_y**2 / MASS * np.cos(alpha - lag_y) + s * np.cos(theta - lag_y))
    expected = np.stack([f1, f2, f3, f4], axis=1)
    assert made.features.shape == (200, 4)
    assert made.features.dtype == np.float64
    np.testing.assert_allclose(made.features, expected, rtol=0.0, atol=1e-12 * np.max(np.abs(expected)))


@pytest.mark.parametrize("settings", [{}, {"rotation": "y-to-x"}, {"bow_through_damping": True}])
def test_vmap_equals_loop_over_the_full_response(settings):
    rotor = Jeffcott(MASS, list(STIFFNESS), list(RATIO), **settings)
    made = make_dataset(rotor, 2000.0, 5, key=KEY)
    one = jax.jit(fault_features)
    loop = np.array([one(rotor, jnp.asarray(2000.0 * RPM), fault) for fault in made.faults])
    np.testing.assert_allclose(made.features, loop, rtol=0.0, atol=1e-14 * np.max(np.abs(loop)))


def test_key_determines_the_data(paper_rotor):
    once, again = (make_dataset(paper_rotor, 1500.0, 50, key=KEY) for _ in range(2))
    other = make_dataset(paper_rotor, 1500.0, 50, key=jax.random.key(8))
    np.testing.assert_array_equal(once.features, again.features)
    np.testing.assert_array_equal(once.faults, again.faults)
    np.testing.assert_array_equal(once.faults, sample_faults(KEY, 50))
    assert not np.any(np.asarray(once.faults) == np.asarray(other.faults))


def test_compiled_once_for_all_rotors_and_speeds(paper_rotor):
    make_dataset(paper_rotor, 1500.0, 33, key=KEY)
    before = dataset._cases._cache_size()
    make_dataset(Jeffcott(2.0, 5e4, 0.01), 900.0, 33, key=jax.random.key(0), prior=FaultPrior(1e-6, 1e-4))
    assert dataset._cases._cache_size() == before


def test_equal_axes_are_no_error():
    assert np.all(np.isfinite(make_dataset(Jeffcott(1.0, 5e4, 0.01), 1500.0, 10, key=KEY).features))


def test_undamped_rotor_is_refused_at_its_critical_speed_only():
    rotor = Jeffcott(1.0, [40000.0, 50000.0], 0.0)
    critical = float(rotor.critical_speeds_rpm()[0])
    with pytest.raises(
        ValueError,
        match=r"the features at 1909.86 rpm are not finite: an undamped rotor .*give a damping ratio above zero or "
        r"another speed",
    ):
        make_dataset(rotor, critical, 10, key=KEY)
    assert np.all(np.isfinite(make_dataset(rotor, 1.001 * critical, 10, key=KEY).features))


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((1500.0, 0), "count is 0: a dataset has at least one case; give a positive count"),
        ((0.0, 10), "speed_rpm is 0: it must be positive and finite"),
        ((-1500.0, 10), "speed_rpm is -1500: .*build the rotor with rotation='y-to-x'"),
        ((np.nan, 10), "speed_rpm is nan"),
    ],
)
def test_refusals(paper_rotor, arguments, message):
    with pytest.raises(ValueError, match=message):
        make_dataset(paper_rotor, *arguments, key=KEY)
    with pytest.raises(ValueError, match=message):
        Recipe(paper_rotor, *arguments, key=KEY)


def test_single_precision_is_refused(paper_rotor, recipe, tmp_path):
    data = make_dataset(paper_rotor, 1500.0, 5, key=KEY)
    with jax.enable_x64(False):
        for call in (
            lambda: sample_faults(KEY, 5),
            lambda: make_dataset(paper_rotor, 1500.0, 5, key=KEY),
            lambda: with_noise(data, KEY, 0.1),
            lambda: stream(recipe, tmp_path / "none"),
        ):
            with pytest.raises(ValueError, match="a dataset needs double precision"):
                call()
    assert not (tmp_path / "none").exists()


# Noise and parts


def test_noise_is_a_fraction_of_the_half_range(paper_rotor):
    data = make_dataset(paper_rotor, 1500.0, 20_000, key=KEY)
    noisy = with_noise(data, jax.random.key(9), 0.02)
    half_range = 0.5 * np.ptp(np.asarray(data.features), axis=0)
    drawn = np.asarray(noisy.features - data.features) / (0.02 * half_range)
    for column in drawn.T:
        assert stats.kstest(column, "norm").pvalue > 0.01
    np.testing.assert_array_equal(noisy.faults, data.faults)
    np.testing.assert_array_equal(with_noise(data, KEY, 0.0).features, data.features)
    with pytest.raises(ValueError, match=r"the level of noise is -0\.1: it must be finite and not negative"):
        with_noise(data, KEY, -0.1)


def test_split_is_disjoint_and_complete(paper_rotor):
    data = make_dataset(paper_rotor, 1500.0, 10_000, key=KEY)
    parts = split(data, key=jax.random.key(3))
    assert [len(part.features) for part in parts] == [7000, 1500, 1500]
    for field in Dataset._fields:
        together = np.concatenate([np.asarray(getattr(part, field)) for part in parts])
        rows = np.unique(together, axis=0)
        assert len(rows) == 10_000
        np.testing.assert_array_equal(rows, np.unique(np.asarray(getattr(data, field)), axis=0))
    by_fault = {
        tuple(fault): feature
        for fault, feature in zip(np.asarray(data.faults).tolist(), np.asarray(data.features), strict=True)
    }
    for fault, feature in zip(np.asarray(parts.test.faults).tolist(), np.asarray(parts.test.features), strict=True):
        np.testing.assert_array_equal(by_fault[tuple(fault)], feature)
    np.testing.assert_array_equal(split(data, key=jax.random.key(3)).test.faults, parts.test.faults)
    assert not np.array_equal(split(data, key=jax.random.key(4)).test.faults, parts.test.faults)


def test_split_of_other_fractions(paper_rotor):
    data = make_dataset(paper_rotor, 1500.0, 7, key=KEY)
    assert [len(part.faults) for part in split(data, key=KEY, fractions=(0.5, 0.5, 0.0))] == [4, 3, 0]
    with pytest.raises(ValueError, match=r"must not be negative and must add up to one, but are \(0.7, 0.2, 0.2\)"):
        split(data, key=KEY, fractions=(0.7, 0.2, 0.2))
    with pytest.raises(ValueError, match=r"must not be negative"):
        split(data, key=KEY, fractions=(1.2, -0.2, 0.0))
    with pytest.raises(
        ValueError, match=r"a part of the split .* of 7 cases is empty; make more cases, or give its fraction as zero"
    ):
        split(data, key=KEY, fractions=(0.98, 0.01, 0.01))


# Files


def test_stream_is_its_chunks(recipe, paper_rotor, tmp_path):
    seen = []
    stream(recipe, tmp_path, progress=lambda done, total: seen.append((done, total)))
    assert seen == [(done, COUNT) for done in (0, 5, 10, 15, 20, 23)]
    chunks = list(read_dataset(tmp_path))
    assert [len(chunk.features) for chunk in chunks] == recipe.rows() == [5, 5, 5, 5, 3]
    for k, chunk in enumerate(chunks):
        expected = make_dataset(paper_rotor, 1500.0, len(chunk.features), key=jax.random.fold_in(KEY, k))
        np.testing.assert_array_equal(chunk.features, expected.features)
        np.testing.assert_array_equal(chunk.faults, expected.faults)


def test_manifest_says_what_was_made(recipe, tmp_path):
    stream(recipe, tmp_path)
    manifest = json.loads((tmp_path / "manifest.json").read_text())
    assert (manifest["format"], manifest["version"]) == ("rotorjax dataset", 1)
    made = manifest["recipe"]
    assert made["rotor"] == {
        "mass": MASS, "stiffness": list(STIFFNESS), "damping_ratio": list(RATIO),
        "gravity": [0.0, 0.0], "rotation": "x-to-y",
        "bow_through_damping": False
    }  # fmt: skip
    assert made["prior"] == {"largest_unbalance_kg_m": 1e-3, "largest_bow_m": 0.05}
    assert made["key"] == {"generator": "threefry2x32", "data": [0, 7]}
    assert (made["speed_rpm"], made["count"], made["chunk"], made["jax"]) == (1500.0, COUNT, CHUNK, jax.__version__)
    for chunk in manifest["chunks"]:
        assert hashlib.sha256((tmp_path / chunk["file"]).read_bytes()).hexdigest() == chunk["sha256"]


def test_repeat_is_identical_to_the_byte(recipe, whole, tmp_path):
    stream(recipe, tmp_path / "again")
    assert contents(tmp_path / "again") == whole
    with zipfile.ZipFile(tmp_path / "again" / "chunk-000000.npz") as archive:
        assert all(
            member.date_time == (1980, 1, 1, 0, 0, 0) and member.compress_type == zipfile.ZIP_DEFLATED
            for member in archive.infolist()
        )


@pytest.mark.parametrize("after", [0, 5, 10, 15, 20])
def test_resumed_after_an_interruption(recipe, whole, tmp_path, after):
    folder = tmp_path / "interrupted"

    def progress(done, total):
        if done >= after:
            raise Killed

    with pytest.raises(Killed):
        stream(recipe, folder, progress=progress)
    with pytest.raises(
        ValueError, match=rf"{(COUNT - after + CHUNK - 1) // CHUNK} of 5 chunks are not written yet; call stream again"
    ):
        read_dataset(folder)
    seen = []
    stream(recipe, folder, progress=lambda done, total: seen.append(done))
    assert seen[0] == after
    assert contents(folder) == whole


def test_chunks_with_the_right_hash_are_kept(recipe, whole, tmp_path):
    folder = tmp_path / "whole"
    (folder / "chunk-000001.npz").write_bytes(b"half")
    (folder / "chunk-000003.npz").unlink()
    (folder / ".chunk-000002.npz.abc.partial").write_bytes(whole["chunk-000002.npz"][:50])
    (folder / ".manifest.json.abc.partial").write_bytes(b"{")
    kept = {
        name: (folder / name).stat().st_mtime_ns
        for name in ("chunk-000000.npz", "chunk-000002.npz", "chunk-000004.npz")
    }
    stream(recipe, folder)
    assert contents(folder) == whole
    assert {name: (folder / name).stat().st_mtime_ns for name in kept} == kept


KILLED = """
import os, signal, sys
from pathlib import Path
import jax
jax.config.update("jax_enable_x64", True)
from rotorjax import Jeffcott
from rotorjax.batch.dataset_files import Recipe, stream
from rotorjax.units import RPM
call, number, folder = sys.argv[1], int(sys.argv[2]), Path(sys.argv[3])
plain = getattr(os, call)
left = [number]
def deadly(*arguments):
    left[0] -= 1
    if left[0] == 0:
        os.kill(os.getpid(), signal.SIGKILL)
    return plain(*arguments)
setattr(os, call, deadly)
rotor = Jeffcott(0.9686, [56538.0, 51282.0], [0.0050, 0.0047])
stream(Recipe(rotor, 1500.0, 23, key=jax.random.key(7), chunk=5), folder)
"""


@pytest.mark.skipif(not hasattr(signal, "SIGKILL"), reason="this system has no SIGKILL")
def test_resumed_after_a_kill(recipe, whole, tmp_path):
    """Before the first manifest is in place, before a file is synced, and before it takes its name."""
    moments = [("replace", 1), ("fsync", 8), ("replace", 5)]
    folders = [tmp_path / f"{call}-{number}" for call, number in moments]
    commands = [
        [sys.executable, "-c", KILLED, call, str(number), str(folder)]
        for (call, number), folder in zip(moments, folders, strict=True)
    ]
    runs = [subprocess.Popen(command) for command in commands]
    assert [run.wait() for run in runs] == [-signal.SIGKILL] * len(runs)
    for folder in folders:
        left = contents(folder)
        assert any(name.endswith(".partial") for name in left) or len(left) > 1
        assert all(left[name] == whole[name] for name in left if name.startswith("chunk")), (
            "no file in place is half-written"
        )
        if "manifest.json" in left:
            with pytest.raises(ValueError, match="not written yet"):
                read_dataset(folder)
        stream(recipe, folder)
        assert contents(folder) == whole


def test_a_failed_write_leaves_no_file(recipe, tmp_path, monkeypatch):
    def full(*arguments):
        raise OSError(28, "No space left on device")

    with monkeypatch.context() as patched:
        patched.setattr(zipfile.ZipFile, "writestr", full)
        with pytest.raises(InputError, match=r"chunk-000000.npz: not written \(No space left on device\)"):
            stream(recipe, tmp_path / "full")
    assert os.listdir(tmp_path / "full") == ["manifest.json"]


@pytest.mark.parametrize("how", ["tampered", "cut", "swapped", "missing"])
def test_changed_files_are_refused(whole, tmp_path, how):
    path = tmp_path / "whole" / "chunk-000002.npz"
    raw = bytearray(whole[path.name])
    raw[len(raw) // 2] ^= 1
    new = {
        "tampered": bytes(raw),
        "cut": whole[path.name][:-10],
        "swapped": whole["chunk-000001.npz"],
        "missing": None,
    }[how]
    path.unlink()
    if new is not None:
        path.write_bytes(new)
    chunks = read_dataset(path.parent)
    next(chunks)
    next(chunks)
    with pytest.raises(
        InputError,
        match=r"chunk-000002.npz: (its SHA-256 is not the manifest's|No such file).*call stream again with the same "
        r"recipe",
    ):
        next(chunks)


def test_another_recipe_in_the_same_folder_is_refused(recipe, whole, tmp_path):
    folder = tmp_path / "whole"
    others = {
        "speed_rpm 1500.0, asked for 2500.0": {"speed_rpm": 2500.0},
        "count 23, asked for 24": {"count": 24},
        "chunk 5, asked for 6": {"chunk": 6},
        "key .*, asked for .*8": {"key": jax.random.key(8)},
        "prior .*0.05.*, asked for .*0.04": {"prior": FaultPrior(largest_bow_m=0.04)},
        "rotor .*x-to-y.*, asked for .*y-to-x": {
            "rotor": Jeffcott(MASS, list(STIFFNESS), list(RATIO), rotation="y-to-x")
        },
    }
    for message, change in others.items():
        with pytest.raises(
            InputError, match=rf"holds a dataset of another recipe \({message}.*\); give another folder"
        ):
            stream(dataclasses.replace(recipe, **change), folder)
    assert contents(folder) == whole


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda m: "{", "not the manifest of a dataset"),
        (lambda m: "[]", "not the manifest of a dataset"),
        (lambda m: m | {"version": 2}, "version 2, but this is for 'rotorjax dataset', version 1"),
        (lambda m: {k: v for k, v in m.items() if k != "chunks"}, "not the manifest of a dataset"),
        (lambda m: m | {"chunks": m["chunks"][1:]}, "its chunks are not those of its recipe"),
        (
            lambda m: m | {"chunks": [c | {"file": "../" + c["file"]} for c in m["chunks"]]},
            "its chunks are not those of its recipe",
        ),
    ],
)
def test_changed_manifests_are_refused(recipe, whole, tmp_path, change, message):
    path = tmp_path / "whole" / "manifest.json"
    new = change(json.loads(path.read_text()))
    path.write_text(new if isinstance(new, str) else json.dumps(new))
    with pytest.raises(InputError, match=message):
        read_dataset(path.parent)
    with pytest.raises(InputError, match=message):
        stream(recipe, path.parent)


def test_folders_that_cannot_be_used(recipe, tmp_path):
    (tmp_path / "notes.txt").write_text("mine")
    with pytest.raises(InputError, match=r"holds other files and no manifest.json; give a new or an empty folder"):
        stream(recipe, tmp_path)
    assert os.listdir(tmp_path) == ["notes.txt"]
    with pytest.raises(InputError, match=r"cannot be made a folder .*; choose another path"):
        stream(recipe, tmp_path / "notes.txt")
    with pytest.raises(
        InputError, match=r"manifest.json: No such file or directory; give the folder that stream wrote"
    ):
        read_dataset(tmp_path)


def test_chunks_are_few_and_not_empty(recipe):
    for chunk, count in ((0, 10), (1, 10_001)):
        with pytest.raises(ValueError, match=rf"{count} cases in chunks of {chunk}: .*at most 10000; change chunk"):
            dataclasses.replace(recipe, chunk=chunk, count=count)
