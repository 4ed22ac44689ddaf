"""`gap apply` of a robot in MJCF: its author's own text with a few changed attributes, against MuJoCo's. *Synthetic*."""

import difflib

import mujoco
import numpy as np
import pytest
from robot_arm import ARM
from robot_texts import LEG, write_leg
from test_gap_robot import SERVO, named, verdict_of

from fishmj.base.errors import ConfigError
from fishmj.gap.commands.apply_robot import apply_robot, changed
from fishmj.gap.models.mjcf_text import MjcfText, with_comment
from fishmj.gap.models.robot_description import read_robot
from fishmj.gap.models.robot_patch import differing, next_mjcf, patched

FIRST = "NAMED by fishmj gap find, MuJoCo"
HIP, SHANK = '<position name="hip" joint="hip" class="leg" kp=', '<inertial pos="0 0 -0.15000000000000002" mass="'
OWN_HIP = "<joint name='hip' axis=\"0 1 0\" range='-60 60'"
ELBOW, MOTOR = '<joint name="elbow" type="hinge" axis="0 1 0" damping="0.02', 'name="elbow" joint="elbow" ctrlrange="-4 4"'
LOWER = '<inertial pos="0.02 0 -0.15" mass="0.4" diaginertia="0.003 0.003 0.0003"/>'
# effect -> (values, site and added lines of the arm, of the leg)
EFFECTS = {
    "coulomb_friction": (
        {"torque": 0.06},
        ("elbow", [f'{ELBOW}" frictionloss="0.06"/>']),
        ("hip", [f'{OWN_HIP} frictionloss="0.08"/>']),
    ),
    "viscous_friction": (
        {"damping": 0.1},
        ("elbow", ['<joint name="elbow" type="hinge" axis="0 1 0" damping="0.12"/>']),
        ("knee", ['axis="0 1 0"', 'damping="0.15 0.01"/>']),
    ),
    "quadratic_friction": ({"drag": 0.02}, ("elbow", [f'{ELBOW} 0.02"/>']), ("hip", [f'{OWN_HIP} damping="0.05 0.03"/>'])),
    "joint_stiffness": (
        {"stiffness": 0.3},
        ("elbow", [f'{ELBOW}" stiffness="0.3"/>']),
        ("knee", ['axis="0 1 0"', 'stiffness="1.8"/>']),
    ),
    "rotor_inertia": (
        {"inertia": 0.004},
        ("elbow", [f'{ELBOW}" armature="0.004"/>']),
        ("hip", [f'{OWN_HIP} armature="0.004"/>', f'{HIP}"20" kv="2.01977"/>']),  # of dampratio
    ),
    "torque_saturation": (
        {"limit": 0.4},
        ("elbow", [f'<motor {MOTOR} forcerange="-0.4 0.4"/>']),
        ("knee", ['<velocity name="knee" joint="knee" kv="0.8" forcelimited="true" forcerange="-0.4 0.4"></velocity>']),
    ),
    "servo_gain": (
        {"gain": 0.25},
        ("elbow", [f'<general {MOTOR} gaintype="fixed" gainprm="1.25" biastype="none"/>']),
        ("hip", [f'{HIP}"25" kv="2.52472"/>']),
    ),
    "torque_offset": (
        {"torque": 0.05},
        ("elbow", [f'<general {MOTOR} gaintype="fixed" gainprm="1" biastype="affine" biasprm="0.05"/>']),
        (
            "knee",
            [
                '<general name="knee" joint="knee" forcelimited="false" gaintype="fixed" gainprm="0.8" biastype="affine" '
                'biasprm="0.05 0 -0.8"></general>'
            ],
        ),
    ),
    "command_latency": (
        {"delay": 0.02},
        ("", [f'<motor {x} delay="0.02" nsample="11"/>' for x in (MOTOR.replace("elbow", "shoulder").replace("4", "6"), MOTOR)]),
        (
            "",
            [
                f'{HIP}"20" delay="0.02" nsample="11"/>',
                '<velocity name="knee" joint="knee" kv="0.8" forcelimited="false" delay="0.02" nsample="11"></velocity>',
            ],
        ),
    ),
    "body_mass": (
        {"mass": 0.1},
        ("lower", ['<inertial pos="0.02 0 -0.15" mass="0.5" diaginertia="0.00375 0.00375 0.000375"/>']),
        (
            "thigh",
            ['<inertial pos="0 0 -0.15" mass="1.06133" diaginertia="0.01051 0.01051 0.00046636"/>', f'{HIP}"20" kv="2.01977"/>'],
        ),
    ),
    "com_offset": (
        {"x": 0.02, "y": 0.0, "z": -0.03},
        ("lower", ['<inertial pos="0.04 0 -0.18" mass="0.4" diaginertia="0.003 0.003 0.0003"/>']),
        ("shank", ['<inertial pos="0.02 0 -0.18" mass="0.4"', f'{HIP}"20" kv="2.01977"/>']),
    ),
    "link_inertia": (
        {"share": 1.0},
        ("lower", ['<inertial pos="0.02 0 -0.15" mass="0.4" diaginertia="0.006 0.006 0.0006"/>']),
        ("shank", ['fullinertia="0.006 0.0062 0.0008 0 2e-05 0"/>', f'{HIP}"20" kv="2.01977"/>']),
    ),
    "payload": (
        {"mass": 0.1},
        ("lower", ['<inertial pos="0.024 0 -0.18" mass="0.5" diaginertia="0.0048 0.004832 0.000332"/>']),
        (
            "shank",
            [
                '<inertial pos="0 0 -0.18" mass="0.5"',
                'fullinertia="0.00479994 0.0049 0.000400053 0 1.69227e-05 0"/>',
                f'{HIP}"20" kv="2.01977"/>',
            ],
        ),
    ),
    "air_drag": (
        {"density": 60.0},
        ("", ['<option timestep="0.002" integrator="implicitfast" density="60"/>']),
        ("", ['<option timestep="0.002" density="60"/>  <!-- of the recording -->']),
    ),
    "base_tilt": (
        {"pitch": 0.1, "roll": 0.0},
        ("", ['<option timestep="0.002" integrator="implicitfast" gravity="0.979366 0 -9.76099"/>']),
        ("", ['<option timestep="0.002" gravity="0.979366 0 -9.76099"/>  <!-- of the recording -->']),
    ),
    "steady_wind": (
        {"x": 25.0, "y": 0.0, "z": 5.0},
        ("", ['<option timestep="0.002" integrator="implicitfast" wind="25 0 5" density="1.2"/>']),
        ("", ['<option timestep="0.002" wind="25 0 5" density="1.2"/>  <!-- of the recording -->']),
    ),
    "stribeck": (  # a law of the module beside it
        {"torque": 0.06, "speed": 0.4},
        (
            "elbow",
            [
                '<size nuserdata="40"/>',
                '<option timestep="0.002" integrator="implicitfast">',
                '<flag island="disable"/>',
                "</option>",
                f'{ELBOW}" frictionloss="1e-06"/>',
            ],
        ),
        (
            "hip",
            [
                '<size nuserdata="40"/>',
                '<option timestep="0.002">',
                '<flag island="disable"/>',
                "</option>  <!-- of the recording -->",
            ],
        ),
    ),
}


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("texts")


