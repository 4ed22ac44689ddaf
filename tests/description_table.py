"""The table of keys in docs/simulate/your_own_fish.md, made from the models: `python tests/description_table.py` writes it."""

from pathlib import Path

from fishmj.mjcf import description_schema

PAGE = Path(__file__).resolve().parent.parent / "docs" / "simulate" / "your_own_fish.md"
BEGIN, END = "<!-- keys: begin -->\n", "<!-- keys: end -->\n"


def table() -> str:
    """Markdown: one row a key, in the order of the models."""
    rows = ["| key | expected | what it is |", "|---|---|---|"]
    rows += [row("", key) for key in listed("") if key not in description_schema.BLOCKS]
    for block, model in description_schema.BLOCKS.items():
        header = f"[[{block}]]" if block in description_schema.LISTS else f"[{block}]"
        many = f"{description_schema.said('', block)[2]}. " if block in description_schema.LISTS else ""
        rows.append(f"| **`{header}`** | | {many}{' '.join((model.__doc__ or '').split())} |")
        rows += [row(block, key) for key in listed(block) if block != "version"]  # nobody writes that block by hand
    return "\n".join(rows) + "\n"


def listed(block: str) -> list[str]:
    """Keys of a block without those in rad that have a twin in `_deg`: the page says once that both are accepted."""
    keys = description_schema.keys(block)
    return [key for key in keys if f"{key}_deg" not in keys]


def row(block: str, key: str) -> str:
    what, _, expected = description_schema.said(block, key)
    model = description_schema.BLOCKS[block] if block else description_schema.Description
    needed = next(info for name, info in model.model_fields.items() if key == (info.alias or name)).is_required()
    return f"| `{key}`{' *' if needed else ''} | {expected} | {what} |"


def written() -> str:
    """What stands on the page."""
    text = PAGE.read_text(encoding="utf-8")
    return text[text.index(BEGIN) + len(BEGIN) : text.index(END)]


if __name__ == "__main__":
    page = PAGE.read_text(encoding="utf-8")
    PAGE.write_text(page.replace(BEGIN + written() + END, BEGIN + table() + END), encoding="utf-8")
