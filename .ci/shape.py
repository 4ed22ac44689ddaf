"""Size and shape of the package in figures, and its budget.

python .ci/shape.py [FOLDER]    figures of a checkout as JSON
python .ci/shape.py --check     fails if a figure is above `.ci/budget.toml`; writes smaller figures back
python .ci/shape.py --raise WHY     raises the budget to the present figures, with the reason

tokens      of fishmj/: names, operators, numbers and strings; by room, and by door with all that it can import
branches    a function has one, plus one for each condition, loop, handler, and further term of a condition
lines       of fishmj/, blank lines and docstrings included
entries     of `ls fishmj`
floors      longest chain of imports inside the package; a circle is one floor
doubled     names of files, and of public classes, that occur more than once
docstrings  that begin with a relative word (`RELATIVE`); public functions and classes without one
words       of README, CONTRIBUTING and docs/
"""

import argparse
import ast
import io
import json
import statistics
import subprocess
import tokenize
import tomllib
from collections import Counter
from collections.abc import Iterable
from pathlib import Path

TOKENS = (tokenize.NAME, tokenize.OP, tokenize.NUMBER, tokenize.STRING)
DOORS = {  # name -> module that a user imports or runs
    "suite.load": "fishmj.suite",
    "sim.Sim": "fishmj.sim",
    "train": "fishmj.train.__main__",
    "evaluate": "fishmj.evaluate.__main__",
    "gap": "fishmj.gap.__main__",
    "deploy": "fishmj.deploy.__main__",
    "lbm_oracle.Scene": "fishmj.lbm_oracle.scene",
    "log": "fishmj.log.__main__",
}
PARTS = ("data", "docs", "firmware", "studies")  # folders with pages, beside those of the root
LONG, BRANCHED = 80, 25  # lines and branches of a function; longer and more branched ones are counted
BUDGET = Path(".ci") / "budget.toml"
HEAD = """# Limits of `python .ci/shape.py --check`. A figure above its limit fails; a smaller one is written back.
# To raise limits: python .ci/shape.py --raise "reason". A limit above its lowest earlier value needs an entry [[raised]].
"""
RELATIVE = ("What", "Of", "Whether", "Where", "How", "As")  # first words of a docstring that make a riddle of it


def modules(root: Path) -> dict[str, ast.Module]:
    """Dotted name -> syntax tree, of every module of the package."""
    found = {}
    for path in sorted((root / "fishmj").rglob("*.py")):
        parts = path.relative_to(root).with_suffix("").parts
        found[".".join(parts[:-1] if parts[-1] == "__init__" else parts)] = ast.parse(path.read_text(encoding="utf-8"))
    return found


def path_of(root: Path, module: str) -> Path:
    """File of a module."""
    path = root.joinpath(*module.split("."))
    return path / "__init__.py" if path.is_dir() else path.with_suffix(".py")


def riddles(tree: ast.AST) -> list[str]:
    """First lines of docstrings that begin with a word of `RELATIVE`."""
    told = [
        text.strip().partition("\n")[0]
        for node in ast.walk(tree)
        if isinstance(node, ast.Module | ast.FunctionDef | ast.ClassDef) and (text := ast.get_docstring(node))
    ]
    return [line for line in told if line.split()[0].rstrip(",:") in RELATIVE]


def undocumented(body: list[ast.stmt]) -> list[str]:
    """Public functions and classes without a docstring, methods included."""
    found = []
    for node in body:
        if isinstance(node, ast.FunctionDef | ast.ClassDef) and not node.name.startswith("_"):
            found += [] if ast.get_docstring(node) else [node.name]
            found += undocumented(node.body) if isinstance(node, ast.ClassDef) else []
    return found


def outside_functions(node: ast.AST) -> Iterable[ast.AST]:
    """Nodes that run when a module is imported."""
    for child in ast.iter_child_nodes(node):
        if not isinstance(child, ast.FunctionDef | ast.AsyncFunctionDef | ast.Lambda):
            yield child
            yield from outside_functions(child)


def named_modules(name: str, nodes: Iterable[ast.AST], known: set[str], strings: bool = False) -> set[str]:
    """Modules of the package that import statements among the nodes name. strings: those that a string names, too."""
    found = set()
    for node in nodes:
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module:
            parts = {f"{node.module}.{alias.name}" for alias in node.names}
            found |= {part if part in known else node.module for part in parts}
        elif strings and isinstance(node, ast.Constant) and isinstance(node.value, str):
            found.add(node.value.partition(":")[0])
    return (found & known) - {name}


def components(graph: dict[str, set[str]]) -> list[list[str]]:
    """Strongly connected components, importers last (Tarjan)."""
    index: dict[str, int] = {}
    low: dict[str, int] = {}
    stack: list[str] = []
    done: list[list[str]] = []

    def visit(name: str) -> None:
        index[name] = low[name] = len(index)
        stack.append(name)
        for there in sorted(graph[name]):
            if there not in index:
                visit(there)
                low[name] = min(low[name], low[there])
            elif there in stack:
                low[name] = min(low[name], index[there])
        if low[name] == index[name]:
            at = stack.index(name)
            done.append(stack[at:])
            del stack[at:]

    for name in graph:
        if name not in index:
            visit(name)
    return done