@pytest.fixture(scope="module")
def robots(folder):
    (folder / "arm.xml").write_text(ARM)
    return {"arm": read_robot(folder / "arm.xml"), "leg": read_robot(write_leg(folder))}


def with_effect(robot, name: str, **values: float):
    m, delay, _ = changed(robot, [named(name, **values)])
    return m, delay


def written_next(robot, folder, name: str, **values: float):
    """(next version, MjModel of it, reference that MuJoCo writes and compiles)."""
    m, delay = with_effect(robot, name, **values)
    out = folder / "next.xml"
    made = next_mjcf(robot, m, delay, out, "a comment")
    out.write_bytes(made.data)
    reference = mujoco.MjSpec.from_string(patched(robot, m, delay, folder)).compile() if not robot.spec.meshes else None
    return made, mujoco.MjModel.from_xml_path(str(out)), reference


@pytest.mark.parametrize("name", EFFECTS)
@pytest.mark.parametrize("robot", ["arm", "leg"])
def test_version_is_the_own_text_but_for_the_effect(robot, name, robots, folder):
    values, *each = EFFECTS[name]
    site, lines = each[robot == "leg"]
    described = robots[robot]
    made, compiled, reference = written_next(described, folder, f"{name}@{site}" if site else name, **values)
    assert "these attributes changed" in made.how
    assert differing(compiled, reference) == ""
    own, after = described.path.read_text().splitlines(), made.data.decode().splitlines()
    diff = [line for line in difflib.ndiff(own, after) if line[0] in "+-"]
    added = [line[2:].strip() for line in diff if line[0] == "+" and "a comment" not in line]
    assert added == lines
    removed = sum(line[0] == "-" for line in diff if "<?xml" not in line)
    assert removed <= len(added)  # what is removed was changed, too
    assert made.diff.count("\n+") == len(added) + 2 and made.diff.startswith("--- ")


