"""One self-contained HTML page: published, ours, when a claim is met, and the figures."""

from __future__ import annotations

import math
from collections.abc import Sequence

from vo2_models.page.page import contents, figure, paragraph, table
from vo2_models.page.page import page as document
from vo2_models.page.page import section as page_section

from vo2_studies.reproduce.claims import Claim, Figure, Section, Table, tally

__all__ = ["page"]

_RULES = (
    "Published values are those of the dissertation, measured on its devices or computed; ours come from simulated devices "
    "that share no model with the estimators and controllers, with these exceptions. The truth is of the kind that is "
    "identified, compressed or inverted in 2.4 and 4.3 (a Preisach operator), 3.5 (a GPI model), 6.4.1 (an EGPI model) and 8.3 "
    "(the linear plant), and the heated body of the chapter 8 devices (8.2, 8.4 to the end) is the nominal model of "
    "8.3.1 that the controllers are designed on. A dash marks a claim of our own. A claim is met within the stated distance of "
    "the published value, on both sides unless better lies on one; a ratio is compared with the published ratio. What the "
    "text itself contradicts counts as neither, nor does what ours was set or fitted to (given) or what the text derives from "
    "its own figures (consistent). Missed is left standing."
)
_HEAD = ("claim", "section", "published", "ours", "unit", "state", "met if", "note")


def page(sections: Sequence[Section], *, command: str, seconds: float) -> str:
    """Return the page.

    Parameters
    ----------
    command : what the reader types to get it
    seconds : how long it took
    """
    total = tally(claim for section in sections for claim in section.claims)
    names = [f"{section.number} {section.title}" for section in sections]
    told = [(name, f"{name}: {tally(section.claims)}") for name, section in zip(names, sections, strict=True)]
    parts = [paragraph(_RULES), contents(told)]
    parts += [page_section(name, *_parts(section)) for name, section in zip(names, sections, strict=True)]
    return document(
        "Published figures and ours", f"{total}. Computed in {seconds:.0f} s by {command}.", parts
    )


def _parts(section: Section) -> list[str]:
    """The story, the remarks, the claims, their notes and the figures of one section."""
    notes = list(dict.fromkeys(note for claim in section.claims if (note := _note(claim))))
    rows = [_row(claim, notes) for claim in section.claims]
    return [
        *(_part(part) for part in (*section.story, *section.remarks)),
        table("Claims", _HEAD, rows),
        *(paragraph(f"Note {k}: {note}") for k, note in enumerate(notes, 1)),
        *(_part(one) for one in section.figures),
    ]


def _part(part: str | Table | Figure) -> str:
    if isinstance(part, Table):
        return table(part.caption, part.head, part.rows)
    return paragraph(part) if isinstance(part, str) else figure(part.svg, part.caption)


def _note(claim: Claim) -> str:
    return "; ".join(part for part in (claim.contradicted, claim.conditions) if part)


def _row(claim: Claim, notes: Sequence[str]) -> tuple[str, ...]:
    published = "–" if claim.published is None else f"{claim.published:.4g}"
    ours = f"{claim.ours:.4g}" if math.isfinite(claim.ours) else "not found"
    note = str(notes.index(_note(claim)) + 1) if _note(claim) else ""
    return claim.claim, claim.section, published, ours, claim.unit, claim.state, claim.rule.text, note
