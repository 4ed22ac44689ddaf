"""The house rules that a reader can rely on: import order, a light `import fishmj`, no unsafe loading."""

import ast
import re
import subprocess
import sys
from collections import defaultdict
from functools import cache
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
PACKAGE = ROOT / "fishmj"
SOURCES = sorted(PACKAGE.rglob("*.py"))
CODE = [path for folder in ("fishmj", "studies", "tests", "examples") for path in sorted((ROOT / folder).rglob("*.py"))]

TWICE = {"flow", "policy"}  # files of one name: what users import, `fishmj/flow.py`, re-exports the room's own, `water/flow.py`
FORBIDDEN = {"utils", "util", "common", "core", "manager", "managers", "helpers", "misc"}
UNSAFE_MODULES = {"pickle", "cPickle", "dill", "cloudpickle", "joblib", "marshal", "shelve"}
FILES = {"sim": "engines", "policy": "control", "flow": "water"}  # file beside the rooms -> the room above which it stands
TOP = {"__init__", "__main__", "cli"}  # may import anything
LABORATORY = PACKAGE / "gap" / "laboratory"
ROBOTS = tuple(f"gap.laboratory.{path.parent.name}" for path in sorted(LABORATORY.glob("*/__init__.py")))
INDEPENDENT = {  # folder or file -> what it must not import although it is lower
    "lbm_oracle": ("water", "but:water.flow"),
    "gap/laboratory/generators": ("water", "lbm_oracle", "engines", "sim", "hydro_fit", "gap.laboratory.virtual_robot"),
    "gap/laboratory/virtual_robot": (
        "effects",
        "water",
        "lbm_oracle",
        "engines",
        "sim",
        "hydro_fit",
        "gap.laboratory.generators",
    ),
    **dict.fromkeys(  # what all blind robots share knows none of them
        (f"gap/laboratory/{path.name}" for path in LABORATORY.glob("*.py")),
        ("effects", "water", "lbm_oracle", "engines", "sim", "hydro_fit", *ROBOTS),
    ),
    **dict.fromkeys((f"deploy/{part}" for part in ("loop", "link", "camera", "monitor", "commands")), ("deploy.loopback",)),
}


def listed_rooms() -> list[str]:
    """Rooms from low to high, as the README's tree lists them."""
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    (tree,) = re.findall(r"`ls fishmj` is the architecture.*?\n\n```\n(.*?)^```", text, flags=re.MULTILINE | re.DOTALL)
    return [line.split()[0] for line in tree.splitlines()]


ROOMS = listed_rooms()


def floor(module: str) -> float:
    """Height of `fishmj.room.x`; a file stands between its room and the next one."""
    first = module.split(".")[1] if "." in module else ""
    if first in FILES:
        return ROOMS.index(FILES[first]) + 0.5
    return ROOMS.index(first) if first in ROOMS else len(ROOMS)


def module_of(path: Path) -> str:
    parts = path.relative_to(ROOT).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


MODULES = {module_of(path) for path in SOURCES}