def test_general_in_place_of_a_servo_moves_alike(tmp_path):
    """A <general> without `input` has another ctrlspec than the <position> that it replaces, and the same force."""
    path = tmp_path / "servo.xml"
    path.write_text(SERVO)
    _, compiled, reference = written_next(read_robot(path), tmp_path, "torque_offset@hip", torque=0.05)
    assert compiled.actuator_ctrlspec[0] != reference.actuator_ctrlspec[0]
    paths = []
    for one in (compiled, reference):
        d = mujoco.MjData(one)
        d.ctrl[:] = 0.3
        mujoco.mj_step(one, d, 200)
        paths.append(d.qpos.copy())
    np.testing.assert_allclose(paths[0], paths[1], atol=1e-5)
    assert np.abs(paths[0]).max() > 0.1 and compiled.actuator_biasprm[0, :3].tolist() == [0.05, -8.0, -0.3]


# ---------------------------------------------------------------------------------------------------------------------- fallbacks
JOINT_OF_CLASSES = '<worldbody><body name="foot" pos="0 0 0.2"><joint name="ankle"/><geom size="0.02"/></body></worldbody>'
REPEATED = """<mujoco><worldbody><replicate count="2" offset="0 0.2 0"><body name="finger"><joint name="bend" axis="0 1 0"/>
<geom size="0.02123456789" pos="0 0 -0.1"/></body></replicate></worldbody>
<actuator><motor name="m" joint="bend0"/></actuator></mujoco>"""
URDF = """<robot name="leg"><link name="base"><inertial><mass value="1"/>
<inertia ixx=".01" iyy=".01" izz=".01" ixy="0" ixz="0" iyz="0"/></inertial></link><link name="leg"><inertial><mass value="1"/>
<inertia ixx=".01" iyy=".01" izz=".01" ixy="0" ixz="0" iyz="0"/></inertial></link><joint name="hip" type="revolute">
<parent link="base"/><child link="leg"/><axis xyz="0 1 0"/>
<limit lower="-2" upper="2" effort="5" velocity="9"/></joint></robot>"""
INNER = '<body name="lower" pos="0 0 -0.3">'
IGNORED = (
    ARM.replace(INNER, INNER + '<geom type="box" size="0.02 0.03 0.01"/>')
    .replace('<body name="upper">', '<body name="upper"><geom size="0.05"/>')
    .replace("  <option", '  <compiler inertiafromgeom="true"/>\n  <option')
)
ANEW = {  # file -> (texts by file name, effect, its values, sentence)
    "leg.xml": (
        {
            "leg.xml": LEG.replace('file="classes.xml"', 'file="foot.xml"/><include file="classes.xml"'),
            "foot.xml": JOINT_OF_CLASSES,
        },
        "coulomb_friction@ankle",
        {"torque": 0.01},
        "<joint> ankle lies in the included file foot.xml",
    ),
    "hand.xml": ({"hand.xml": REPEATED}, "coulomb_friction@bend0", {"torque": 0.01}, "of hand.xml by <replicate>"),
    "leg.urdf": ({"leg.urdf": URDF}, "coulomb_friction@hip", {"torque": 0.01}, "leg.urdf is a URDF"),
    "arm.xml": (
        {"arm.xml": IGNORED.replace('mass="0.4"', 'euler="0 30 0" mass="0.4"')},
        "body_mass@lower",
        {"mass": 0.1},
        "the changed text of arm.xml to another body_inertia",
    ),
    "pid.xml": (
        {"pid.xml": ARM.replace(f"<motor {MOTOR}/>", '<pid name="elbow" joint="elbow" kp="5" input="pos"/>')},
        "servo_gain@elbow",
        {"gain": 0.25},
        "<pid> has no attribute of its own",
    ),
    "tail.xml": (
        {"tail.xml": ARM.replace('model="arm"', 'model="arm < leg"')},
        "rotor_inertia@elbow",
        {"inertia": 0.01},
        "tail.xml is not well-formed XML",
    ),
}


