"""One self-contained page: sections, tables and figures, legible on screen and in print."""

from __future__ import annotations

import html
from collections.abc import Sequence

__all__ = ["page", "paragraph", "section", "table"]

_STYLE = """
body { font: 16px/1.5 system-ui, sans-serif; color: #1a1a1a; background: #fff; margin: 0 auto; max-width: 60rem;
       padding: 1rem; }
h1 { font-size: 1.6rem; } h2 { font-size: 1.2rem; margin-top: 2.2rem; border-bottom: 1px solid #999; }
table { border-collapse: collapse; margin: 1rem 0; } caption { text-align: left; font-weight: 600; padding: .3rem 0; }
th, td { border: 1px solid #bbb; padding: .25rem .6rem; text-align: right; } th:first-child, td:first-child
{ text-align: left; } th { background: #eee; }
figure { margin: 1rem 0; break-inside: avoid; } figure svg { width: 100%; height: auto; }
figcaption { font-size: .9rem; color: #444; }
@media print { body { max-width: none; font-size: 11pt; } h2 { break-after: avoid; } }
"""


def page(title: str, lead: str, sections: Sequence[str]) -> str:
    """Return the HTML document; `lead` is one plain sentence, `sections` are HTML.

    Parameters
    ----------
    title : of the document
    lead : one plain sentence under it
    sections : HTML
    """
    body = "\n".join(sections)
    return (
        f'<!doctype html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        f'<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        f"<title>{html.escape(title)}</title>\n<style>{_STYLE}</style>\n</head>\n<body>\n"
        f"<h1>{html.escape(title)}</h1>\n{paragraph(lead)}\n{body}\n</body>\n</html>\n"
    )


def section(title: str, *parts: str) -> str:
    """Return a section of HTML parts under a heading.

    Parameters
    ----------
    title : heading
    parts : HTML
    """
    return f"<section>\n<h2>{html.escape(title)}</h2>\n" + "\n".join(parts) + "\n</section>"


def paragraph(text: str) -> str:
    """Return plain text as a paragraph."""
    return f"<p>{html.escape(text)}</p>"


def table(caption: str, header: Sequence[str], rows: Sequence[Sequence[object]]) -> str:
    """Return a table; numbers should come formatted.

    Parameters
    ----------
    caption : above the table
    header : one cell per column
    rows : cells, numbers formatted
    """
    head = "".join(f'<th scope="col">{html.escape(cell)}</th>' for cell in header)
    body = "\n".join(
        "<tr>" + "".join(f"<td>{html.escape(str(cell))}</td>" for cell in row) + "</tr>" for row in rows
    )
    return (
        f"<table>\n<caption>{html.escape(caption)}</caption>\n<thead><tr>{head}</tr></thead>\n"
        f"<tbody>\n{body}\n</tbody>\n</table>"
    )