def floors(graph: dict[str, set[str]]) -> dict[str, int]:
    """Floor of each module: 1 imports nothing of the package."""
    floor: dict[str, int] = {}
    for group in components(graph):
        below = [floor[there] for name in group for there in graph[name] if there not in group]
        floor |= dict.fromkeys(group, 1 + max(below, default=0))
    return floor


def closure(start: str, graph: dict[str, set[str]]) -> set[str]:
    """All modules that can be reached from one, itself included."""
    seen: set[str] = set()
    ahead = {start} & set(graph)
    while ahead:
        seen |= ahead
        ahead = set().union(*(graph[name] for name in ahead)) - seen
    return seen


def token_count(text: str) -> int:
    """Names, operators, numbers and strings of a source."""
    return sum(token.type in TOKENS for token in tokenize.generate_tokens(io.StringIO(text).readline))


def branches(function: ast.AST) -> int:
    """McCabe's number of a function, nested ones included: 1 + conditions, loops, handlers, and further terms of conditions."""
    single = (ast.If, ast.IfExp, ast.For, ast.While, ast.comprehension, ast.ExceptHandler, ast.match_case)
    nodes = list(ast.walk(function))
    return 1 + sum(isinstance(n, single) for n in nodes) + sum(len(n.values) - 1 for n in nodes if isinstance(n, ast.BoolOp))


def option_count(nodes: Iterable[ast.AST]) -> int:
    """Options of the command line that a module declares."""
    calls = [node for node in nodes if isinstance(node, ast.Call)]
    first = [call.args[0].value for call in calls if call.args and isinstance(call.args[0], ast.Constant)]
    settings = sum(isinstance(call.func, ast.Name) and call.func.id == "setting" for call in calls)
    return settings + sum(isinstance(text, str) and text.startswith("--") for text in first)


def words(paths: Iterable[Path]) -> int:
    """Words of text files."""
    return sum(len(path.read_text(encoding="utf-8").split()) for path in paths)


def defined(node: ast.stmt) -> list[str]:
    """Names that a statement at the top of a module defines."""
    if isinstance(node, ast.FunctionDef | ast.ClassDef):
        return [node.name]
    targets = node.targets if isinstance(node, ast.Assign) else [node.target] if isinstance(node, ast.AnnAssign) else []
    return [target.id for target in targets if isinstance(target, ast.Name)]


def shape(root: Path) -> dict:
    """The figures of a checkout."""
    trees = modules(root)
    nodes = {name: list(ast.walk(tree)) for name, tree in trees.items()}
    graph = {name: named_modules(name, outside_functions(tree), set(trees)) for name, tree in trees.items()}
    functions = [
        ((f.end_lineno or 0) - f.lineno + 1, branches(f), f"{name}:{f.name}")
        for name in trees
        for f in nodes[name]
        if isinstance(f, ast.FunctionDef | ast.AsyncFunctionDef)
    ]
    sources = {name: path_of(root, name).read_text(encoding="utf-8") for name in trees}
    tokens = {name: token_count(text) for name, text in sources.items()}
    lines = {name: len(text.splitlines()) for name, text in sources.items()}
    room = {name: path_of(root, name).relative_to(root / "fishmj").parts[0] for name in trees}
    graph_of_doors = {name: named_modules(name, nodes[name], set(trees), strings=True) for name in trees}
    behind = {door: closure(start, graph_of_doors) for door, start in DOORS.items()}
    classes = [c.name for name in trees for c in nodes[name] if isinstance(c, ast.ClassDef)]
    public = [name for tree in trees.values() for node in tree.body for name in defined(node) if not name.startswith("_")]
    files = list((root / "fishmj").rglob("*.py"))
    stems = Counter(path.stem for path in files if not path.stem.startswith("__"))
    rooms = sorted(path.name for path in (root / "fishmj").iterdir() if (path / "__init__.py").exists())
    room_count = Counter((path.relative_to(root).parts[1], path.stem) for path in files if not path.stem.startswith("__"))
    pages = [*(root / "docs").rglob("*.md"), root / "README.md", root / "CONTRIBUTING.md"]
    floor = floors(graph)
    return {
        "tokens": sum(tokens.values()),
        "tokens_by_room": {place: sum(tokens[m] for m in trees if room[m] == place) for place in rooms},
        "tokens_by_door": {door: sum(tokens[m] for m in members) for door, members in behind.items()},
        "lines_by_door": {door: sum(lines[m] for m in members) for door, members in behind.items()},
        "files_by_door": {door: len(members) for door, members in behind.items()},
        "lines": sum(lines.values()),
        "entries": len([path for path in (root / "fishmj").iterdir() if path.name != "__pycache__"]),
        "options": sum(map(option_count, nodes.values())),
        "words": words(pages),
        "words_of_all_md": words([*root.glob("*.md"), *(p for part in PARTS for p in (root / part).rglob("*.md"))]),
        "docstrings_relative": sum(len(riddles(tree)) for tree in trees.values()),
        "public_without_docstring": sum(len(undocumented(tree.body)) for tree in trees.values()),
        "files": len(files),
        "classes": len(classes),
        "public_names": len(public),
        "function_median": statistics.median(length for length, _, _ in functions),
        "function_longest": max(functions),
        "functions_over_80_lines": sum(length > LONG for length, _, _ in functions),
        "functions_over_25_branches": sum(count > BRANCHED for _, count, _ in functions),
        "floors": max(floor.values()),
        "floors_by_room": {room: len({floor[m] for m in trees if m.split(".")[1:2] == [room]}) for room in rooms},
        "circles": [sorted(group) for group in components(graph) if len(group) > 1],
        "doubled_files": {stem: count for stem, count in sorted(stems.items()) if count > 1},
        "doubled_files_in_one_room": {f"{room}/{stem}": n for (room, stem), n in sorted(room_count.items()) if n > 1},
        "doubled_classes": {name: n for name, n in sorted(Counter(classes).items()) if n > 1 and not name.startswith("_")},
    }