@pytest.mark.parametrize("name", ANEW)
def test_text_that_cannot_hold_the_change_is_written_anew(name, tmp_path):
    texts, effect, values, sentence = ANEW[name]
    write_leg(tmp_path)
    for file, text in texts.items():
        (tmp_path / file).write_text(f"<mujoco>{text}</mujoco>" if file == "foot.xml" else text)
    robot = read_robot(tmp_path / name)
    found = verdict_of(robot, "NAMED", named(effect, **values))
    told = apply_robot(tmp_path, found, None, False)
    assert f"MuJoCo wrote {told['path'].name} anew without comments and layout: " in told["reason"]
    assert sentence in told["reason"] and told["path"].read_text().startswith(f"<!-- {FIRST}")
    again, (m, _) = read_robot(told["path"]).model, with_effect(robot, effect, **values)
    for field in ("dof_frictionloss", "dof_armature", "body_mass", "body_inertia", "actuator_biasprm"):
        np.testing.assert_allclose(getattr(again, field), getattr(m, field), rtol=2e-5)


def test_mass_that_the_compiler_would_change_is_refused(tmp_path):
    """boundmass holds the mass of each body above a bound: no text has the effect."""
    path = tmp_path / "arm.xml"
    path.write_text(ARM.replace("<option", '<compiler boundmass="0.3"/><option'))
    with pytest.raises(ConfigError, match="does not take mass.* of body lower.*boundmass"):
        apply_robot(tmp_path, verdict_of(read_robot(path), "NAMED", named("body_mass@lower", mass=-0.2)), None, False)
    assert [x.name for x in tmp_path.iterdir()] == ["arm.xml"]


UNWRITTEN = {  # field that an effect of the user's own changes -> factor and message
    "jnt_range": (0.5, "an effect changes jnt_range of the model"),
    "geom_friction": (2.0, "an effect changes geom_friction"),
    "body_pos": (1.1, "an effect changes body_pos"),
}


@pytest.mark.parametrize("field", UNWRITTEN)
def test_field_that_is_not_written_is_refused_by_name(field, robots, folder):
    factor, says = UNWRITTEN[field]
    m, _ = with_effect(robots["leg"], "coulomb_friction@hip", torque=0.06)
    getattr(m, field)[:] *= factor
    mujoco.mj_setConst(m, mujoco.MjData(m))
    with pytest.raises(ConfigError, match=says):
        next_mjcf(robots["leg"], m, 0.0, folder / "lost.xml", "a comment")


def test_damping_of_a_free_joint_is_refused(tmp_path):
    path = tmp_path / "buoy.xml"
    shoulder = [line for line in ARM.splitlines(keepends=True) if 'name="shoulder"' in line]
    path.write_text(ARM.replace(shoulder[0], "<freejoint/>").replace(shoulder[1], ""))
    robot = read_robot(path)
    m, _ = with_effect(robot, "joint_stiffness@elbow", stiffness=0.3)
    m.dof_damping[0] = 0.4
    with pytest.raises(ConfigError, match="changes dof_damping of the model.*of hinges and slides"):
        next_mjcf(robot, m, 0.0, tmp_path / "next.xml", "a comment")


# ---------------------------------------------------------------------------------------------------------------------- compilers
UPPER, BALL = '<inertial pos="0 0 -0.2" mass="0.6" diaginertia="0.004 0.004 0.0005"/>', '<geom size="0.05" pos="0 0 -0.2"/>'
GEOMS = ARM.replace(UPPER, BALL).replace(LOWER, '<geom size="0.04" pos="0 0 -0.15"/>')
TURNED = '<inertial pos="0 0 -0.2" mass="0.6" euler="10 20 -30" diaginertia="0.004 0.0038 0.0005"/>'
COMPILERS = {  # attributes -> (effect, its values, added lines beside that of the body or actuator)
    'inertiafromgeom="true"': ("body_mass@lower", {"mass": 0.1}, ['<compiler inertiafromgeom="auto"/>']),
    'fusestatic="true"': ("body_mass@lower", {"mass": 0.1}, []),
    'eulerseq="XYZ"': ("payload@upper", {"mass": 0.1}, []),
    'settotalmass="3"': ("payload@lower", {"mass": 0.1}, ['<compiler settotalmass="3.1"/>']),
    'autolimits="false"': ("torque_saturation@elbow", {"limit": 0.4}, []),
    'angle="degree" balanceinertia="true" boundmass="0.01"': ("joint_stiffness@elbow", {"stiffness": 0.3}, []),
}


