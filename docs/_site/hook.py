"""What MkDocs does not do by itself: formulas, tables from the code, pages of the repository outside docs/.

Formulas are written as ```math blocks in LaTeX and become MathML here, so that no script draws them. Tables
stand where a page says `<!-- generated: NAME -->`.
"""

from __future__ import annotations

import posixpath
import re
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from latex2mathml.converter import convert
from mkdocs.structure.files import File, Files
from tables import TABLES

ROOT = Path(__file__).parents[2]
OUTSIDE = {
    "CONTRIBUTING.md": "contributing.md",
    "CHANGELOG.md": "changelog.md",
    "firmware/README.md": "firmware/README.md",
    "firmware/SAFETY.md": "firmware/SAFETY.md",
}
"""Pages of the site that stand where readers of the repository look for them."""
LINK = re.compile(r"(\]\()([^)#\s]+\.md)([^)]*\))")
MARK = re.compile(r"^<!-- generated: ([a-z-]+) -->$", re.MULTILINE)
OTHER_HOST = re.compile(r"https://(?:unpkg\.com|api\.github\.com|\$\{\w+\}/api)[^\"'`]*")
"""What the theme's script would load for diagrams and repository facts, which no page has."""


def math(source: str, language: str, css_class: str, options: Any, md: Any, **more: Any) -> str:
    """One ```math block as MathML."""
    return f'<div class="math">{convert(source.strip(), display="block")}</div>'


def on_config(config: Any) -> Any:
    """Let superfences know ```math, and find the pages of evidence and decisions."""
    if str(ROOT) not in sys.path:  # the code beside these pages, not one that is installed elsewhere
        sys.path.insert(0, str(ROOT))
    fences = {"custom_fences": [{"name": "math", "class": "math", "format": math}]}
    config.mdx_configs["pymdownx.superfences"] = fences
    for section, named in ((s, v) for entry in config.nav for s, v in entry.items()):
        if section in ("Evidence", "Decisions"):
            named.extend(
                _rest(section.lower(), {next(iter(e.values())) if isinstance(e, dict) else e for e in named})
            )
    return config


def _rest(folder: str, known: set[str]) -> Iterator[dict[str, str]]:
    for path in sorted((ROOT / "docs" / folder).glob("*.md")):
        page = f"{folder}/{path.name}"
        if page not in known:
            heading = re.search(r"^# (.+)$", path.read_text(encoding="utf-8"), re.MULTILINE)
            yield {heading[1] if heading else path.stem.replace("_", " ").capitalize(): page}


def on_files(files: Files, config: Any) -> Files:
    """Add the pages that stand outside docs/."""
    for source, page in OUTSIDE.items():
        files.append(File.generated(config, page, abs_src_path=str(ROOT / source)))
    return files


def on_page_markdown(markdown: str, page: Any, **more: Any) -> str:
    """Put in generated tables, and turn links between files of the repository into links between pages."""
    own = {site: source for source, site in OUTSIDE.items()}
    here = page.file.src_uri
    source = own.get(here, f"docs/{here}")

    def linked(found: re.Match[str]) -> str:
        if "://" in found[2]:
            return found[0]
        target = posixpath.normpath(posixpath.join(posixpath.dirname(source), found[2]))
        to = OUTSIDE.get(target, target.removeprefix("docs/") if target.startswith("docs/") else None)
        return (
            found[0]
            if to is None
            else found[1] + posixpath.relpath(to, posixpath.dirname(here) or ".") + found[3]
        )

    return MARK.sub(lambda found: TABLES[found[1]](), LINK.sub(linked, markdown))


def on_post_build(config: Any) -> None:
    """Take the addresses of other hosts out of the theme's script."""
    for path in Path(config.site_dir, "assets", "javascripts").glob("*.js"):
        text = path.read_text(encoding="utf-8")
        path.write_text(OTHER_HOST.sub("", text), encoding="utf-8")
