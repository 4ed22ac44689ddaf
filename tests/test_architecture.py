"""The house rules that a reader can rely on: import order, small files, a light `import fishmj`, no unsafe loading."""

import ast
import re
import subprocess
import sys
from functools import cache
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
PACKAGE = ROOT / "fishmj"
SOURCES = sorted(PACKAGE.rglob("*.py"))
CODE = [path for folder in ("fishmj", "tests", "examples") for path in sorted((ROOT / folder).rglob("*.py"))]

LIMIT = 500  # lines; one story stays in one file, and is split by story, never by length
LONGER: dict[str, str] = {}  # file -> why it may be longer
SIBLINGS = {frozenset((room, "lbm_oracle")) for room in ("dynamics", "water", "hydro_fit")}  # of a level, never import each other
FORBIDDEN = {"utils", "util", "common", "core", "manager", "managers", "helpers", "misc"}
UNSAFE_MODULES = {"pickle", "cPickle", "dill", "cloudpickle", "joblib", "marshal", "shelve"}


def levels() -> dict[str, int]:
    """Room -> level, read from the table in docs/decisions/architecture.md."""
    text = (ROOT / "docs" / "decisions" / "architecture.md").read_text(encoding="utf-8")
    rows = re.findall(r"^\| L(\d) \| ([^|]*) \|", text, flags=re.MULTILINE)
    return {room.rstrip("/"): int(level) for level, rooms in rows for room in re.findall(r"`([\w/]+)`", rooms)}


LEVELS = levels()


def room(path: Path) -> str:
    """`fishmj/log/trial.py` -> `log`; `fishmj/calib.py` -> `calib`; the package's own `__init__` -> ``.

    A `__main__.py` is command line, whatever folder it lies in: nothing imports it, so it may tie rooms together.
    """
    if path.name == "__main__.py":
        return "__main__"
    first = path.relative_to(PACKAGE).parts[0].removesuffix(".py")
    return "" if first == "__init__" else first


def statements(tree: ast.AST):
    """Every statement, inside functions too; expressions are most of a tree and import nothing."""
    for field in ("body", "orelse", "handlers", "finalbody", "cases"):
        for node in getattr(tree, field, ()):
            yield node
            yield from statements(node)


@cache
def imported_rooms(path: Path, text: str | None) -> list[tuple[str, int]]:
    """(room, line) of every import of fishmj in a file, at the top or inside a function."""
    tree = ast.parse(path.read_text(encoding="utf-8") if text is None else text)
    parts = path.relative_to(ROOT).parts
    found = []
    for node in statements(tree):
        if isinstance(node, ast.Import):
            found += [(alias.name, node.lineno) for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            base = ".".join(parts[: len(parts) - node.level]) if node.level else ""
            name = ".".join(x for x in (base, node.module or "") if x)
            deep = name == "fishmj"  # `from fishmj import log` imports the room log
            found += [(f"{name}.{alias.name}" if deep else name, node.lineno) for alias in node.names]
    return [(name.split(".")[1], line) for name, line in found if name.startswith("fishmj.")]


def wrong_way(path: Path, text: str | None = None) -> list[str]:
    """Imports that go up the table, or across to a sibling."""
    here = room(path)
    level = LEVELS.get(here, 0)  # the package's own `__init__` may import from L0
    return [
        f"{path.relative_to(ROOT)}:{line}: {here or 'fishmj'} (L{level}) imports {there} (L{LEVELS[there]})"
        for there, line in imported_rooms(path, text)
        if there in LEVELS and there != here and (LEVELS[there] > level or frozenset((here, there)) in SIBLINGS)
    ]


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


def test_every_room_has_a_level():
    rooms = {room(path) for path in SOURCES} - {""}
    assert rooms <= set(LEVELS), f"add {sorted(rooms - set(LEVELS))} to the table in docs/decisions/architecture.md"


def test_imports_go_down_the_table():
    wrong = [fault for path in SOURCES for fault in wrong_way(path)]
    assert not wrong, "\n".join(wrong)


def test_an_import_that_goes_up_is_found():
    """The rule itself is awake: each spelling of a wrong import is caught."""
    flow, water = PACKAGE / "flow.py", PACKAGE / "dynamics" / "strip_forces.py"
    for text in ("from fishmj import tasks", "import fishmj.tasks.env", "def f():\n    from fishmj.tasks import env"):
        assert wrong_way(flow, text), text
    assert wrong_way(water, "from fishmj.lbm_oracle import guard")
    assert wrong_way(water, "from ..tasks import env")
    assert not wrong_way(water, "from fishmj.flow import Flow\nfrom . import hooks")
    assert not wrong_way(water.with_name("__main__.py"), "from fishmj.campaign import command")
    assert wrong_way(water, "from fishmj.campaign import command")


def test_nothing_imports_the_studies():
    """Commands name them, as text; evidence is never part of what it judges."""
    inside = {path for path in SOURCES if room(path) == "studies" or path.name == "__main__.py"}
    assert [
        path for path in SOURCES if path not in inside and "studies" in {there for there, _ in imported_rooms(path, None)}
    ] == []


def test_rooms_of_one_level_do_not_import_in_circles():
    edges = {(room(p), there) for p in SOURCES for there, _ in imported_rooms(p, None) if there in LEVELS and there != room(p)}
    after: dict[str, set[str]] = {}
    for here, there in edges:
        if LEVELS.get(here) == LEVELS[there]:
            after.setdefault(here, set()).add(there)

    def reach(start: str) -> set[str]:
        seen: set[str] = set()
        todo = list(after.get(start, ()))
        while todo:
            name = todo.pop()
            if name not in seen:
                seen.add(name)
                todo += after.get(name, ())
        return seen

    assert [name for name in after if name in reach(name)] == []


def gap_levels() -> dict[str, int]:
    """Room of `gap/` -> level, read from the docstring of its `__init__`."""
    text = ast.get_docstring(ast.parse((PACKAGE / "gap" / "__init__.py").read_text(encoding="utf-8"))) or ""
    rows = re.findall(r"^ +(\d) +((?:\w+, )*\w+)  ", text, flags=re.MULTILINE)
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


def test_files_are_small():
    lines = {str(path.relative_to(ROOT)): len(path.read_text(encoding="utf-8").splitlines()) for path in CODE}
    long = [f"{name}: {count} lines" for name, count in lines.items() if count > LIMIT and not LONGER.get(name)]
    assert not long, "\n".join([f"limit {LIMIT}: split them, or list them with the reason", *long])


def test_listed_long_files_still_are_long():
    for name in LONGER:
        assert len((ROOT / name).read_text(encoding="utf-8").splitlines()) > LIMIT, f"{name} is small now: take it off the list"


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
    code = "import sys; sys.modules['numba'] = None; import fishmj.studies.gap_benchmark.command, fishmj.generators.detectability"
    subprocess.run([sys.executable, "-c", code], check=True, cwd=ROOT)
