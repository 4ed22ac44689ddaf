"""The difference between two MjModels of one robot, written into its MJCF.

    next_mjcf(robot, model, delay, out, comment) -> NextMjcf    its author's text with the changed attributes
    patched(robot, model, delay) -> str                         text that MuJoCo writes anew, where the author's cannot hold them

An effect changes an MjModel only (fishmj/effects); this table says which attribute of MJCF holds which field. The text is
compiled, and is taken only if all fields are those that MuJoCo compiles from the same changes to its own MjSpec.
"""

import difflib
import os
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import mujoco
import numpy as np

from fishmj.base.errors import ConfigError
from fishmj.base.store import temporary_beside
from fishmj.gap.models import joint_laws
from fishmj.gap.models.mjcf_text import MjcfElement, MjcfText, NotEditable, with_comment
from fishmj.gap.models.robot_description import FREE, RobotDescription
from fishmj.gap.models.robot_kernel import rotation

JOINT = ("stiffness", "jnt_stiffness", "jnt_stiffnesspoly"), ("damping", "dof_damping", "dof_dampingpoly")
ACTUATOR = ("gainprm", "biasprm", "gear", "forcerange", "ctrlrange", "biastype", "forcelimited")
BODY = ("mass", "inertia", "ipos", "iquat")
GAINS, BIASES = {0: "fixed", 1: "affine"}, {0: "none", 1: "affine"}  # of MuJoCo's enumerations
OPTION = ("gravity", "wind", "density")
ROUNDED = 2e-5  # relative; a written number has six digits
REWRITTEN = 1e-3  # relative; MuJoCo rounds the sizes of geoms, too
SOURCE = ("paths", "npaths", "nbuffer", "signature")  # what of a model is of its text
# Frames of the inertia may be numbered otherwise; ctrlspec says what a command means, and no dynamics.
FRAMES = ("body_inertia", "body_iquat", "body_sameframe", "geom_sameframe", "site_sameframe", "bvh_aabb", "actuator_ctrlspec")
# Fields that mj_setConst computes from others; jnt_user holds values of laws, which callback_module.py writes.
FOLLOWING = (
    *("actuator_acc0", "body_invweight0", "body_subtreemass", "cam_poscom0", "dof_M0", "dof_invweight0", "dof_length"),
    *("light_poscom0", "tendon_invweight0", "jnt_user"),
)
Changes = dict[tuple[str, int], dict[str, Any]]  # {(part, its number): {attribute of MjSpec: value}}


class NextMjcf(NamedTuple):
    """A patched description. diff: unified, of the lines that differ in meaning. how: clause that says what was written."""

    data: bytes
    diff: str
    how: str


def next_mjcf(robot: RobotDescription, model: Any, delay: float, out: Path, comment: str) -> NextMjcf:
    """MJCF of the description with the fields of a changed model, for a file `out` that begins with a comment.

    Raises:
        ConfigError: MuJoCo does not compile any text to these fields.
    """
    found = _changes(robot, model, delay)
    wanted = _compiled(_applied(robot, found))
    try:
        data = _own_text(robot, found, wanted, out.parent, comment)
        if other := differing(_compiled_at(data, out), wanted):
            raise NotEditable(f"MuJoCo compiles the changed text of {robot.path.name} to another {other}")
        before, after = (part.decode(errors="replace") for part in (robot.path.read_bytes(), data))
        diff = _unified(before, after, robot.path.name, out.name)
        return NextMjcf(data, diff, f"{out.name} is the text of {robot.path.name} with these attributes changed")
    except NotEditable as why:
        text = patched(robot, model, delay, out.parent)
        data = with_comment(text.encode(), comment)
        unlike = _between(robot, _compiled_at(data, out), model, REWRITTEN)
        _refuse(robot, {key: values for key, values in unlike.items() if key in found})
        spec = robot.spec.copy()
        _compiled(spec)
        diff = _unified(spec.to_xml(), text, robot.path.name, out.name)
        return NextMjcf(data, diff, f"MuJoCo wrote {out.name} anew without comments and layout: {why}")


