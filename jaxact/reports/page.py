"""One self-contained HTML file: the page's modules, its style and its data, and nothing else.

A content security policy allows exactly the script and the style that are in the file, by their
hashes: no network, no `eval`, nothing that text in the data could start.
"""

from __future__ import annotations

import base64
import hashlib
import html
import json
import re
from collections.abc import Mapping
from dataclasses import dataclass
from importlib import resources
from typing import Any

from jaxact import files

_FOLDER = resources.files("jaxact.reports") / "page"
_IMPORT = re.compile(r'^import \{([^}]*)\} from "\./(\w+)\.js";\n', re.MULTILINE)
_WHOLE = re.compile(r'^import \* as (\w+) from "\./(\w+)\.js";\n', re.MULTILINE)
_EXPORT = re.compile(r"^export ((?:async )?(?:function[*]?|const|class) (\w+))", re.MULTILINE)


@dataclass(frozen=True)
class Content:
    """What is on a page.

    Attributes:
        title, description: as a person wrote them; shown as text, whatever is in them.
        parts: one below the other: data as plain values by the name of the part, whose sections
            are in `NAME.html` and whose module `NAME.js` has a function `start`.
        made: what the report was made of and with, by what it is called.
    """

    title: str
    description: str
    parts: Mapping[str, Mapping[str, Any]]
    made: Mapping[str, str]


def document(content: Content) -> str:
    """The whole file as text."""
    title, description, parts = content.title, content.description, content.parts
    script = bundle("main", *parts) + _started(parts)
    style, body = _read("style.css"), "".join(_read(f"{name}.html") for name in parts)
    # "<" in JSON could end the element that it stands in.
    plain = json.dumps(files.plain(parts), allow_nan=False).replace("<", "\\u003c")
    policy = (
        f"default-src 'none'; script-src '{_hash(script)}'; style-src '{_hash(style)}';"
        " img-src data:; base-uri 'none'; form-action 'none'"
    )
    about = "\n".join(
        f'<h3>{html.escape(name)}</h3>\n<pre tabindex="0" id="made-{i}">{html.escape(text)}</pre>'
        f'<button type="button" class="copy" data-of="made-{i}">copy</button>'
        for i, (name, text) in enumerate(content.made.items())
    )
    says = f"<p>{html.escape(description)}</p>\n" if description else ""
    return f"""<!doctype html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta http-equiv="Content-Security-Policy" content="{policy}">
<meta name="viewport" content="width=device-width, initial-scale=1">
<link rel="icon" href="data:,">
<title>{html.escape(title)}</title>
<style>{style}</style>
</head>
<body>
<header>
<h1>{html.escape(title)}</h1>
{says}</header>
<main>
{body}</main>
<footer>
<h2>How this was made</h2>
{about}
</footer>
<script type="application/json" id="data">{plain}</script>
<script>{script}</script>
</body>
</html>
"""


def widget() -> str:
    """The joint's part as a module for notebooks, whose default export has `render`."""
    content = f"<style>{_read('style.css')}</style>\n<main>\n{_read('joint.html')}</main>\n"
    return (
        f"{bundle('widget')}const content = {json.dumps(content)};\n"
        "export default { render: (context) => in_widget.render(context, content) };\n"
    )


def bundle(*entries: str) -> str:
    """The modules that one needs as a single script, each a function of its own.

    `import` and `export` are those of a few fixed forms; a module becomes a constant with what it
    exports. The same modules are what node tests.

    Args:
        entries: the modules that are wanted, without `.js`; each becomes `in_NAME`.
    """
    done: dict[str, str] = {}

    def add(name: str) -> None:
        source = _read(f"{name}.js")
        needed = [one for _, one in (*_IMPORT.findall(source), *_WHOLE.findall(source))]
        for one in needed:
            if one not in done:
                add(one)
        source = _IMPORT.sub(lambda found: f"const {{{found[1]}}} = in_{found[2]};\n", source)
        source = _WHOLE.sub(lambda found: f"const {found[1]} = in_{found[2]};\n", source)
        exported = ", ".join(found[1] for found in _EXPORT.findall(source))
        source = _EXPORT.sub(r"\1", source)
        done[name] = f"const in_{name} = (() => {{\n{source}return {{ {exported} }};\n}})();\n"

    for entry in entries:
        if entry not in done:
            add(entry)
    return '"use strict";\n' + "".join(done.values())


def _started(parts: Mapping[str, Any]) -> str:
    """What starts the parts of a page."""
    return f"in_main.begin({{ {', '.join(f'{name}: in_{name}.start' for name in parts)} }});\n"


def _read(name: str) -> str:
    return (_FOLDER / name).read_text(encoding="utf-8")


def _hash(text: str) -> str:
    digest = hashlib.sha256(text.encode()).digest()
    return f"sha256-{base64.b64encode(digest).decode()}"
