"""Programs kept from one process to the next: found again, made anew where what was kept is damaged, and nothing kept
where it must not be.
"""

import jax
import numpy as np
import pytest

from rotorjax.compilation import _cache_folder
from rotorjax.inference.kept_programs import FOLDER, kept_program


@pytest.fixture
def folder(tmp_path):
    before = jax.config.values["jax_compilation_cache_dir"]
    jax.config.update("jax_compilation_cache_dir", str(tmp_path))
    yield tmp_path / FOLDER
    jax.config.update("jax_compilation_cache_dir", before)


class Doubled:
    """Counts how often it is traced."""

    def __init__(self) -> None:
        self.traced = 0

    def __call__(self, values):
        self.traced += 1
        return 2.0 * values


VALUES = np.arange(3.0)


def test_a_program_is_traced_once_and_then_found(folder):
    first, second = Doubled(), Doubled()
    for function in (first, second):
        np.testing.assert_array_equal(kept_program(function, "doubled", (VALUES,))(VALUES), 2.0 * VALUES)
    assert (first.traced, second.traced) == (1, 0)
    assert len(list(folder.iterdir())) == 1


def test_what_it_is_made_of_and_its_shapes_tell_programs_apart(folder):
    for made_of, values in (
        ("doubled", VALUES),
        ("otherwise", VALUES),
        ("doubled", VALUES[:2]),
        ("doubled", VALUES.astype(int)),
    ):
        function = Doubled()
        kept_program(function, made_of, (values,))(values)
        assert function.traced == 1
    assert len(list(folder.iterdir())) == 4


@pytest.mark.parametrize(
    "damage", [lambda content: content[:-1], lambda content: b"", lambda content: content[:40] + b"\x00" + content[41:]]
)
def test_damaged_it_is_made_anew(folder, damage):
    kept_program(Doubled(), "doubled", (VALUES,))
    (file,) = folder.iterdir()
    file.write_bytes(damage(file.read_bytes()))
    traced = []
    for again in (Doubled(), Doubled()):
        np.testing.assert_array_equal(kept_program(again, "doubled", (VALUES,))(VALUES), 2.0 * VALUES)
        traced.append(again.traced)
    assert traced == [1, 0]


def test_nothing_is_kept_under_the_name_of_an_object_at_an_address(folder):
    kept_program(Doubled(), "<function at 0x7f00>", (VALUES,))(VALUES)
    assert not folder.exists()


def test_a_folder_that_cannot_be_made_keeps_nothing(folder):
    folder.parent.joinpath(FOLDER).write_text("a file in its place")
    np.testing.assert_array_equal(kept_program(Doubled(), "doubled", (VALUES,))(VALUES), 2.0 * VALUES)


def test_without_a_cache_nothing_is_kept(tmp_path):
    before = jax.config.values["jax_compilation_cache_dir"]
    jax.config.update("jax_compilation_cache_dir", None)
    try:
        np.testing.assert_array_equal(kept_program(Doubled(), "doubled", (VALUES,))(VALUES), 2.0 * VALUES)
    finally:
        jax.config.update("jax_compilation_cache_dir", before)


def test_a_user_without_a_home_has_no_folder_for_them(monkeypatch):
    monkeypatch.delenv("XDG_CACHE_HOME", raising=False)
    monkeypatch.setattr("os.path.expanduser", lambda path: path)
    assert _cache_folder() is None