def budgeted(figures: dict) -> dict[str, int]:
    """The figures that have a limit, by their names in `.ci/budget.toml`."""
    plain = ("tokens", "functions_over_80_lines", "functions_over_25_branches", "options", "words", "words_of_all_md")
    by_place = {f"{key}.{place}": n for key in ("tokens_by_room", "tokens_by_door") for place, n in figures[key].items()}
    return {name: figures[name] for name in plain} | by_place


def read(text: str) -> tuple[dict[str, int], list[dict]]:
    """(limits, entries [[raised]]) of a budget file."""
    table = tomllib.loads(text)
    return table.get("limits", {}), table.get("raised", [])


def lowest(root: Path) -> dict[str, int]:
    """Smallest limit of each figure in the history of the budget file; empty without git."""

    def git(*words: str) -> str:
        return subprocess.run(["git", "-C", str(root), *words], capture_output=True, text=True, check=False).stdout

    past: dict[str, int] = {}
    for commit in git("log", "--format=%H", "--", BUDGET.as_posix()).split():
        for name, limit in read(git("show", f"{commit}:{BUDGET.as_posix()}"))[0].items():
            past[name] = min(limit, past.get(name, limit))
    return past


def write(root: Path, limits: dict[str, int], raised: list[dict]) -> None:
    """Writes the budget file. An entry [[raised]] keeps only figures whose limit is above its lowest earlier value."""
    past = lowest(root)
    rows = [HEAD, "[limits]", *(f"{json.dumps(name)} = {limit}" for name, limit in limits.items())]
    for entry in raised:
        still = [name for name in entry["figures"] if limits.get(name, 0) > past.get(name, 0)]
        rows += ["", "[[raised]]", f"why = {json.dumps(entry['why'])}", f"figures = {json.dumps(still)}"] if still else []
    (root / BUDGET).write_text("\n".join(rows) + "\n", encoding="utf-8")


def faults(figures: dict[str, int], limits: dict[str, int], raised: list[dict], past: dict[str, int]) -> list[str]:
    """One line for each figure above its limit, and for each limit that rose without an entry [[raised]]."""
    explained = {name for entry in raised if entry["why"].strip() for name in entry["figures"]}
    above = [f"{name}: {n}, limit {limits[name]}" for name, n in figures.items() if n > limits.get(name, n)]
    risen = [
        f"{n}: limit {limits[n]}, was {past[n]}" for n in limits if n not in explained and limits[n] > past.get(n, limits[n])
    ]
    return [f"{line}; make something else smaller, or give a reason with --raise" for line in above + risen]


def main() -> int:
    """Prints the figures, or compares them with the budget; returns the exit code."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", nargs="?", default=".", type=Path)
    parser.add_argument("--check", action="store_true")
    parser.add_argument("--raise", dest="why", default="", metavar="WHY")
    args = parser.parse_args()
    root = args.folder.resolve()
    figures = shape(root)
    if not args.check and not args.why:
        print(json.dumps(figures, indent=1))
        return 0
    new = budgeted(figures)
    limits, raised = read((root / BUDGET).read_text(encoding="utf-8")) if (root / BUDGET).is_file() else ({}, [])
    if args.why:
        past = lowest(root)
        grown = [name for name, n in new.items() if n > min(limits.get(name, n), past.get(name, n))]
        write(root, new, [*raised, {"why": args.why, "figures": grown}])
        return 0
    wrong = faults(new, limits, raised, lowest(root))
    print("\n".join(wrong) or "budget: no figure is above its limit")
    if not wrong and new != limits:
        write(root, new, raised)
    return bool(wrong)


if __name__ == "__main__":
    raise SystemExit(main())
