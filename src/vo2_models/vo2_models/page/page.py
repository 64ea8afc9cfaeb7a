"""One self-contained page: sections, tables and figures, legible on screen and in print.

The HTML stands in `templates`; what is put into it is escaped there.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined

__all__ = ["contents", "figure", "formula", "page", "paragraph", "section", "subsection", "table"]


@cache
def _templates() -> Environment:
    return Environment(
        loader=PackageLoader(__package__ or "vo2_models.page"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        keep_trailing_newline=True,
    )


def _part(name: str, *arguments: Any) -> str:
    return str(getattr(_templates().get_template("parts.html").module, name)(*arguments))


def page(title: str, lead: str, sections: Sequence[str]) -> str:
    """Return the HTML document.

    Parameters
    ----------
    title : of the document
    lead : one plain sentence under it
    sections : HTML
    """
    return _templates().get_template("page.html").render(title=title, lead=lead, sections=sections)


def contents(entries: Sequence[tuple[str, str]]) -> str:
    """Return a list of links to sections of the page.

    Parameters
    ----------
    entries : title of a section, and what the link says
    """
    return _part("contents", entries)


def section(title: str, *parts: str) -> str:
    """Return a section of HTML parts under a heading.

    Parameters
    ----------
    title : heading
    parts : HTML
    """
    return _part("section", title, parts)


def subsection(title: str, *parts: str) -> str:
    """Return HTML parts under a heading inside a section.

    Parameters
    ----------
    title : heading
    parts : HTML
    """
    return _part("subsection", title, parts)


def paragraph(text: str) -> str:
    """Return plain text as a paragraph."""
    return _part("paragraph", text)


def formula(text: str) -> str:
    """Return plain text as a paragraph in the type of code."""
    return _part("formula", text)


def table(caption: str, header: Sequence[str], rows: Sequence[Sequence[object]]) -> str:
    """Return a table; numbers should come formatted.

    Parameters
    ----------
    caption : above the table
    header : one cell per column
    rows : cells, numbers formatted
    """
    return _part("table", caption, header, rows)


def figure(svg: str, caption: str) -> str:
    """Return a figure.

    Parameters
    ----------
    svg : element, as it is
    caption : plain text under it
    """
    return _part("figure", svg, caption)