@pytest.mark.filterwarnings("ignore:compiler attribute 'settotalmass'")
@pytest.mark.parametrize("compiler", COMPILERS)
def test_compiler_of_the_file_is_heeded(compiler, tmp_path):
    name, values, lines = COMPILERS[compiler]
    text = GEOMS.replace("<option", f"<compiler {compiler}/>\n  <option")
    if "fuse" in compiler:
        text = text.replace("<worldbody>", '<worldbody><body name="post"><geom size="0.1"/></body>')
    if "euler" in compiler:
        text = text.replace(BALL, TURNED)
    if "limits" in compiler:
        text = text.replace("ctrlrange", 'ctrllimited="true" ctrlrange')
    path = tmp_path / "arm.xml"
    path.write_text(text)
    robot = read_robot(path)
    made, compiled, _ = written_next(robot, tmp_path, name, **values)
    assert "these attributes changed" in made.how
    own, after = text.splitlines(), made.data.decode().splitlines()
    added = [line.strip() for line in after if line not in own and "a comment" not in line]
    assert len(added) == len(lines) + 1 and set(lines) <= set(added)
    m, _ = with_effect(robot, name, **values)
    for field in ("body_mass", "body_inertia", "body_ipos", "jnt_stiffness", "actuator_forcerange", "actuator_forcelimited"):
        np.testing.assert_allclose(getattr(compiled, field), getattr(m, field), rtol=2e-5, atol=1e-12)


def test_inertias_that_a_compiler_ignored_get_their_values(tmp_path):
    """Once one inertia of a file counts, all do: they become those of the geoms, which counted before."""
    path = tmp_path / "arm.xml"
    path.write_text(IGNORED)
    robot = read_robot(path)
    made, compiled, _ = written_next(robot, tmp_path, "body_mass@lower", mass=0.1)
    m, _ = with_effect(robot, "body_mass@lower", mass=0.1)
    assert "these attributes changed" in made.how and made.data.count(b"<inertial") == 2
    np.testing.assert_allclose(compiled.body_mass, m.body_mass, rtol=2e-5)
    np.testing.assert_allclose(compiled.body_inertia, m.body_inertia, rtol=2e-5)


# ------------------------------------------------------------------------------------------------------------------ other folders
CUBE = "".join(f"v {x} {y} {z}\n" for x in (0, 1) for y in (0, 1) for z in (0, 1)) + "".join(
    f"f {a} {b} {c}\n" for a, b, c in ((1, 3, 4), (1, 4, 2), (5, 6, 8), (5, 8, 7), (1, 2, 6), (1, 6, 5), (3, 7, 8), (3, 8, 4))
)
CUBE += "f 1 5 7\nf 1 7 3\nf 2 4 8\nf 2 8 6\n"


@pytest.mark.parametrize("kind", ["assetdir", "meshdir", "none", "replicate"])
def test_version_in_another_folder_finds_its_files(kind, tmp_path):
    home, away = tmp_path / "robot & co", tmp_path / "reports" / "one"
    files = home if kind == "none" else home / "assets"
    files.mkdir(parents=True)
    away.mkdir(parents=True)
    (files / "cube.obj").write_text(CUBE)
    (home / "classes.xml").write_text("<mujocoinclude><default><joint damping='0.1'/></default></mujocoinclude>")
    compiler = "" if kind == "none" else f'<compiler {kind if "dir" in kind else "meshdir"}="assets"/>'
    parts = f'<include file="classes.xml"/>{compiler}<asset><mesh name="cube" file="cube.obj" scale=".1 .1 .1"/></asset>'
    text = ARM.replace("<option", parts + "\n  <option").replace(LOWER, LOWER + '<geom type="mesh" mesh="cube"/>')
    if kind == "replicate":  # which MuJoCo writes anew
        repeated = '<replicate count="1" offset="1 0 0"><body name="post"><geom size=".1"/></body></replicate></worldbody>'
        text = text.replace("</worldbody>", repeated)
    path = home / "arm.xml"
    path.write_text(text)
    told = apply_robot(away, verdict_of(read_robot(path), "NAMED", named("body_mass@lower", mass=0.1)), None, False)
    assert told["path"] == away / "arm.v2.xml" and ("anew" in told["reason"]) == (kind == "replicate")
    again = mujoco.MjModel.from_xml_path(str(told["path"]))
    assert again.nmesh == 1 and again.body("lower").mass[0] == pytest.approx(0.5) and again.dof_damping.tolist() == [0.06, 0.02]
    assert list(away.iterdir()) == [told["path"]]