@cache
def imported(path: Path, text: str | None = None) -> list[tuple[str, int]]:
    """(module, line) of every import of fishmj or studies in a file, inside functions too, and of every string that names one."""
    found = []
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8") if text is None else text)):
        if isinstance(node, ast.Import):
            found += [(alias.name, node.lineno) for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            parts = path.relative_to(ROOT).parts
            base = ".".join(parts[: len(parts) - node.level]) if node.level else ""
            name = ".".join(x for x in (base, node.module or "") if x)
            found += [(f"{name}.{alias.name}", node.lineno) for alias in node.names]
        elif isinstance(node, ast.Constant) and isinstance(node.value, str) and re.match(r"fishmj(\.\w+)+(:\w+)?\Z", node.value):
            found += [(node.value.partition(":")[0], node.lineno)]
    return [(name, line) for name, line in found if name.split(".")[0] == "studies" or _is_ours(name)]


def _is_ours(name: str) -> bool:
    """A module of fishmj or a name in one; not `fishmj` itself, nor a string such as the `source` of an old trial."""
    parts, known = name.split("."), MODULES - {"fishmj"}
    return name in known or ".".join(parts[:-1]) in known


def wrong_way(path: Path, text: str | None = None) -> list[str]:
    """Imports of a room above, of the studies, or of what a folder must be independent of."""
    here = module_of(path)
    inside = path.relative_to(PACKAGE).as_posix()
    if path.name == "__main__.py" or inside.removesuffix(".py") in TOP:
        return []
    found = []
    for name, line in imported(path, text):
        if (path.name, name) == ("recorder.py", "fishmj.sim"):  # the `source` of a trial
            continue
        up = name.split(".")[0] == "studies" or floor(name) > floor(here)
        for folder, parts in INDEPENDENT.items():
            if f"{inside}/".startswith(f"{folder}/"):
                but = [f"fishmj.{part[4:]}" for part in parts if part.startswith("but:")]
                wanted = any(name.startswith(f"fishmj.{part}") for part in parts)
                up |= wanted and not any(name.startswith(part) for part in but)
        found += [f"{path.relative_to(ROOT)}:{line}: {here} imports {name}"] if up else []
    return found


def unsafe(text: str, name: str = "") -> list[str]:
    """What in a source could run code from a file that it opens."""
    found: list[str] = []
    if not any(word in text for word in (*UNSAFE_MODULES, "eval", "allow_pickle")):
        return found
    for node in ast.walk(ast.parse(text)):
        where = f"{name}:{getattr(node, 'lineno', 0)}"
        if isinstance(node, ast.Import | ast.ImportFrom):
            names = {alias.name.split(".")[0] for alias in node.names} | {(getattr(node, "module", "") or "").split(".")[0]}
            found += [f"{where} imports {module}" for module in sorted(names & UNSAFE_MODULES)]
        if isinstance(node, ast.Call):
            found += [f"{where} calls eval"] if isinstance(node.func, ast.Name) and node.func.id == "eval" else []
            loose = [key for key in node.keywords if key.arg == "allow_pickle" and getattr(key.value, "value", None) is not False]
            found += [f"{where} allows pickle"] if loose else []
    return found


def test_the_readme_lists_the_rooms():
    """`ls fishmj`: sixteen rooms and six files."""
    folders = {path.parent.name for path in PACKAGE.glob("*/*.py")}
    assert sorted(ROOMS) == sorted(folders) and len(ROOMS) == 16
    assert {path.stem for path in PACKAGE.glob("*.py")} == {*FILES, *TOP}


def test_imports_go_down():
    wrong = [fault for path in SOURCES for fault in wrong_way(path)]
    assert not wrong, "\n".join(wrong)


def test_an_upward_import_is_found():
    """Each spelling of a wrong import is caught."""
    flow, strips = PACKAGE / "water" / "flow.py", PACKAGE / "water" / "dynamics" / "strip_forces.py"
    for text in (
        "from fishmj import tasks",
        "import fishmj.tasks.env",
        "def f():\n    from fishmj.tasks import env",
        "import_module('fishmj.tasks.env')",
        "entry = 'fishmj.tasks.env:Options'",
        "import studies.tracker",
    ):
        assert wrong_way(flow, text), text
    assert wrong_way(strips, "from ...tasks import env") and wrong_way(strips, "from fishmj.hydro_fit import campaign")
    assert not wrong_way(strips, "from fishmj.water.flow import Flow\nfrom . import hooks")
    assert not wrong_way(strips.with_name("__main__.py"), "from fishmj.hydro_fit import campaign")
    solver, blind = PACKAGE / "lbm_oracle" / "x.py", PACKAGE / "gap" / "laboratory" / "generators" / "x.py"
    assert wrong_way(solver, "from fishmj.water import prior") and not wrong_way(solver, "from fishmj.water.flow import Flow")
    assert wrong_way(blind, "from fishmj.engines import make") and not wrong_way(blind, "from fishmj.mjcf import load_robot")
    assert wrong_way(LABORATORY / "session.py", "from fishmj.gap.laboratory.generators import mujoco_robot")
    assert wrong_way(LABORATORY / "instruments.py", "from fishmj.gap.laboratory import virtual_robot")
    assert wrong_way(PACKAGE / "deploy" / "loop" / "x.py", "from fishmj.deploy.loopback import loopback_server")


def gap_levels() -> dict[str, int]:
    """Room of `gap/` -> level, read from the docstring of its `__init__`."""
    text = ast.get_docstring(ast.parse((PACKAGE / "gap" / "__init__.py").read_text(encoding="utf-8"))) or ""
    rows = re.findall(r"^ +(\d+) +((?:\w+, )*\w+)  ?", text, flags=re.MULTILINE)
    return {name: int(level) for level, names in rows for name in names.split(", ")}


def gap_faults(path: Path, text: str | None = None) -> list[str]:
    """Imports of a file of `gap/` that do not go down the table of its rooms, those inside functions too."""
    here, known = path.relative_to(PACKAGE / "gap").parts[0].removesuffix(".py"), gap_levels()
    found = []
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8") if text is None else text)):
        modules = [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
        if isinstance(node, ast.ImportFrom) and node.module:
            modules = [f"{node.module}.{alias.name}" for alias in node.names]
        rooms = {name.split(".")[2] for name in modules if name.startswith("fishmj.gap.")} - {here}
        found += [
            f"{path.relative_to(ROOT)}:{node.lineno}: {here} imports {there}" for there in rooms if known[there] >= known[here]
        ]
    return found


def test_rooms_of_the_search_import_downwards():
    sources = [path for path in sorted((PACKAGE / "gap").rglob("*.py")) if path.name != "__main__.py"]
    rooms = {path.relative_to(PACKAGE / "gap").parts[0].removesuffix(".py") for path in sources} - {"__init__"}
    assert rooms == set(gap_levels()), "the table in fishmj/gap/__init__.py lists other rooms than there are"
    inside = [path for path in sources if path != PACKAGE / "gap" / "__init__.py"]
    assert not (wrong := [fault for path in inside for fault in gap_faults(path)]), "\n".join(wrong)
    decide = PACKAGE / "gap" / "decide" / "decide.py"
    assert gap_faults(decide, "def f():\n    from fishmj.gap.terms import stronger")  # the rule itself is awake
    assert gap_faults(decide, "from fishmj.gap import workflow") and not gap_faults(decide, "from fishmj.gap import wording")


def test_no_threshold_of_the_search_stands_in_code():
    """They are in data/calib/gap.toml, where a reader finds all of them."""

    def is_threshold(node: ast.expr) -> bool:
        values = node.elts if isinstance(node, ast.Tuple | ast.List) else [node]
        bare = [value.operand if isinstance(value, ast.UnaryOp) else value for value in values]
        return any(isinstance(value, ast.Constant) and isinstance(value.value, float) for value in bare)

    def constants(text: str) -> list[str]:
        found = []
        for node in ast.walk(ast.parse(text)):
            targets = node.targets if isinstance(node, ast.Assign) else [node.target] if isinstance(node, ast.AnnAssign) else []
            flat = [name for target in targets for name in getattr(target, "elts", [target])]
            if targets and node.value is not None and is_threshold(node.value):
                found += [name.id for name in flat if isinstance(name, ast.Name) and name.id.isupper()]
        return found

    files = [path for folder in ("search", "decide", "terms") for path in sorted((PACKAGE / "gap" / folder).glob("*.py"))]
    assert files and {f.name: c for f in files if (c := constants(f.read_text(encoding="utf-8")))} == {}
    assert constants("A = 0.5\nB, C = 6, -3.0\nD: float = 1e-3\nE = 3\nf = 0.1") == ["A", "B", "C", "D"]


def doubles(text: str) -> list[str]:
    """Names that a module gives a value twice: the second one takes the place of the first without a word."""
    found = defaultdict(int)
    for node in ast.parse(text).body:
        targets = node.targets if isinstance(node, ast.Assign) else [node.target] if isinstance(node, ast.AnnAssign) else []
        for target in targets:
            for name in target.elts if isinstance(target, ast.Tuple) else [target]:
                if isinstance(name, ast.Name) and name.id != "_":
                    found[name.id] += 1
    return [name for name, count in found.items() if count > 1]


def test_no_module_gives_a_name_two_values():
    assert doubles("A = 1\nB, C = 2, 3\nA: int = 4\n_ = 5\n_ = 6\nC |= 1") == ["A"]
    found = {str(path.relative_to(ROOT)): doubles(path.read_text(encoding="utf-8")) for path in CODE}
    assert {name: twice for name, twice in found.items() if twice} == {}


def doubled(places: list[tuple[str, str]]) -> dict[str, list[str]]:
    """Names that stand in more than one place."""
    found = defaultdict(list)
    for name, place in places:
        found[name].append(place)
    return {name: where for name, where in found.items() if len(where) > 1}


def test_every_file_has_its_own_name():
    files = doubled([(path.stem, str(path.relative_to(ROOT))) for path in SOURCES if not path.stem.startswith("__")])
    assert files.keys() == TWICE, "\n".join(["name each by its part in its room", *map(str, files.items())])


def test_every_class_has_its_own_name():
    places = [
        (node.name, f"{path.relative_to(ROOT)}:{node.lineno}")
        for path in SOURCES
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        if isinstance(node, ast.ClassDef)
    ]
    assert not (classes := doubled(places)), "\n".join(f"{name}: {', '.join(where)}" for name, where in classes.items())


def test_a_doubled_name_is_found():
    """The rule itself is awake."""
    assert doubled([("Swim", "a.py:1"), ("Plan", "b.py:1"), ("Swim", "b.py:9")]) == {"Swim": ["a.py:1", "b.py:9"]}


def test_no_room_is_called_utils():
    names = {part.removesuffix(".py") for path in SOURCES for part in path.relative_to(PACKAGE).parts}
    assert names & FORBIDDEN == set()


def test_nothing_can_run_code_from_a_file():
    wrong = [fault for path in SOURCES for fault in unsafe(path.read_text(encoding="utf-8"), str(path.relative_to(ROOT)))]
    assert not wrong, "\n".join(wrong)


def test_code_that_could_run_a_file_is_found():
    """The rule itself is awake."""
    for text in (
        "import pickle",
        "from joblib import load",
        "eval('1')",
        "np.load(f, allow_pickle=True)",
        "load(allow_pickle=x)",
    ):
        assert unsafe(text), text
    assert not unsafe("import json\nnp.load(f, allow_pickle=False)\nmodel.eval()")


COMMAND = re.compile(r"(fishmj [a-z_]+|python -m [\w.]+)( [^;:,`(]*)? $|with --[a-z-]+ $")  # of text before a value
PATH = re.compile(r"\bargs\.(data|fish|healthy|model|out|write_map)|path|folder|\bout\b|\bhome\b")  # of a value


def unquoted_paths(source: str) -> list[str]:
    """Values of f-strings that are paths, stand within a command to copy, and are not quoted for the shell."""
    found = []
    for node in ast.walk(ast.parse(source)):
        text = ""
        for value in node.values if isinstance(node, ast.JoinedStr) else ():
            if isinstance(value, ast.FormattedValue):
                said = ast.unparse(value.value)
                found += [said] if COMMAND.search(text) and PATH.search(said) and "shlex." not in said else []
            text += str(value.value) if isinstance(value, ast.Constant) else "X"
    return found


def test_commands_to_copy_quote_their_paths():
    modules = sorted((ROOT / "fishmj").rglob("*.py"))
    assert {path.name: found for path in modules if (found := unquoted_paths(path.read_text(encoding="utf-8")))} == {}


def test_an_unquoted_path_in_a_command_is_found():
    bad = """f"{path}: stale; make it again with fishmj gap check {path} --data {args.data or 'DATA'}" """
    assert unquoted_paths(bad) == ["path", "args.data or 'DATA'"]


def test_import_fishmj_loads_numpy_at_most():
    code = "import sys; before = set(sys.modules); import fishmj; print(*(set(sys.modules) - before))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, cwd=ROOT)
    loaded = {name.split(".")[0] for name in done.stdout.split()} - set(sys.stdlib_module_names)
    assert {name for name in loaded if not name.startswith("_")} <= {"fishmj", "numpy"}


def test_the_command_line_starts_without_the_heavy_packages():
    code = "import sys; from fishmj import cli; cli.usage(); print(*sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, cwd=ROOT)
    heavy = {"jax", "mujoco", "dm_control", "numba", "torch", "matplotlib", "cv2", "meshcat", "warp"}
    assert heavy.isdisjoint(done.stdout.split())


def test_the_blind_benchmark_of_kept_data_is_read_without_numba():
    code = (
        "import sys; sys.modules['numba'] = None; "
        "import fishmj.gap.bench.bench_command, fishmj.gap.laboratory.generators.detectability"
    )
    subprocess.run([sys.executable, "-c", code], check=True, cwd=ROOT)
