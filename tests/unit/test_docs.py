"""The pages of the documentation name all that there is; without mkdocs."""

import argparse
import ast
import importlib.util
import re
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

import rotorjax
from rotorjax.cli import _parser
from rotorjax.data.example import write_example
from rotorjax.data.rig import _SECTIONS
from rotorjax.data.table import OPTIONAL, REQUIRED
from rotorjax.effects import CATALOG

DOCS = Path(__file__).parents[2] / "docs"
PAGES = sorted(DOCS.rglob("*.md"))


def text(name: str) -> str:
    return (DOCS / name).read_text(encoding="utf-8")


def commands() -> dict[str, argparse.ArgumentParser]:
    action = next(a for a in _parser()._actions if isinstance(a, argparse._SubParsersAction))
    return dict(action.choices)


@pytest.mark.parametrize("name", commands())
def test_every_command_has_a_page_with_every_option(name: str):
    page = text(f"guide/{name}.md")
    for action in commands()[name]._actions:
        if action.dest != "help":
            wanted = action.option_strings or [action.metavar]
            assert f"`{wanted[0]}" in page, f"{wanted[0]} is not explained in docs/guide/{name}.md"
    assert f"({name}.md)" in text("guide/index.md")
    assert "Exit status" in page


@pytest.mark.parametrize("section", _SECTIONS)
def test_every_section_of_a_rig_file_is_explained(section: str):
    assert re.search(rf"^### .*\b{section}\b", text("files.md"), re.MULTILINE)


def test_every_column_of_a_table_is_explained():
    assert all(f"| `{column}` |" in text("files.md") for column in (*REQUIRED, *OPTIONAL))


def test_every_effect_is_listed_and_drawn():
    spec = importlib.util.spec_from_file_location("signatures", DOCS / "signatures.py")
    signatures = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(signatures)
    assert set(signatures.DRAWN) == set(CATALOG)
    for name, sizes in signatures.DRAWN.items():
        declared = {p.name for p in CATALOG[name].parameters()}
        assert all(not isinstance(s, dict) or set(s) <= declared for s in sizes.scales), name
    assert all(name in text("guide/effects.md") for name in CATALOG)


def test_every_public_name_is_in_the_reference():
    listed = "".join(p.read_text(encoding="utf-8") for p in (DOCS / "api").glob("*.md"))
    assert [name for name in rotorjax.__all__ if name != "effects" and f".{name}\n" not in f"{listed}\n"] == []


def test_every_page_is_in_the_navigation():
    navigation = (DOCS.parent / "mkdocs.yml").read_text(encoding="utf-8")
    assert [str(p.relative_to(DOCS)) for p in PAGES if p.relative_to(DOCS).as_posix() not in navigation] == []


@pytest.mark.parametrize("page", PAGES, ids=lambda p: p.relative_to(DOCS).as_posix())
def test_python_on_the_pages_can_be_parsed(page: Path):
    for block in re.findall(r"^```python[^\n]*\n(.*?)^```$", page.read_text(encoding="utf-8"), re.M | re.S):
        ast.parse(block)


def test_an_effect_of_ones_own_runs_as_written(tmp_path, monkeypatch):
    write_example(tmp_path)
    monkeypatch.chdir(tmp_path)
    names: dict = {}
    searched = []

    def answer(model, measurement, *, catalog=CATALOG):
        """What is searched and fitted takes minutes, and is tested elsewhere."""
        searched.append((model, catalog))
        return SimpleNamespace(model=rig.model + names["MagneticPull"](1e3))

    rig = rotorjax.read_rig("rig.toml")
    monkeypatch.setattr(rotorjax, "explain", answer)
    monkeypatch.setattr(rotorjax, "fit", answer)
    for block in re.findall(r"^```python\n(.*?)^```$", text("own_effect.md"), re.M | re.S):
        exec(block, names)
    assert len(searched) == 2
    again = rotorjax.read_rig("fitted.toml", catalog=names["catalog"])
    assert float(again.model.find("magnetic_pull").pull_n_per_m) == 1e3
    upright = rotorjax.Jeffcott(0.97, [56500.0, 51300.0], 0.02)
    at = rotorjax.Conditions.at_rpm([900.0, 2000.0], unbalance=[1e-8, 0.0])
    full, linear = (rotorjax.response(upright + names[n](1e3), at) for n in ("MagneticPull", "SmallPull"))
    np.testing.assert_allclose(full, linear, rtol=1e-3)