def patched(robot: RobotDescription, model: Any, delay: float = 0.0, folder: Path | None = None) -> str:
    """MJCF that MuJoCo writes. delay: s that all commands come later. folder: where the text will lie, if it is another."""
    spec = _applied(robot, _changes(robot, model, delay))
    _compiled(spec)
    text = MjcfText(robot.path, spec.to_xml().encode())
    text.set_section("compiler", _folders(robot, folder or robot.path.parent), {})
    return text.written().decode()


def differing(one: Any, other: Any) -> str:
    """Name of the first field in which two MjModels differ, "" if there is none. Inertias are compared as tensors."""
    return next(_unlike(one, other), "")


def _unlike(one: Any, other: Any) -> Iterator[str]:
    """Names of the fields in which two MjModels differ."""
    pairs = [
        (name, getattr(one, name), getattr(other, name)) for name in dir(one) if name[0] != "_" and name not in (*SOURCE, *FRAMES)
    ]
    pairs += [(f"opt.{name}", getattr(one.opt, name), getattr(other.opt, name)) for name in dir(one.opt) if name[0] != "_"]
    size = np.maximum(other.body_inertia.sum(1), 1e-300)[:, None, None]
    pairs += [("body_inertia", *(_tensors(m.body_inertia, m.body_iquat) / size for m in (one, other)))]
    for name, a, b in pairs:
        if name.endswith("pathadr") or not isinstance(a, int | float | bytes | np.ndarray):
            continue
        if isinstance(a, bytes) or isinstance(b, bytes):
            if a != b:
                yield name
            continue
        a, b = np.asarray(a), np.asarray(b)
        near = 1e-9 * np.abs(b[np.isfinite(b)]).max(initial=0.0) if b.dtype.kind == "f" else 0.0
        near = ROUNDED if name == "body_inertia" else near
        if a.shape != b.shape or not np.allclose(a, b, ROUNDED if b.dtype.kind == "f" else 0.0, near, equal_nan=True):
            yield name


def _changes(robot: RobotDescription, model: Any, delay: float) -> Changes:
    """Attributes with which MuJoCo compiles the description to the fields of `model`; other ones follow from some of them."""
    found = _between(robot, robot.model, model)
    _free_inertia(robot, found, model)
    more: Changes = {}
    for _ in range(3):  # kv, for one, follows from dampratio and armature
        for key, values in more.items():
            found.setdefault(key, {}).update(values)
        compiled = _compiled(_applied(robot, found))
        more = _between(robot, compiled, model)
        if not more:
            break
    _refuse(robot, more)
    _refuse_unwritten(robot, compiled, model)
    for a in range(len(robot.spec.actuators) if delay else 0):
        later = float(robot.delays[a] + delay)
        samples = int(np.ceil(later / model.opt.timestep)) + 1
        found.setdefault(("actuator", a), {}).update(delay=later, nsample=samples)
    flags, off = {}, robot.spec.option.disableflags
    if model.jnt_user.any():  # laws of joint_laws.py
        needed = joint_laws.remembered(robot.model.njnt)
        if robot.spec.nuserdata < needed:
            found["size", 0] = {"nuserdata": needed}
        flags["island"] = "disable"
    if any(model.dof_frictionloss > robot.model.dof_frictionloss):  # MuJoCo's dry friction is a constraint
        flags |= dict.fromkeys(("constraint", "frictionloss"), "enable")
    if flags := {name: state for name, state in flags.items() if bool(off & _flag(name)) != (state == "disable")}:
        found["flag", 0] = flags
    return found


def _free_inertia(robot: RobotDescription, found: Changes, model: Any) -> None:
    """Adds what lets a compiler take inertias as they are stated, if it takes those of geoms only, or scales the total mass."""
    compiler, before, own = robot.spec.compiler, robot.model, [values for (part, _), values in found.items() if part == "body"]
    changed = {}
    if own and compiler.inertiafromgeom == mujoco.mjtInertiaFromGeom.mjINERTIAFROMGEOM_TRUE:
        changed["inertiafromgeom"] = "auto"
    if own and compiler.settotalmass > 0.0:
        unscaled = robot.spec.copy()
        unscaled.compiler.settotalmass = -1.0
        scale = before.body_mass[1:].sum() / _compiled(unscaled).body_mass[1:].sum()
        changed["settotalmass"] = _six(compiler.settotalmass + np.sum(model.body_mass - before.body_mass)).item()
        for values in own:
            values |= {name: _six(values[name] / scale) for name in ("mass", "inertia")}
    if changed:
        found["compiler", 0] = changed


