"""How docstrings of this project are read: as numpydoc, with the description beside the name.

`name : text` stands where numpydoc has `name : type` and the text below: the type is in the signature already.
"""

import re

import griffe

_SECTION = re.compile(r"^(Parameters|Attributes|Returns|Yields|Raises|Examples)\n-+\n", re.MULTILINE)


def numpydoc(text: str) -> str:
    """Return a docstring with the descriptions of its sections where numpydoc has them."""
    pieces = _SECTION.split(text)
    rewritten = [pieces[0]]
    for name, body in zip(pieces[1::2], pieces[2::2], strict=True):
        lines = body.rstrip().split("\n")
        if name != "Examples":
            lines = [line for entry in lines for line in _entry(entry, name)]
        rewritten.append("\n".join([name, "-" * len(name), *lines, "", ""]))
    return "".join(rewritten).rstrip()


def _entry(line: str, section: str) -> list[str]:
    if not line or line.startswith(" "):
        return [line]
    head, colon, text = line.partition(" : ")
    if not colon:
        # what is returned is told in words
        return [line] if section in ("Parameters", "Attributes") else ["result", f"    {line}"]
    return [head, f"    {text}"]


class DocstringStyle(griffe.Extension):
    """Rewrites every docstring before it is parsed."""

    def on_object(self, *, obj: griffe.Object, **_: object) -> None:
        """Rewrite the docstring of a module, class, function or constant."""
        if obj.docstring:
            obj.docstring.value = numpydoc(obj.docstring.value)