@pytest.mark.parametrize(
    ("option", "line"),
    [("included", '  <option gravity="0.2995 0 -2.98501"/>'), ("absent", '  <option gravity="0.979366 0 -9.76099"/>')],
)
def test_option_that_the_file_has_not_is_added(option, line, tmp_path):
    """A later section wins in MuJoCo, so that of the included file stays."""
    path, own = tmp_path / "arm.xml", '  <option timestep="0.002" integrator="implicitfast"/>\n'
    lighter = own.replace("/>", ' gravity="0 0 -3"/>')
    (tmp_path / "options.xml").write_text(f"<mujoco>{lighter}</mujoco>")
    path.write_text(ARM.replace(own, '  <include file="options.xml"/> <!-- g -->\n' if option == "included" else ""))
    robot = read_robot(path)
    m, _ = with_effect(robot, "base_tilt", pitch=0.1, roll=0.0)
    made, compiled, _ = written_next(robot, tmp_path, "base_tilt", pitch=0.1, roll=0.0)
    new = [text for text in made.data.decode().splitlines() if text not in path.read_text().splitlines()]
    assert new == ["<!-- a comment -->", line]
    np.testing.assert_allclose(compiled.opt.gravity, m.opt.gravity, rtol=1e-5)
    assert compiled.opt.timestep == robot.model.opt.timestep


# ---------------------------------------------------------------------------------------------------------------------- the text
@pytest.mark.parametrize("newline", ["\n", "\r\n"])
@pytest.mark.parametrize("mark", ["", "\ufeff"])
def test_bytes_of_the_author_stay(newline, mark, tmp_path):
    """Line ends, the mark of UTF-8, and a comment over the first lines."""
    path = tmp_path / "leg.xml"
    write_leg(tmp_path).write_bytes((mark + LEG).replace("\n", newline).encode())
    text = MjcfText(path)
    assert text.written() == path.read_bytes()
    text.joints[0].set("damping", [0.07, 0.01])
    text.actuators[0].set("kp", "7 < 8")
    before, after = path.read_bytes(), text.written()
    joint = b"range='-60 60'"
    assert after == before.replace(joint, joint + b' damping="0.07 0.01"').replace(b'kp="20"', b'kp="7 &lt; 8"')
    first = with_comment(after, "one -- two")
    assert first == after.replace(b'"1.0"?>', b'"1.0"?><!-- one - - two -->')
    path.write_bytes(first.replace(b"7 &lt; 8", b"7"))
    assert mujoco.MjModel.from_xml_path(str(path)).actuator_gainprm[0, 0] == 7.0


def test_diff_of_a_file_with_other_line_ends_is_short(tmp_path):
    path = tmp_path / "arm.xml"
    path.write_bytes(ARM.strip().replace("\n", "\r\n").encode())
    robot = read_robot(path)
    made = next_mjcf(robot, *with_effect(robot, "coulomb_friction@elbow", torque=0.06), tmp_path / "next.xml", "a comment")
    assert made.diff.count("\n+") == 3 and made.data.count(b"\r\n") == path.read_bytes().count(b"\r\n") + 1


def test_comment_stands_before_the_first_element():
    assert with_comment(b"<mujoco/>", "a") == b"<!-- a -->\n<mujoco/>"
    assert with_comment(b'<?xml version="1.0"?>\r\n<mujoco/>', "a\nb") == b'<?xml version="1.0"?>\r\n<!-- a\r\nb -->\r\n<mujoco/>'


def test_comparison_sees_each_field(robots):
    m, other = (robots["leg"].spec.copy().compile() for _ in range(2))
    assert differing(m, other) == ""
    for field in ("dof_damping", "body_inertia", "jnt_range", "actuator_gear"):
        other = robots["leg"].spec.copy().compile()
        getattr(other, field)[-1] += 1e-3
        assert differing(m, other) == field
    other.opt.timestep *= 1.1
    assert differing(robots["leg"].spec.copy().compile(), other) in ("actuator_gear", "opt.timestep")