def _between(robot: RobotDescription, before: Any, model: Any, near: float = ROUNDED) -> Changes:
    """Attributes whose fields differ between two models, by more than a share `near`."""
    spec, found = robot.spec, Changes()
    kept = [i for i, joint in enumerate(spec.joints) if joint.type != mujoco.mjtJoint(FREE)]
    for i, known in zip(kept, robot.joints, strict=True):
        values: dict[str, tuple[Any, Any]] = {}
        for name, first, more in JOINT:
            place = known.joint if first.startswith("jnt") else known.dof
            now, then = (np.append(getattr(x, first)[place], getattr(x, more)[place]) for x in (model, before))
            values[name] = now, then
        for name in ("frictionloss", "armature"):
            values[name] = getattr(model, f"dof_{name}")[known.dof], getattr(before, f"dof_{name}")[known.dof]
        found["joint", i] = _moved(values, near)
    for a in range(len(spec.actuators)):
        found["actuator", a] = _moved(
            {n: (getattr(model, f"actuator_{n}")[a], getattr(before, f"actuator_{n}")[a]) for n in ACTUATOR}, near
        )
    for number in robot.bodies.values():
        values = {n: (getattr(model, f"body_{n}")[number], getattr(before, f"body_{n}")[number]) for n in BODY}
        if moved := _moved(values, near):
            whole = {n: now for n, (now, _) in values.items()} | moved
            place = _place_of(spec, model, number)
            is_stated = spec.bodies[place].explicitinertial  # otherwise all of it is new in the text
            found["body", place] = whole if is_stated else {n: _six(value) for n, value in whole.items()}
    found["option", 0] = _moved({n: (getattr(model.opt, n), getattr(before.opt, n)) for n in OPTION}, near)
    return {key: values for key, values in found.items() if values}


def _place_of(spec: Any, m: Any, number: int) -> int:
    """Place in an MjSpec of a body of its MjModel, from which static ones may be left out by `fusestatic`."""
    name = mujoco.mj_id2name(m, mujoco.mjtObj.mjOBJ_BODY, number)
    return next((i for i, body in enumerate(spec.bodies) if name and body.name == name), number)


def _moved(pairs: dict[str, tuple[Any, Any]], near: float) -> dict[str, Any]:
    """Those of {name: (now, then)} that differ, with six digits where they do."""
    out = {}
    for name, (now, then) in pairs.items():
        a, b = np.asarray(now, float), np.asarray(then, float)
        differ = np.abs(a - b) > near * np.abs(a) + 1e-12 * np.abs(a).max()
        if differ.any():
            out[name] = np.where(differ, _six(a), a) if a.ndim else _six(a).item()
    return out


def _six(values: Any) -> np.ndarray:
    """Numbers rounded to six digits."""
    return np.vectorize(lambda x: float(f"{x:.6g}"), otypes=[float])(values)


def _applied(robot: RobotDescription, found: Changes) -> Any:
    """Copy of the description's MjSpec with changes."""
    spec = robot.spec.copy()
    for (part, i), values in found.items():
        if part == "flag":
            for name, state in values.items():
                off = spec.option.disableflags
                spec.option.disableflags = off | _flag(name) if state == "disable" else off & ~_flag(name)
            continue
        if "inertiafromgeom" in values:
            values = values | {"inertiafromgeom": mujoco.mjtInertiaFromGeom.mjINERTIAFROMGEOM_AUTO}
        if part == "body":
            body = spec.bodies[i]
            body.explicitinertial, body.fullinertia = True, [np.nan] * 6
            body.ialt.type = mujoco.mjtOrientation.mjORIENTATION_QUAT
        parts = {"joint": spec.joints, "actuator": spec.actuators, "body": spec.bodies}
        owner = parts[part][i] if part in parts else {"option": spec.option, "size": spec, "compiler": spec.compiler}[part]
        for name, value in values.items():
            whole = int(value) if name in ("biastype", "forcelimited") else value
            setattr(owner, name, mujoco.mjtBias(whole) if name == "biastype" else whole)
    return spec


