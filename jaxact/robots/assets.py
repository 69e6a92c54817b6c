"""Files of meshes and textures: found in ROS packages, and left out where only looked at."""

from __future__ import annotations

import os
import re
import warnings
from pathlib import Path

import mujoco

from jaxact.robots.findings import HARMLESS, Finding, named

MISSING = "missing files"
"""Field of the finding on files that were left out."""

_OPENING = re.compile(r"opening file '([^']+)'")
_PACKAGE = re.compile(r"package://([^/]+)/(.+)")


def find_packages(spec: mujoco.MjSpec) -> None:
    """Let meshes at package://NAME/REST point at the files, as ROS would find them.

    ROS knows where its packages are; here they are looked for from the model's folder upwards:
    NAME/REST in one of those folders, or REST where the package's folder has another name. What is
    not found stays as it is.
    """
    folder = Path(spec.modelfiledir).resolve()
    base = folder / spec.meshdir
    for mesh in spec.meshes:
        if (uri := _PACKAGE.fullmatch(mesh.file)) is None:
            continue
        near = (
            up / path
            for up in (folder, *folder.parents)
            for path in (uri[1] + "/" + uri[2], uri[2])
        )
        if (file := next(filter(Path.is_file, near), None)) is not None:
            mesh.file = os.path.relpath(file, base)


def compile_model(
    spec: mujoco.MjSpec, *, untouched: bool = False
) -> tuple[mujoco.MjModel, list[Finding]]:
    """Compile a specification without the missing files of what is only looked at.

    A geom is only looked at if it touches nothing and its body's inertia is given or does not
    come from it.

    Args:
        spec: geoms, meshes and textures that are left out are removed from it.
        untouched: nothing will touch whatever has hinge or slide joints.

    Returns:
        The model, and what is to be said: of files left out, and of MuJoCo's own warnings.

    Raises:
        ValueError: MuJoCo refuses the model; with its reason.
    """
    gone: list[str] = []
    while True:
        try:
            with warnings.catch_warnings(record=True) as caught:
                warnings.simplefilter("always")
                model = spec.compile()
            break
        except ValueError as error:
            missing = _OPENING.search(str(error))
            if missing is None or not _leave_out(spec, Path(missing[1]).name, untouched=untouched):
                raise
            gone.append(Path(missing[1]).name)
            # Compiling once for each file takes seconds: the others that are not there either.
            for name in _not_there(spec):
                _leave_out(spec, name, untouched=untouched)
                gone.append(name)
    said = {" ".join(str(warning.message).split()) for warning in caught}
    found = [
        Finding(
            "model", "warning", text, "is not concerned", HARMLESS, "a remark of MuJoCo's compiler"
        )
        for text in sorted(said)
    ]
    if gone:
        value = gone[0] if len(gone) == 1 else f"{gone[0]} and {len(gone) - 1} more"
        found.append(
            Finding(
                "model",
                MISSING,
                value,
                "cannot load the model",
                HARMLESS,
                "only looked at: geoms that touch nothing and give no inertia, and textures; they "
                "are left out",
            )  # fmt: skip
        )
    return model, found


def _not_there(spec: mujoco.MjSpec) -> list[str]:
    """Names of the files of meshes that no file lies behind, each once, as MuJoCo meets them."""
    folder = Path(spec.modelfiledir) / spec.meshdir
    files = dict.fromkeys(mesh.file for mesh in spec.meshes if mesh.file)
    known = {asset.rpartition("/")[2] for asset in spec.assets}
    gone = [file for file in files if not (folder / file).is_file()]
    names = dict.fromkeys(Path(file).name for file in gone if Path(file).name not in known)
    # Files are told apart by their names: one that is there has to stay.
    there = {Path(file).name for file in files if file not in gone}
    return [name for name in names if name not in there]


def _leave_out(spec: mujoco.MjSpec, file: str, *, untouched: bool) -> bool:
    """Remove what comes from this file; False if nothing does.

    Raises:
        ValueError: the motion depends on it.
    """
    meshes = [mesh for mesh in spec.meshes if Path(mesh.file).name == file]
    names = {mesh.name for mesh in meshes}
    geoms = [geom for geom in spec.geoms if geom.meshname in names] if meshes else []
    for geom in geoms:
        inertia = _gives_inertia(spec, geom)
        stands = untouched and _has_single_joints(geom.parent)
        if inertia or (_touches(spec, geom) and not stands):
            raise ValueError(_needed(spec, geom, meshes[0].file, inertia=inertia))
    textures = [
        texture
        for texture in spec.textures
        if file in {Path(name).name for name in (texture.file, *texture.cubefiles)}
    ]
    lost = {texture.name for texture in textures}
    for material in spec.materials if textures else ():
        material.textures = ["" if name in lost else name for name in material.textures]
    for item in (*geoms, *meshes, *textures):
        spec.delete(item)
    return bool(meshes or textures)


def _needed(spec: mujoco.MjSpec, geom: mujoco.MjsGeom, file: str, *, inertia: bool) -> str:
    body = named("body", geom.parent.name, geom.parent.id)
    said = (
        f"the mesh file {file} is missing, and {body} needs it for its "
        f"{'inertia' if inertia else 'contacts'}; it was looked for from "
        f"{Path(spec.modelfiledir) / spec.meshdir} on, and `meshdir` of <compiler> says otherwise"
    )
    return said if inertia else said + '; on a stand, base = "fixed", nothing touches the robot'


def _touches(spec: mujoco.MjSpec, geom: mujoco.MjsGeom) -> bool:
    paired = any(geom.name in (pair.geomname1, pair.geomname2) for pair in spec.pairs)
    return bool(geom.contype or geom.conaffinity or paired)


def _gives_inertia(spec: mujoco.MjSpec, geom: mujoco.MjsGeom) -> bool:
    from_geoms = spec.compiler.inertiafromgeom
    given = (
        geom.parent.explicitinertial
        and from_geoms != mujoco.mjtInertiaFromGeom.mjINERTIAFROMGEOM_TRUE
    )
    weightless = geom.mass == 0.0 or (geom.mass != geom.mass and geom.density == 0.0)
    return not (given or weightless or geom.parent.name == "world")


def _has_single_joints(body: mujoco.MjsBody) -> bool:
    """Whether the tree that the body belongs to has hinge or slide joints."""
    if body.name == "world":
        return False
    while body.parent.name != "world":
        body = body.parent
    single = (mujoco.mjtJoint.mjJNT_HINGE, mujoco.mjtJoint.mjJNT_SLIDE)
    return any(joint.type in single for joint in body.find_all("joint"))
