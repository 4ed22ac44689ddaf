"""README, CONTRIBUTING and the tutorials: their code runs, their rooms and links are there, their lines are short."""

import re
import tomllib
from pathlib import Path

import pytest

from fishmj.mjcf import geometry_of, load_robot
from fishmj.mjcf.new.swim_check import swim_of
from fishmj.sim import Sim

ROOT = Path(__file__).resolve().parent.parent
README = (ROOT / "README.md").read_text(encoding="utf-8")
PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").glob("*/tutorial.md"))]
LINE, CELL = 160, 120  # characters


def block(language: str) -> str:
    """The only fenced block of a language in the README."""
    (found,) = re.findall(rf"^```{language}\n(.*?)^```", README, re.M | re.S)
    return found


def test_the_six_lines_of_python_run():
    lines = [line for line in block("python").splitlines() if line]
    assert len(lines) <= 7
    scope: dict = {}
    exec(compile("\n".join(lines), "README.md", "exec"), scope)  # noqa: S102  our own text
    assert scope["step"].last()


def test_the_ten_lines_of_a_description_make_a_fish_that_floats_and_swims(tmp_path):
    text = block("toml")
    assert len(text.splitlines()) <= 10
    (tmp_path / "minnow.toml").write_text(text, encoding="utf-8")
    robot = load_robot(tmp_path / "minnow.toml")
    assert not [note for note in robot.notes if "not given" not in note]
    g = geometry_of(robot)
    assert abs(sum(g.displaced) - robot.mass) < 1e-9
    assert swim_of(Sim(robot)).speed > 0.1


@pytest.mark.parametrize(
    "page", [*PAGES[:2], *sorted((ROOT / "docs").rglob("*.md"))], ids=lambda page: str(page.relative_to(ROOT))
)
def test_what_a_page_links_to_is_there(page):
    links = re.findall(r"\]\(([^)#\s]+)(#?)[^)]*\)", page.read_text(encoding="utf-8"))
    here = {link: bool(anchor) for link, anchor in links if "://" not in link}
    gone = [link for link in here if not (page.parent / link).exists()]
    assert not gone, gone
    if "docs" in page.parts[len(ROOT.parts) :]:  # the site holds no page from outside of docs/, so no heading of one
        outside = [
            link for link, anchor in here.items() if anchor and ROOT / "docs" not in (page.parent / link).resolve().parents
        ]
        assert not outside, outside


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_lines_and_cells_are_short(page):
    for number, line in enumerate(page.read_text(encoding="utf-8").splitlines(), 1):
        assert len(line) <= LINE, f"{page.name}:{number}"
        if line.startswith("|"):
            assert max(map(len, line.split("|"))) <= CELL, f"{page.name}:{number}"


def test_the_recipes_name_files_that_are_there():
    text = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")
    named = {name for name in re.findall(r"(?:fishmj|tests|docs|data)/[\w./]+\.(?:py|toml|md)", text) if "NAME" not in name}
    assert len(named) > 25
    assert [name for name in sorted(named) if not (ROOT / name).is_file() and "test_x" not in name] == []
    recipes = re.split(r"^## ", text.partition("## An effect")[2], flags=re.M)
    assert len(recipes) == 6
    assert max(sum(bool(line.strip()) for line in recipe.splitlines()[1:]) for recipe in recipes) <= 15


def test_the_moving_picture_is_small_and_of_the_policy_that_it_names():
    picture = ROOT / "docs" / "figures" / "station.webp"
    assert picture.stat().st_size <= 1.5e6 and f"({picture.relative_to(ROOT)})" in README
    data = picture.read_bytes()
    assert data[:4] == b"RIFF" and data[8:12] == b"WEBP" and data.count(b"ANMF") > 50


def test_the_extras_of_the_readme_are_those_of_the_package():
    (said,) = re.findall(r"^Extras: (.*?)\. ", README, re.M | re.S)
    extras = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]["optional-dependencies"]
    assert set(re.findall(r"`(\w+)`", said)) == set(extras) - {"all"}
