"""One self-contained HTML page: published, ours, conditions, met or not, and the figures."""

from __future__ import annotations

import math
from collections.abc import Sequence
from html import escape

from vo2_studies.reproduce.claims import Claim, Figure, Section, Table, tally

__all__ = ["page"]

_STYLE = """
body{font:15px/1.5 system-ui,sans-serif;max-width:62rem;margin:2rem auto;padding:0 1rem;color:#222}
table{border-collapse:collapse;width:100%;margin:.6rem 0 1.2rem}
th,td{border-bottom:1px solid #ddd;padding:.3rem .5rem;text-align:left;vertical-align:top}
td.n{text-align:right;white-space:nowrap;font-variant-numeric:tabular-nums}
.met{color:#00614a;font-weight:600}.not{color:#a33c00;font-weight:600}
small{color:#555}figure{margin:1rem 0}figcaption{color:#444;font-size:.9rem}svg{max-width:100%;height:auto}
"""


def page(sections: Sequence[Section], *, command: str, seconds: float) -> str:
    """Return the page.

    Parameters
    ----------
    command : what the reader types to get it
    seconds : how long it took
    """
    claims = [claim for section in sections for claim in section.claims]
    body = "".join(_section(section) for section in sections)
    contents = "".join(
        f'<li><a href="#s{escape(s.number)}">{escape(s.number)} {escape(s.title)}</a>: '
        f"{escape(str(tally(s.claims)))}</li>"
        for s in sections
    )
    return (
        '<!doctype html><html lang="en"><head><meta charset="utf-8"><title>Reproduction</title>'
        f"<style>{_STYLE}</style></head><body><h1>Published figures and ours</h1>"
        f"<p><b>{escape(str(tally(claims)))}.</b> Computed in {seconds:.0f} s by <code>{escape(command)}</code>. "
        "Published values are those of the dissertation, measured on its devices; ours come from simulated devices that "
        "share no model with the estimators and controllers. A dash marks a claim of our own. A claim is met "
        "within the stated distance of the published value, on both sides unless better lies on one; a ratio is compared "
        "with the published ratio. What the text itself contradicts counts as neither. "
        f"Missed is left standing.</p><ul>{contents}</ul>{body}</body></html>"
    )


def _section(section: Section) -> str:
    remarks = "".join(f"<p>{escape(text)}</p>" for text in section.remarks)
    rows = "".join(_row(claim) for claim in section.claims)
    figures = "".join(_part(figure) for figure in section.figures)
    story = "".join(_part(part) for part in section.story)
    return (
        f'<h2 id="s{escape(section.number)}">{escape(section.number)} {escape(section.title)}</h2>{story}{remarks}'
        "<table><thead><tr><th>claim</th><th>published</th><th>ours</th><th>unit</th><th>met</th></tr></thead>"
        f"<tbody>{rows}</tbody></table>{figures}"
    )


def _part(part: str | Table | Figure) -> str:
    if isinstance(part, str):
        return f"<p>{escape(part)}</p>"
    if isinstance(part, Figure):
        return f"<figure>{part.svg}<figcaption>{escape(part.caption)}</figcaption></figure>"
    head = "".join(f"<th>{escape(cell)}</th>" for cell in part.head)
    rows = "".join(
        "<tr>" + "".join(f"<td>{escape(cell)}</td>" for cell in row) + "</tr>" for row in part.rows
    )
    return f"<p><b>{escape(part.caption)}</b></p><table><thead><tr>{head}</tr></thead><tbody>{rows}</tbody></table>"


def _row(claim: Claim) -> str:
    published = "–" if claim.published is None else f"{claim.published:.4g}"
    ours = f"{claim.ours:.4g}" if math.isfinite(claim.ours) else "not found"
    state = f'<span class="{"met" if claim.met else "not"}">{claim.state}</span>'
    parts = (claim.rule.text, claim.conditions, claim.contradicted)
    detail = escape("; ".join(part for part in parts if part))
    return (
        f'<tr><td>{escape(claim.claim)}<br><small>{detail}</small></td><td class="n">{published}</td>'
        f'<td class="n">{ours}</td><td>{escape(claim.unit)}</td><td>{state}</td></tr>'
    )