def _flag(name: str) -> int:
    """Bit of a flag of <option> that disables something."""
    return int(getattr(mujoco.mjtDisableBit, f"mjDSBL_{name.upper()}"))


def _compiled(spec: Any) -> Any:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # the description's own, which reading it gave
        return spec.compile()


def _compiled_at(data: bytes, out: Path) -> Any:
    """MjModel of a text that will be the file `out`. Raises NotEditable if MuJoCo refuses it there."""
    out.parent.mkdir(parents=True, exist_ok=True)
    path = temporary_beside(out, ".xml")
    try:
        path.write_bytes(data)
        return _compiled(mujoco.MjSpec.from_file(str(path)))
    except (ValueError, mujoco.FatalError) as error:
        raise NotEditable(f"MuJoCo refuses it in {out.parent}: {' '.join(str(error).split())[:200]}") from error
    finally:
        path.unlink(missing_ok=True)


def _refuse(robot: RobotDescription, unlike: Changes) -> None:
    """Raises ConfigError if compiled attributes are not those that the effects need."""
    for (part, i), values in unlike.items():
        parts = {"joint": robot.spec.joints, "actuator": robot.spec.actuators, "body": robot.spec.bodies}
        what = f"{', '.join(values)} of {part} {(part in parts and parts[part][i].name) or i}"
        why = "its compiler changes it; look for settotalmass, boundmass, balanceinertia, inertiafromgeom, a scaled frame"
        raise ConfigError(f"{robot.path}: MuJoCo does not take {what} as the effects need it: {why}")


def _refuse_unwritten(robot: RobotDescription, compiled: Any, model: Any) -> None:
    """Raises ConfigError if the effects change a field, of the user's own perhaps, that the table of attributes leaves out."""
    lost = set(_unlike(compiled, model)) & set(_unlike(robot.model, model)) - {*FOLLOWING}
    if lost:
        joints = ", ".join([*(name for name, *_ in JOINT), "frictionloss", "armature"])
        held = f"{joints} of hinges and slides; {', '.join(ACTUATOR)}; {', '.join(BODY)}; {', '.join(OPTION)}"
        raise ConfigError(
            f"{robot.path}: an effect changes {', '.join(sorted(lost))} of the model, which is not written into MJCF."
            f" Written are {held}. Write that attribute by hand, or give the effect as a law of a joint"
        )


def _own_text(robot: RobotDescription, found: Changes, wanted: Any, folder: Path, comment: str) -> bytes:
    """The author's text with changes, for a file in a folder. wanted: MjModel of them."""
    text, spec = MjcfText(robot.path), robot.spec
    names = lambda known: [element.name or "" for element in known]
    for (part, i), values in found.items():
        if part == "joint":
            joint = text.matched(text.joints, names(spec.joints))[i]
            for name, value in values.items():
                joint.set(name, value)
        elif part == "actuator":
            _write_actuator(text.matched(text.actuators, names(spec.actuators))[i], values, robot, wanted, i)
        elif part == "body":
            _write_inertia(text, text.matched(text.bodies, names(spec.bodies[1:]))[i - 1], values)
    folders, compiler = _folders(robot, folder), text.root.child("compiler")
    if compiler and "assetdir" in compiler.attributes and len(set(folders.values())) == 1:
        folders = {"assetdir": folders.popitem()[1]}
    for part, more in (("size", {}), ("option", {}), ("compiler", folders)):
        text.set_section(part, found.get((part, 0), {}) | more, found.get(("flag", 0), {}) if part == "option" else {})
    for element in (*text.includes, *text.elements):
        if element.include is None and element.tag in ("include", "model") and "file" in element.attributes:
            element.set("file", _seen_from(folder, robot.path.parent, element.attributes["file"]))
    return text.written(comment)


