"""Reading gains from a file of any known format, which its content tells."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from jaxact.errors import UserError, nearest
from jaxact.gains import (
    configurations,
    deployment,
    onnx_metadata,
    own,
    python_source,
    simulator_dump,
)
from jaxact.gains.table import GainFile, split

# Name of a format -> what a file of it looks like.
FORMATS = {
    "toml": "jaxact's own: tables [kp] and [kd], joint = number, as `tune --out` writes gains.toml",
    "mjcf": "MuJoCo: <position joint= kp= kv=>, a section or a whole model",
    "deploy-yaml": "Unitree's: stiffness, damping, joint_ids_map",
    "rl-gym": "unitree_rl_gym's: kps, kds",
    "rl-sar": "rl_sar's: rl_kp, rl_kd, joint_names",
    "legged-gym": "legged_gym's: class control with stiffness = {...}, damping = {...}",
    "isaaclab": "Isaac Lab's: actuator configurations with joint_names_expr, .py or env.yaml",
    "onnx": "the metadata of an ONNX policy of mjlab: joint_names, joint_stiffness, joint_damping",
    "mjlab": "mjlab's: actuator configurations with target_names_expr, .py or env.yaml",
}
_MOST_BYTES = 20_000_000
_Yaml = Callable[[Path, Mapping[str, Any]], GainFile | None]
_YAML: tuple[_Yaml, ...] = (
    deployment.unitree, deployment.rl_gym, deployment.rl_sar, simulator_dump.read,
    configurations.legged_gym,
)  # fmt: skip


def read(file: str | Path) -> GainFile:
    """The gains that a file has.

    Args:
        file: its path; of a Python source with several configurations, or a YAML file with several
            robots, followed by `:` and the name of one, such as `unitree.py:UNITREE_GO2_CFG`.

    Raises:
        UserError: there is no such file, it is of no known format, or what it says makes no sense.
    """
    path, name = split(file)
    try:
        policy = path.suffix == ".onnx"
        if path.stat().st_size > _MOST_BYTES * (25 if policy else 1):
            raise UserError(f"{path}: has more than 20 MB; gains are given in a small text file")
        raw = path.read_bytes()
    except OSError as error:
        raise UserError(f"{path}: {error.strerror or error}; give a file of gains") from None
    if policy:
        return onnx_metadata.read(path, raw)
    if path.suffix in {".pt", ".pth", ".pkl", ".npz"} or b"\0" in raw[:4096]:
        raise UserError(
            f"{path}: is not a text file; give the YAML, TOML, MJCF or Python file beside it that"
            " has the gains"
        )
    try:
        text = raw.decode("utf-8-sig")
    except UnicodeDecodeError:
        raise UserError(f"{path}: is not UTF-8 text; save it as UTF-8") from None
    if name is not None and path.suffix not in (".py", ".yaml", ".yml"):
        raise UserError(
            f"{path}:{name}: only a Python source and an env.yaml or rl_sar's config.yaml have"
            " named configurations"
        )
    if text.lstrip().startswith("<"):
        return own.mjcf(path, text)
    if path.suffix == ".py":
        return python_source.read(path, text, name)
    return own.toml(path, text) if path.suffix == ".toml" else _from_yaml(path, text, name)


def _from_yaml(path: Path, text: str, name: str | None) -> GainFile:
    document = simulator_dump.load(path, text)
    if name is not None:
        tables = document if isinstance(document, Mapping) else {}
        found = deployment.rl_sar(path, tables, name)
        return found or simulator_dump.named(path, document, name)
    if isinstance(document, Mapping):
        for known in _YAML:
            found = known(path, document)
            if found is not None:
                return found
        keys = [str(key) for key in document]
        wanted = ("stiffness", "kps", "rl_kp", "control", "actuators")
        hint = f"; {nearest(keys[0], wanted)}" if keys else ""
        raise UserError(f"{path}: has no gains that are known here{hint}")
    raise UserError(f"{path}: is not a file of gains; known are {', '.join(FORMATS)}")
