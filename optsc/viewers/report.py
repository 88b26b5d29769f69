"""HTML report: headings, paragraphs, tables and figures in a single file that needs no network."""

from __future__ import annotations

import base64
import html
import io
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from optsc.errors import InvalidValue

_STYLE = """
:root { --ink: #22272e; --quiet: #68707b; --line: #dfe3e8; }
body { font: 15px/1.5 system-ui, sans-serif; color: var(--ink); max-width: 76rem; margin: 2rem auto; }
body { padding: 0 1.2rem; }
h1 { font-size: 1.7rem; margin-bottom: .3rem; } h2 { font-size: 1.25rem; margin-top: 2.4rem; }
p { max-width: 60rem; } .quiet, figcaption, caption { color: var(--quiet); }
figure { margin: 1.2rem 0; } figure img { max-width: 100%; height: auto; display: block; }
figcaption { max-width: 60rem; font-size: .92rem; margin-top: .4rem; }
.wide { overflow-x: auto; } table { border-collapse: collapse; font-size: .88rem; margin: .8rem 0; }
caption { text-align: left; padding-bottom: .3rem; }
th, td { padding: .22rem .7rem; border-bottom: 1px solid var(--line); text-align: right; white-space: nowrap; }
th:first-child, td:first-child, td.words { text-align: left; } td.words { white-space: normal; min-width: 16rem; }
pre { background: #f5f6f8; padding: .7rem .9rem; overflow-x: auto; font-size: .85rem; }
"""


@dataclass(frozen=True)
class Table:
    """Rows of cells under a head; numbers are printed with three significant digits."""

    head: Sequence[str]
    rows: Sequence[Sequence[Any]]
    caption: str = ""


@dataclass(frozen=True, eq=False)
class Picture:
    """A matplotlib figure, the name of its files, and what it shows."""

    name: str
    figure: Any
    caption: str


@dataclass(frozen=True)
class Code:
    """Text to be shown as it is, such as a command."""

    text: str


Block = str | Table | Picture | Code


@dataclass
class Report:
    """A page under construction.

    Attributes:
        title: of the page.
        lead: what it is about, in a sentence or two.
    """

    title: str
    lead: str = ""
    _sections: list[tuple[str, tuple[Block, ...]]] = field(default_factory=list)

    def add(self, heading: str, *blocks: Block) -> None:
        """Append a section: strings are paragraphs."""
        self._sections.append((heading, blocks))

    def save(self, directory: Path) -> Path:
        """Write ``report.html`` and the figures below ``figures``, as SVG and PNG; return the page's path.

        Raises `InvalidValue` where two pictures have one name.
        """
        figures = directory / "figures"
        figures.mkdir(parents=True, exist_ok=True)
        pictures = [block for _, blocks in self._sections for block in blocks if isinstance(block, Picture)]
        names = [picture.name for picture in pictures]
        if len(set(names)) < len(names):
            raise InvalidValue("names of pictures", names, "each once")
        drawn = {picture.name: _drawn(picture, figures) for picture in pictures}
        parts = [f"<h1>{html.escape(self.title)}</h1>", _paragraph(self.lead)]
        for heading, blocks in self._sections:
            parts.append(f"<h2>{html.escape(heading)}</h2>")
            parts += [_block(block, drawn) for block in blocks]
        page = directory / "report.html"
        page.write_text(
            f'<!DOCTYPE html>\n<html lang="en"><head><meta charset="utf-8"><title>{html.escape(self.title)}</title>'
            f'<meta name="viewport" content="width=device-width"><style>{_STYLE}</style></head>\n'
            f"<body>\n{chr(10).join(parts)}\n</body></html>\n",
            encoding="utf-8",
        )
        return page


def _drawn(picture: Picture, directory: Path) -> str:
    """Write the picture's files and return its SVG as a data address."""
    from matplotlib import rc_context

    buffer = io.BytesIO()
    # Without a date and with fixed ids, equal pictures are equal files.
    with rc_context({"svg.hashsalt": picture.name, "svg.fonttype": "path"}):
        picture.figure.savefig(buffer, format="svg", metadata={"Date": None}, facecolor="white")
    picture.figure.savefig(directory / f"{picture.name}.png", dpi=150, facecolor="white")
    (directory / f"{picture.name}.svg").write_bytes(buffer.getvalue())
    return "data:image/svg+xml;base64," + base64.b64encode(buffer.getvalue()).decode()


def _block(block: Block, drawn: dict[str, str]) -> str:
    if isinstance(block, str):
        return _paragraph(block)
    if isinstance(block, Code):
        return f"<pre>{html.escape(block.text)}</pre>"
    if isinstance(block, Picture):
        caption = html.escape(block.caption)
        return f'<figure><img alt="{caption}" src="{drawn[block.name]}"><figcaption>{caption}</figcaption></figure>'
    head = "".join(f"<th>{html.escape(cell)}</th>" for cell in block.head)
    body = "\n".join(f"<tr>{''.join(_cell(cell) for cell in row)}</tr>" for row in block.rows)
    caption = f"<caption>{html.escape(block.caption)}</caption>" if block.caption else ""
    return f'<div class="wide"><table>{caption}<tr>{head}</tr>\n{body}</table></div>'


def _paragraph(text: str) -> str:
    return f"<p>{html.escape(text)}</p>" if text else ""


def _cell(value: Any) -> str:
    text = shown(value)
    words = ' class="words"' if isinstance(value, str) and len(text) > 40 else ""
    return f"<td{words}>{html.escape(text)}</td>"


def shown(value: Any) -> str:
    """Return a cell of a table as text: three significant digits, a dash for what is no number."""
    if value is None or value != value:
        return "–"
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, float):
        return f"{value:.0f}" if abs(value) >= 1000 else f"{value:.3g}"
    return str(value)
