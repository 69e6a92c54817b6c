"""What the commands print with `--json`, as JSON schemas that are inferred from what they print.

Every command is run on examples that differ in what is there and what is null. Keys that are names
of joints, bodies or groups in an example stand for any name (`additionalProperties`).
"""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[2]
ARM = """
<mujoco><worldbody><body name="upper"><joint name="shoulder" axis="0 1 0" armature="0.02"
 frictionloss="0.2"/><geom type="capsule" size="0.03" fromto="0 0 0 0 0 -0.3"/>
<body name="lower" pos="0 0 -0.3"><joint name="elbow" axis="0 1 0" armature="0.01" damping="0.5"/>
<geom type="capsule" size="0.02" fromto="0 0 0 0 0 -0.25"/></body></body></worldbody>
<actuator><position name="shoulder" joint="shoulder" kp="60" kv="3"/>
<position name="elbow" joint="elbow" kp="20"/></actuator></mujoco>
"""
NAMES = {"shoulder", "elbow", "upper", "lower", "ankle", "trunk"}
STARLETH = ["--actuator", "starleth", "--delay", "0.001"]
BARE = ["--kp", "40", "--kd", "2"]
# Title -> the commands that are merged into one schema.
EXAMPLES: dict[str, list[list[str]]] = {
    "margins of a joint": [
        ["margins", "--kp", "400", "--kd", "20", *STARLETH],
        ["margins", "--kp", "400", "--kd", "20", *STARLETH, "--control-rate", "1000"],
        ["margins", "--kp", "9000", "--kd", "20", *STARLETH, "--control-rate", "1000"],
    ],
    "margins of a robot": [
        ["margins", "--model", "arm.xml", *STARLETH],
        ["margins", "--model", "arm.xml", "--set", "gain_scale=30", "--actuator", "starleth"],
    ],
    "check": [["check", "arm.xml"], ["check", "arm.xml", "--control-rate", "500"]],
    "tune of a joint": [
        ["tune", "--kp", "400", "--kd", "20", *STARLETH, "--max-peak", "1.6"],
        [
            "tune",
            *STARLETH,
            "--max-peak",
            "1.6",
            "--min-kp",
            "4000",
            "--uncertainty",
            "delay=1e-3..5e-3",
        ],
    ],
    "tune of a robot": [
        ["tune", "--model", "arm.xml", *BARE, *STARLETH, "--max-peak", "2"],
    ],
    "info": [["info"]],
}


def page() -> str:
    """The page of the JSON that commands print; `schemas.json` is written beside it."""
    found = {title: schema_of(title) for title in EXAMPLES}
    target = ROOT / "docs" / "reference" / "schemas.json"
    target.write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")
    parts = [
        "# JSON", "",
        "What commands print with `--json`: one object, of several loops one a line. Units are",
        "SI (`jaxact COMMAND --help` says what the keys mean); what is infinite is the string",
        "`\"inf\"`, what is not there or not known is null. `[]` stands for each element of an",
        "array, `NAME` for the name of a joint or a group. The same as JSON schemas:",
        "{download}`schemas.json <schemas.json>`.", "",
        "```sh", "jaxact margins --kp 400 --kd 20 --actuator starleth --json", "```", "",
    ]  # fmt: skip
    for title, schema in found.items():
        rows = [f"| `{path}` | {kinds} |" for path, kinds in rows_of(schema)]
        parts += [f"## {title.capitalize()}", "", "| key | |", "|---|---|", *rows, ""]
    return "\n".join(parts)


def schema_of(title: str) -> dict[str, Any]:
    """The schema of what the examples of a title print."""
    with tempfile.TemporaryDirectory() as folder:
        (Path(folder) / "arm.xml").write_text(ARM)
        printed = [value for words in EXAMPLES[title] for value in _run(words, folder)]
    schema = infer(printed)
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", "title": title, **schema}


def _run(words: list[str], folder: str) -> list[Any]:
    ran = subprocess.run(
        [sys.executable, "-m", "jaxact", *words, "--json"],
        cwd=folder, capture_output=True, text=True, check=False,
    )  # fmt: skip
    if ran.returncode not in (0, 1):  # 1: nothing certified, or something refused
        raise RuntimeError(f"jaxact {' '.join(words)}: {ran.stderr}")
    values, text, decoder = [], ran.stdout.strip(), json.JSONDecoder()
    while text:
        value, end = decoder.raw_decode(text)
        values.append(value)
        text = text[end:].strip()
    return values


def infer(values: list[Any]) -> dict[str, Any]:
    """The narrowest schema of values: of objects all keys, of arrays all elements."""
    kinds = sorted({_kind(value) for value in values})
    schema: dict[str, Any] = {"type": kinds[0] if len(kinds) == 1 else kinds}
    objects = [value for value in values if isinstance(value, dict)]
    keys = list(dict.fromkeys(key for one in objects for key in one))
    if keys and NAMES.issuperset(key for key in keys):
        schema["additionalProperties"] = infer([inner for one in objects for inner in one.values()])
    elif keys:
        schema["properties"] = {
            key: infer([one[key] for one in objects if key in one]) for key in keys
        }
        schema["required"] = [key for key in keys if all(key in one for one in objects)]
    elements = [inner for value in values if isinstance(value, list) for inner in value]
    if elements:
        schema["items"] = infer(elements)
    return schema


def _kind(value: Any) -> str:
    kinds = {type(None): "null", bool: "boolean", str: "string", dict: "object", list: "array"}
    return kinds.get(type(value), "number")


def rows_of(schema: dict[str, Any], path: str = "") -> list[tuple[str, str]]:
    """Each key of a schema as a path with its types."""
    rows = []
    required = schema.get("required", ())
    for key, inner in schema.get("properties", {}).items():
        where = f"{path}.{key}" if path else key
        kinds = inner["type"] if isinstance(inner["type"], list) else [inner["type"]]
        rows.append((where, ", ".join(kinds) + ("" if key in required else "; not always there")))
        rows += rows_of(inner, where)
    if "additionalProperties" in schema:
        where = f"{path}.NAME"
        rows.append((where, _words(schema["additionalProperties"])))
        rows += rows_of(schema["additionalProperties"], where)
    if "items" in schema:
        rows += rows_of(schema["items"], f"{path}[]")
    return rows


def _words(schema: dict[str, Any]) -> str:
    kinds = schema["type"]
    return ", ".join(kinds) if isinstance(kinds, list) else kinds