def _write_actuator(element: MjcfElement, values: dict[str, Any], robot: RobotDescription, wanted: Any, a: int) -> None:
    """Writes gains as kp and kv where the element can hold them, else makes it a <general>."""
    gain, bias = wanted.actuator_gainprm[a], wanted.actuator_biasprm[a]
    if values.keys() & {"gainprm", "biasprm", "biastype"}:
        kp, kv = (0.0 if x == 0.0 else x for x in (-bias[1], -bias[2]))
        proper = gain[0] == {"position": kp, "velocity": kv}.get(element.tag) and not (
            gain[1:].any() or bias[0] or bias[3:].any()
        )
        if element.tag == "general":
            for name in ("gainprm", "biasprm"):
                if name in values:
                    element.set(name, values[name])
            if "biastype" in values:
                element.set("biastype", "affine")
        elif element.tag == "position" and proper:
            if "gainprm" in values:
                element.set("kp", kp)
            if bias[2] != robot.model.actuator_biasprm[a, 2]:
                element.set("kv", kv)
                element.rename("position", "dampratio")
        elif element.tag == "velocity" and proper and not bias[1]:
            element.set("kv", kv)
        else:
            if "inheritrange" in element.attributes:
                element.set("ctrlrange", wanted.actuator_ctrlrange[a])
            element.rename("general", "kp", "kv", "dampratio", "timeconst", "inheritrange")
            gaintype, biastype = GAINS.get(wanted.actuator_gaintype[a]), BIASES.get(wanted.actuator_biastype[a])
            if not gaintype or not biastype:
                raise NotEditable(f"<{element.tag}> has no attribute of its own for its changed gain or bias")
            element.set("gaintype", gaintype)
            element.set("gainprm", gain)
            element.set("biastype", biastype)
            if wanted.actuator_biastype[a]:
                element.set("biasprm", bias)
    for name in ("gear", "forcerange", "ctrlrange", "delay", "nsample"):
        if name in values:
            element.set(name, values[name])
    spec = robot.spec
    if "forcelimited" in values and not (spec.compiler.autolimits and int(spec.actuators[a].forcelimited) == 2):
        element.set("forcelimited", "true")


def _write_inertia(text: MjcfText, body: MjcfElement, values: dict[str, Any]) -> None:
    """Writes a body's <inertial> in the form that it has, or a new one."""
    element = body.child("inertial")
    if element is None:
        turn = {} if np.allclose(values["iquat"], (1, 0, 0, 0), atol=1e-12) else {"quat": values["iquat"]}
        text.insert_in(body, "inertial", pos=values["ipos"], **turn, mass=values["mass"], diaginertia=values["inertia"])
        return
    element.set("pos", values["ipos"])
    element.set("mass", values["mass"])
    if "fullinertia" in element.attributes:
        tensor = _tensors(values["inertia"][None], values["iquat"][None])[0]
        full = [*np.diag(tensor), tensor[0, 1], tensor[0, 2], tensor[1, 2]]
        element.set("fullinertia", _six(np.where(np.abs(full) < 1e-12 * np.trace(tensor), 0.0, full)))
    else:
        element.set("diaginertia", values["inertia"])


def _tensors(inertia: np.ndarray, iquat: np.ndarray) -> np.ndarray:
    """(N, 3, 3) inertia of bodies about their centres of mass, in the bodies' frames, from principal moments and axes."""
    turn = rotation(iquat)
    return np.einsum("bij,bj,bkj->bik", turn, inertia, turn)


def _folders(robot: RobotDescription, folder: Path) -> dict[str, str]:
    """{meshdir, texturedir: folder of the robot's files as seen from another folder}, of those that it has."""
    spec, own = robot.spec, robot.path.parent
    if folder.resolve() == own.resolve():
        return {}
    needed = {"meshdir": [x.file for x in (*spec.meshes, *spec.hfields, *spec.skins)]}
    needed["texturedir"] = [name for x in spec.textures for name in (x.file, *x.cubefiles)]
    return {n: _seen_from(folder, own, getattr(spec, n) or ".") for n, files in needed.items() if any(files)}


def _seen_from(folder: Path, own: Path, name: str) -> str:
    """A path relative to one folder, as seen from another."""
    if folder.resolve() == own.resolve() or os.path.isabs(name):
        return name
    target = (own / name).resolve()
    try:
        return Path(os.path.relpath(target, folder.resolve())).as_posix()
    except ValueError:  # another drive
        return target.as_posix()


def _unified(before: str, after: str, old: str, new: str) -> str:
    """Unified diff of two texts."""
    lines = difflib.unified_diff(before.splitlines(keepends=True), after.splitlines(keepends=True), old, new, n=1)
    return "".join(line if line.endswith("\n") else f"{line}\n\\ No newline at end of file\n" for line in lines)
