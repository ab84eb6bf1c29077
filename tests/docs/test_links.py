"""Links of the documents lead to files that exist, and the rows of the paper to code and tests."""

from __future__ import annotations

import re
from pathlib import Path

ROOT = Path(__file__).parents[2]
LINK = re.compile(r"(?<!\!)\[[^\]]*\]\(([^)\s]+)\)|!\[[^\]]*\]\(([^)\s]+)\)")
SECTION = "## The seed's rows: where each is built and tested"


def targets(text: str) -> list[str]:
    """The files that a text links to, without the places in them."""
    without_code = re.sub(r"^```.*?^```$", "", text, flags=re.MULTILINE | re.DOTALL)
    found = (first or second for first, second in LINK.findall(without_code))
    return [one.partition("#")[0] for one in found if not one.startswith(("http", "#", "mailto:"))]


def test_links_lead_to_files() -> None:
    pages = [*ROOT.glob("*.md"), *ROOT.glob("docs/**/*.md"), *ROOT.glob("benchmarks/**/*.md")]
    links = [(page, target) for page in pages for target in targets(page.read_text(encoding="utf-8"))]
    assert len(links) > 100
    assert [
        f"{page.relative_to(ROOT)}: {target}" for page, target in links if not (page.parent / target).exists()
    ] == []


def test_every_row_of_the_paper_leads_to_code_and_to_a_test() -> None:
    page = (ROOT / "docs" / "method.md").read_text(encoding="utf-8")
    table = page.split(SECTION)[1].split("\n## ")[0]
    rows = [line.strip("|").split("|") for line in table.splitlines() if line.startswith("|")][2:]
    assert len(rows) >= 22
    for what, code, test in rows:
        of_code, of_test = targets(code), targets(test)
        assert any(one.startswith(("../core/", "../benchmarks/")) for one in of_code), what
        assert of_test, what
        for one in of_test:
            place = (ROOT / "docs" / one).resolve()
            files = [place] if place.is_file() else sorted(place.glob("test_*.py"))
            assert any("def test_" in file.read_text(encoding="utf-8") for file in files), one


def test_every_erratum_of_the_paper_has_its_test() -> None:
    page = (ROOT / "docs" / "method.md").read_text(encoding="utf-8")
    table = page.split("## Errata of the paper")[1].split("\n## ")[0]
    named = re.findall(r"`(test_\w+)`", table)
    tests = (ROOT / "tests" / "core" / "comparison" / "test_errata.py").read_text(encoding="utf-8")
    assert len(named) >= 12
    assert [name for name in named if f"def {name}(" not in tests] == []
