"""What the site adds to the pages in docs/: generated pages and pictures, and pages from elsewhere in the repository.

Links stay as a code host shows them (`../CONTRIBUTING.md`): here they are turned to where the site has the page, and
to plain text where it has none.
"""

import posixpath
import re
from pathlib import Path

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page

ROOT = Path(__file__).resolve().parent.parent
GENERATED = ROOT / "build" / "docs"
"""Written by `docs/generate.py`."""
ELSEWHERE = (
    "CONTRIBUTING.md",
    "CHANGELOG.md",
    "notebooks/README.md",
    "paper_tables/*.md",
    "paper_tables/*.csv",
    "paper_tables/*.svg",
    "benchmarks/results/*.md",
)
"""Shown as they are, in a folder of their own."""
FOLDER = "repository"
SHIM = "https://unpkg.com/iframe-worker/shim"
FAMILIES = ("excitation", "structure", "restoring", "reading")
_LINK = re.compile(r"(!?)\[([^\]]*)\]\(([^)\s#:]+)(#[^)\s]*)?\)")
_DRAWN = re.compile(r"^```python title=\"([\w-]+)\.png\"\n.*?^```$", re.MULTILINE | re.DOTALL)
_LOADED = re.compile(r"<(?:script|link|img|iframe)\b[^>]*\b(?:src|href)=\"?https?://[^>]*>")
_FENCED = re.compile(r"(^```.*?^```$|\[[^\]\n]*\]\([^)\n]*\)|^#.*?$)", re.MULTILINE | re.DOTALL)
"""What is left as it is: code, links, headings."""
_CODE = re.compile(r"`([a-z_]+)`")


def on_config(config: MkDocsConfig) -> MkDocsConfig:
    """Put the pages of the catalogue into the navigation, by family."""
    families: dict[str, list[dict[str, str]]] = {family: [] for family in FAMILIES}
    for path in _effects():
        family = re.search(r"^\*Family: (\w+)", path.read_text(encoding="utf-8"), re.MULTILINE)
        families.setdefault(family[1] if family else "other", []).append({path.stem: f"catalogue/{path.name}"})
    section = next(entry["Effects"] for entry in config.nav or [] if "Effects" in entry)
    section[1:1] = [{family.capitalize(): pages} for family, pages in families.items()]
    return config


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add what was generated, and the pages from elsewhere."""
    if not GENERATED.is_dir():
        raise FileNotFoundError(f"{GENERATED} is missing: run docs/generate.py first, or `make docs`")
    for path in sorted(p for p in GENERATED.rglob("*") if p.is_file()):
        uri = path.relative_to(GENERATED).as_posix()
        if written := files.get_file_from_path(uri):
            files.remove(written)
        files.append(File.generated(config, uri, abs_src_path=str(path)))
    for path in _elsewhere():
        files.append(File.generated(config, _place(path), abs_src_path=str(ROOT / path)))
    return files


def on_post_page(output: str, page: Page, **_: object) -> str:
    """Take from the site itself what the theme would load from a network to search in files on disk."""
    return output.replace(SHIM, posixpath.relpath("worker.js", posixpath.dirname(page.file.dest_uri) or "."))


def on_post_template(output_content: str, **_: object) -> str:
    """The same on the page for what is not found."""
    return output_content.replace(SHIM, "worker.js")


def on_post_build(config: MkDocsConfig, **_: object) -> None:
    """Refuse a site that would load anything from a network."""
    for path in Path(config.site_dir).rglob("*.html"):
        if found := _LOADED.search(path.read_text(encoding="utf-8")):
            raise ValueError(f"{path}: {found[0]} would be loaded from a network")


def on_page_markdown(markdown: str, page: Page, **_: object) -> str:
    """Turn links, and show under each piece of code the picture that it draws."""
    uri = page.file.src_uri
    if uri == "gallery.md":
        markdown = _DRAWN.sub(lambda m: f"{m[0]}\n\n![{m[1].replace('-', ' ')}](pictures/{m[1]}.png)", markdown)
    known = {_place(path): path for path in _elsewhere()}
    here = known.get(uri, f"docs/{uri}")

    def turned(link: re.Match[str]) -> str:
        target = posixpath.normpath(posixpath.join(posixpath.dirname(here), link[3]))
        if not (ROOT / target).exists():
            return link[0]
        if target.startswith("docs/"):
            place = target.removeprefix("docs/")
        elif target in known.values():
            place = _place(target)
        else:
            return link[2]
        return f"{link[1]}[{link[2]}]({posixpath.relpath(place, posixpath.dirname(uri) or '.')}{link[4] or ''})"

    return _LINK.sub(turned, _with_effects_linked(markdown, uri))


def _with_effects_linked(markdown: str, uri: str) -> str:
    """Names of effects in code type as links to their pages."""
    names = {p.stem: posixpath.relpath(f"catalogue/{p.name}", posixpath.dirname(uri) or ".") for p in _effects()}
    if uri.startswith(("catalogue/", f"{FOLDER}/")):
        return markdown
    parts = _FENCED.split(markdown)
    parts[::2] = [
        _CODE.sub(lambda m: f"[{m[0]}]({names[m[1]]})" if m[1] in names else m[0], part) for part in parts[::2]
    ]
    return "".join(parts)


def _effects() -> list[Path]:
    return [p for p in sorted((GENERATED / "catalogue").glob("*.md")) if p.stem != "index"]


def _place(path: str) -> str:
    """Where the site has a page from elsewhere; a README would be taken for the page of its section."""
    return f"{FOLDER}/{path}".replace("/README.md", "/overview.md")


def _elsewhere() -> list[str]:
    return [p.relative_to(ROOT).as_posix() for pattern in ELSEWHERE for p in sorted(ROOT.glob(pattern))]
